# SPDX-License-Identifier: Apache-2.0
"""The benchmark of the console: the bone that it shows, and what it says without a browser."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
import trimesh

from benchmarks.commands.console import answers, divided, listed
from benchmarks.console.browser import browser
from gsdf_registration.common.result import InputError


def test_faces_are_divided_until_there_are_enough(hip_bone: Path, tmp_path: Path) -> None:
    whole = trimesh.load_mesh(hip_bone)
    assert divided(str(hip_bone), 1000, tmp_path) == (str(hip_bone), len(whole.faces))
    path, faces = divided(str(hip_bone), 50_000, tmp_path)
    finer = trimesh.load_mesh(path)
    assert len(finer.faces) == faces >= 50_000
    assert finer.volume == pytest.approx(whole.volume, rel=1e-3)


def test_says_what_to_install_without_a_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('playwright')
    monkeypatch.setattr('shutil.which', lambda name: None)
    with pytest.raises(InputError, match='apt-get install chromium'), browser():
        pass


def test_a_page_is_opened_once_it_is_served() -> None:
    with socket.socket() as server:
        server.bind(('127.0.0.1', 0))
        port = server.getsockname()[1]
        assert not answers(port)
        server.listen()
        assert answers(port)


def test_lists_a_load_for_each_round() -> None:
    assert listed([41.72, 3.0]) == '41.7, 3.0'
