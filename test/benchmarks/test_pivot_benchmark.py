# SPDX-License-Identifier: Apache-2.0
"""The pivot benchmark: its scenarios, the row of a method, and a peer that is missing."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.commands import pivot


@pytest.mark.parametrize('name', pivot.scenarios())
def test_finds_the_tip_in_every_scenario(name: str) -> None:
    recording = pivot.scenarios()[name](np.random.default_rng(0))
    joint = name == pivot.JOINT
    tip, seconds = pivot.ours(recording, joint)
    assert np.linalg.norm(tip - recording.point) < (5e-3 if joint else 6e-4) and seconds > 0.0


def test_a_row_has_errors_of_the_tips_found_and_the_rejections() -> None:
    recording = pivot.scenarios()['noise only'](np.random.default_rng(0))
    answers = [(recording.point + [0.0, 0.003, 0.0], 0.5), (None, 0.1), (recording.point, 0.1)]
    assert pivot.row('s', 'm', [recording] * 3, answers).split() == [
        's', 'm', '1.50', '2.85', '3.00', '1', '100.0']
    assert pivot.row('s', 'm', [recording], [(None, 0.1)]).split()[2:] == ['-', '-', '-', '1',
                                                                          '100.0']


def test_reports_why_a_peer_is_missing(monkeypatch: pytest.MonkeyPatch,
                                    capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(pivot, 'peer_answers', lambda recordings: ({}, 'no network'))
    assert main(['pivot', '--recordings', '1']) == 0
    printed = capsys.readouterr().out
    assert printed.count('gsdf_registration') == len(pivot.scenarios())
    assert 'scikit-surgerycalibration not measured: no network' in printed
