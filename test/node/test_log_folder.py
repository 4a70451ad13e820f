# SPDX-License-Identifier: Apache-2.0
"""ROS logs to a temporary folder if its own cannot be written."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from gsdf_registration.node import log_folder


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder that is used instead; all else is in ``tmp_path``."""
    monkeypatch.setattr(log_folder, 'temporary_cache', lambda: tmp_path / 'temporary')
    monkeypatch.setenv('HOME', str(tmp_path / 'home'))
    monkeypatch.delenv('ROS_HOME', raising=False)
    monkeypatch.setenv('ROS_LOG_DIR', '')
    return tmp_path / 'temporary/log'


@pytest.mark.parametrize('name, value, folder', [
    ('HOME', 'other', 'other/.ros/log'), ('ROS_HOME', 'ros', 'ros/log'),
    ('ROS_LOG_DIR', 'here', 'here')])
def test_keeps_a_folder_that_can_be_written(name: str, value: str, folder: str, tmp_path: Path,
                                            monkeypatch: pytest.MonkeyPatch,
                                            capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv(name, str(tmp_path / value))
    before = os.environ['ROS_LOG_DIR']
    log_folder.choose_log_folder()
    assert os.environ['ROS_LOG_DIR'] == before and capsys.readouterr().err == ''
    assert (tmp_path / folder).is_dir()


def test_uses_a_temporary_folder_if_the_home_cannot_be_written(
        tmp_path: Path, temporary: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'home').touch()     # not a folder, also for an administrator
    log_folder.choose_log_folder()
    assert os.environ['ROS_LOG_DIR'] == str(temporary) and temporary.is_dir()
    assert 'set ROS_LOG_DIR to a folder that lasts' in capsys.readouterr().err
