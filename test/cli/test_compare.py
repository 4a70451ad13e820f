# SPDX-License-Identifier: Apache-2.0
"""``gsdf compare``: how two results differ."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsdf_registration.cli.main import main
from gsdf_registration.cli.result_json import result_to_json
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.rigid import Array

HASH = 'a' * 64


def write(name: str, T: Array | None, settings: dict[str, Any], model: str = HASH,
          frame_id: str = 'tracker') -> None:
    """Write the result of a pose, or of a refusal."""
    result = (RegistrationResult.refused(Reason.AMBIGUOUS, 'two poses fit') if T is None else
              RegistrationResult(Reason.CONVERGED, 'found', T, np.eye(6),
                                 predicted_tre_m={'rms': 0.001, 'max': 0.002}))
    Path(name).write_text(json.dumps(result_to_json(
        result, Config().replaced(settings), frame_id=frame_id, model_sha256=model,
        points_sha256=HASH)))


@pytest.fixture(autouse=True)
def in_empty_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    target = {'targets.names': ['cup'], 'targets.positions': [0.1, 0.0, 0.0]}
    turned = np.eye(4)
    turned[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    write('a.json', np.eye(4), target)
    write('b.json', turned, {**target, 'limits.max_error': 0.003})


def test_poses_and_settings_are_compared(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['compare', 'a.json', 'b.json', '--report', 'page.html']) == 0
    lines = [' '.join(line.split()) for line in capsys.readouterr().out.splitlines()]
    assert f'at cup {100.0 * 2**0.5:.2f} mm' in lines and 'rotation 90.000 deg' in lines
    assert 'limits.max_error 0.002 | 0.003' in lines
    assert 'RMS over the bone 1.0 mm and 1.0 mm' in lines and 'A a.json: converged' in lines
    assert not any(line.startswith('limits.max_sigma') for line in lines)
    page = Path('page.html').read_text()
    assert '<td>at cup</td><td>141.42 mm</td>' in page and 'http' not in page


def test_equal_results_do_not_differ(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['compare', 'a.json', 'a.json']) == 0
    text = ' '.join(capsys.readouterr().out.split())
    assert 'at cup 0.00 mm' in text and text.endswith('Settings that differ, A and B none')


@pytest.mark.parametrize('change, remark', [
    ({'model': 'b' * 64}, 'different models'), ({'frame_id': 'camera'}, 'different frames'),
    ({'T': None}, 'B has no pose: two poses fit')])
def test_poses_that_cannot_be_compared(change: dict[str, Any], remark: str,
                                       capsys: pytest.CaptureFixture[str]) -> None:
    write('c.json', **{'T': np.eye(4), 'settings': {}, **change})
    assert main(['compare', 'a.json', 'c.json']) == 0
    text = capsys.readouterr().out
    assert remark in text and 'rotation' not in text


@pytest.mark.parametrize('text, complaint', [
    ('{', 'line 1: this is not valid JSON'), ('[{}, {}]', 'several recordings'),
    ('{}', 'is no result of the schema'),
    ('{"schema": "gsdf-registration/2", "reason": 1, "message": 1, "T_tracker_bone": 1, '
     '"bone_pose": 1, "inputs": 1, "predicted_tre_m": 1, "config": 1}', 'is damaged')])
def test_a_file_that_is_no_result_is_refused_in_one_line(
        text: str, complaint: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path('c.json').write_text(text)
    assert main(['compare', 'a.json', 'c.json']) == 2
    error = capsys.readouterr().err
    assert error.startswith('gsdf: error: c.json') or complaint == 'is damaged'
    assert complaint in error and error.count('\n') == 1
