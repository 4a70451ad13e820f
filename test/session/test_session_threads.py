# SPDX-License-Identifier: Apache-2.0
"""Points are added, and the operator works on, while a registration runs."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from session_fixtures import CONFIG, bone, send, surface_points, with_landmarks

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.session import Session
from gsdf_registration.session import session as session_module


class Paused:
    """A `register` that waits for its release, and records whether it was cancelled."""

    def __init__(self) -> None:
        self.running, self.release, self.cancelled = threading.Event(), threading.Event(), False

    def __call__(self, points: Array, field: Field, config: Config, *,
                 cancelled: Callable[[], bool], **_: Any) -> RegistrationResult:
        self.running.set()
        assert self.release.wait(10.0)
        self.cancelled = cancelled()
        return RegistrationResult(Reason.CONVERGED,
                                  'found',
                                  T_tracker_bone=np.eye(4),
                                  used=len(points))


@pytest.fixture
def paused(monkeypatch: pytest.MonkeyPatch) -> Paused:
    register = Paused()
    monkeypatch.setattr(session_module, 'register', register)
    return register


def in_thread(job: Callable[[], Any]) -> Callable[[], Any]:
    """Start a job; return a function that waits for its result."""
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(job()))
    thread.start()

    def result() -> Any:
        thread.join(10.0)
        assert not thread.is_alive()
        return results[0]
    return result


def test_points_added_during_a_registration_are_not_used(field: Field, paused: Paused) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field, 40))
    result = in_thread(session.register)
    assert paused.running.wait(10.0)
    assert session.status().state == 'solving'
    assert send(session, surface_points(field, 40), start=100.0)[-1] is None
    assert session.status().kept == 80
    paused.release.set()
    assert result().used == 40
    assert session.status().state == 'registered' and len(session.registered_points().stamps) == 40


def test_refuses_a_second_registration_at_once(field: Field, paused: Paused) -> None:
    session = Session(CONFIG, field)
    first = in_thread(session.register)
    assert paused.running.wait(10.0)
    second = session.register()
    assert not second.success and 'already running' in second.message
    assert session.status().state == 'solving'
    paused.release.set()
    assert first().success and session.status().result is not second


@pytest.mark.parametrize('disturb', [lambda s: s.clear(), lambda s: s.undo(),
                                     lambda s: s.set_model(bone(width=0.04))])
def test_cancels_when_points_or_model_are_dropped(
        field: Field, paused: Paused, disturb: Callable[[Session], Any]) -> None:
    session = Session(CONFIG, field)
    send(session, surface_points(field, 40))
    result = in_thread(session.register)
    assert paused.running.wait(10.0)
    disturb(session)
    paused.release.set()
    assert not result().success and paused.cancelled
    assert session.status().pose_result is None and session.status().state == 'collecting'


def test_an_error_does_not_block_the_next_registration(field: Field,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any, **__: Any) -> RegistrationResult:
        raise MemoryError
    session = with_landmarks(field)
    send(session, surface_points(field), start=100.0)
    with monkeypatch.context() as patched:
        patched.setattr(session_module, 'register', broken)
        with pytest.raises(MemoryError):
            session.register()
    assert session.register().success


def test_concurrent_senders_lose_no_points(field: Field) -> None:
    session = with_landmarks(field)
    before = session.status().received
    points = surface_points(field, 200)
    senders = [
        in_thread(lambda topic=f'probe{k}': send(session, points, start=100.0, topic=topic))
        for k in range(4)
    ]
    results = [session.register() for _ in range(5)]
    for sender in senders:
        assert sender() == [None] * 200
    status = session.status()
    assert status.received - before == 800 and status.kept + sum(
        status.rejected.values()) == status.received
    assert not any('running' in result.message for result in results)
    assert session.register().success
