# SPDX-License-Identifier: Apache-2.0
"""Test the file of a calibrated tip."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import yaml

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from msg_adapters.settings_file import read_config
from msg_adapters.tip_file import tip_path, write_tip

TIP, OTHER = np.array([0.012, -0.021, 1.0 / 7.0]), np.array([0.0, 0.0, 0.1])


def write(path: Path, tip: np.ndarray = TIP) -> Path | None:
    return write_tip(path, tip, 1e-8 * np.eye(3), 'tip found: expected error 0.2 mm', '/probe/cp')


def test_node_and_command_line_read_the_tip_exactly(tmp_path: Path) -> None:
    path = tmp_path / 'tip.yaml'
    assert write(path) is None
    assert read_config(str(path)).probe.tip == TIP.tolist()
    parameters = yaml.safe_load(path.read_text())['/**']['ros__parameters']
    assert parameters == {'probe': {'tip': TIP.tolist(), 'tip_error': pytest.approx(3e-8**0.5)}}
    text = path.read_text()
    for words in ('expected error 0.2 mm', '/probe/cp', 'covariance', '1.0000e-08'):
        assert words in text


def test_settings_before_it_stay(tmp_path: Path) -> None:
    path = tmp_path / 'tip.yaml'
    write(path)
    base = Config.from_flat({'probe.topics': ['/a'], 'probe.tip': OTHER.tolist()})
    merged = read_config(str(path), base)
    assert merged.probe.topics == ['/a'] and merged.probe.tip == TIP.tolist()


def test_an_earlier_tip_is_kept_and_another_file_is_not_touched(tmp_path: Path) -> None:
    path = tmp_path / 'tip.yaml'
    write(path, OTHER)
    kept = write(path)
    assert kept is not None and kept != path and kept.parent == tmp_path
    assert read_config(str(kept)).probe.tip == OTHER.tolist()
    assert read_config(str(path)).probe.tip == TIP.tolist()
    foreign = tmp_path / 'mine.yaml'
    foreign.write_text('probe: {topics: [/a]}\n')
    os.mkfifo(tmp_path / 'pipe.yaml')
    for name, words in (('mine.yaml', 'no tip file'), ('pipe.yaml', 'a FIFO'),
                        ('tip.json', '.yaml'), ('nowhere/tip.yaml', 'cannot be written')):
        with pytest.raises(InputError, match=words) as caught:
            write(tmp_path / name)
        assert '\n' not in caught.value.message
    assert foreign.read_text() == 'probe: {topics: [/a]}\n'


def test_the_tip_of_a_node_is_beside_its_session() -> None:
    assert tip_path(Path('/a/left_session.json')) == Path('/a/left_session.tip.yaml')
