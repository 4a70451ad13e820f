# SPDX-License-Identifier: Apache-2.0
"""``gsdf view``: the console without ROS. A recording is played through the session of the node."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from gsdf_registration.cli.main import main
from gsdf_registration.cli.playback import Playback
from gsdf_registration.common.config import Config
from gsdf_registration.field.model import load_model
from msg_adapters.recording import Recording
from msg_adapters.truth import Truth


class Page:
    """Takes what is shown."""

    def __init__(self) -> None:
        self.values: dict[str, str] = {}
        self.ready = threading.Event()

    def show_status(self, values: dict[str, str], message: str) -> None:
        self.values = values
        if int(values['received']) > 600 and self.values['state'] == 'ready':
            self.ready.set()

    def __getattr__(self, name: str) -> Any:
        return lambda *_: None


class Clock:
    """Jumps to a time."""

    def __init__(self, moment: float) -> None:
        self.moment = moment

    def advance(self, elapsed: float) -> float:
        return self.moment

    def show(self) -> None:
        """Show nothing."""


@contextmanager
def played(recording: Recording, bone: Path, clock: Any) -> Iterator[tuple[Playback, Page]]:
    page: Any = Page()
    playback = Playback(recording, load_model(str(bone), 'mm'), lambda config: config or Config())
    thread = threading.Thread(target=playback.run, args=(page, clock))
    thread.start()
    try:
        yield playback, page
    finally:
        playback.stop()
        thread.join()


def test_a_recording_becomes_ready_is_registered_and_begins_again(
        optical_recording: tuple[Recording, Truth], hip_bone: Path) -> None:
    clock = Clock(1e9)
    with played(optical_recording[0], hip_bone, clock) as (playback, page):
        assert page.ready.wait(100.0)
        success, message = playback.register()
        assert success, message
        clock.moment = 0.0      # a jump to the start drops the registration and the points
        again = threading.Event()
        page.show_status = lambda values, message: (  # type: ignore[method-assign]
            again.set() if int(values['received']) < 5 and values['pose'] == 'none' else None)
        assert again.wait(30.0)


@pytest.mark.parametrize(('content', 'said'), [
    ('{', 'is not valid JSON'), ('[]', 'is neither a saved session nor a result')])
def test_says_what_is_wrong_with_a_file(tmp_path: Path, hip_bone: Path, content: str, said: str,
                                        capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'some.json'
    path.write_text(content)
    assert main(['view', str(path), '--model', str(hip_bone), '--model-unit', 'mm']) == 2
    assert said in capsys.readouterr().err
