# SPDX-License-Identifier: Apache-2.0
"""The scenarios of touches and of rests, on a bone of the fixtures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.protocol.cases import find_cases
from benchmarks.protocol.scoring import cramer_rao
from benchmarks.protocol.starts import given_landmarks
from benchmarks.protocol.trials import SCENARIOS, Trial, make
from gsdf_registration.common import rigid
from gsdf_registration.simulation.interference import Kind


@pytest.fixture(scope='module')
def cases(bags: Path) -> list:
    return find_cases([bags / 'hip.ply'])


def test_touches_are_single_points_with_landmarks_3_mm_off(cases: list) -> None:
    problem = make(Trial(cases[0], SCENARIOS['touches_40_soft_20'], 0, cases[0].bone))
    recording = problem.recording
    assert len(recording.positions) == 40 and len(problem.touched) == 32
    off = rigid.transform(rigid.inverse(recording.T_tracker_bone), recording.positions)
    e = problem.field.sample(off)[0]
    assert rigid.rms(e[recording.on_bone]) < 5e-4 and (e[~recording.on_bone] > 1e-3).all()
    landmarks = given_landmarks(problem)
    assert landmarks is not None
    apart = landmarks[1] - rigid.transform(recording.T_tracker_bone, landmarks[0])
    np.testing.assert_allclose(np.linalg.norm(apart, axis=1), 0.003)
    assert cramer_rao(problem).sigma == pytest.approx(3e-4)


@pytest.mark.parametrize('name', ['rest_on', 'rest_beside', 'rest_far'])
def test_a_rest_is_added_to_the_strokes_and_is_no_evidence_of_the_bound(cases: list,
                                                                        name: str) -> None:
    low, high = SCENARIOS[name].rest or (0.0, 0.0)
    for seed in range(4):
        problem = make(Trial(cases[0], SCENARIOS[name], seed, cases[0].bone))
        recording = problem.recording
        resting = recording.kinds == Kind.SOFT_TISSUE
        assert 80 <= resting.sum() <= 9600 and 600 <= (~resting).sum() <= 1000
        assert (np.diff(np.flatnonzero(resting)) == 1).all()
        assert (np.diff(recording.strokes) >= 0).all() and recording.strokes[0] == 0
        assert len(np.unique(recording.strokes[resting])) == 1
        assert not np.isin(recording.strokes[~resting], recording.strokes[resting]).any()
        place = recording.tips[resting]
        assert (place == place[0]).all() and (np.diff(recording.stamps) > 0.0).all()
        if high < 0.05:
            assert abs(problem.field.sample(place[:1])[0][0]) < high + 2e-4
        assert len(problem.touched) == (~resting).sum()
        assert given_landmarks(problem) is None
