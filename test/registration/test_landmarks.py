# SPDX-License-Identifier: Apache-2.0
"""The pose from landmarks, and the messages about wrong landmarks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common import rigid
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.landmarks import disagreement, pose_from_landmarks

MODEL = np.array([[0.03, 0.058, 0.077], [0.02, -0.027, 0.008], [-0.014, -0.048, -0.068]])
T_TRACKER_BONE = rigid.exp([1.1, -2.0, 0.4, 0.3, -0.8, -1.6])
TOUCHED = rigid.transform(T_TRACKER_BONE, MODEL)

twists = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6)


@given(twists, st.integers(3, 6))
@settings(deadline=None, max_examples=50)
def test_exact_landmarks_yield_the_exact_pose(twist: list[float], n: int) -> None:
    model = np.vstack([MODEL, [[0.05, 0.0, 0.0], [0.0, 0.04, -0.03], [0.01, 0.02, 0.12]]])[:n]
    T = rigid.exp(twist)
    found, residual = pose_from_landmarks(model, rigid.transform(T, model))
    np.testing.assert_allclose(found, T, atol=1e-12)
    assert residual < 1e-12


def test_the_pose_error_is_bounded_by_the_noise() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        noise = rng.normal(size=MODEL.shape)
        noise *= 0.004 / np.linalg.norm(noise, axis=1, keepdims=True)
        T, residual = pose_from_landmarks(MODEL, TOUCHED + noise)
        assert rigid.is_rigid(T)
        assert 0.0 < residual <= 0.004
        # the best fit is no farther from the touched points than the truth: 2 x 4 mm at most
        moved = rigid.transform(T, MODEL) - TOUCHED
        assert np.sqrt((moved**2).sum(axis=1).mean()) <= 0.008


def test_the_residual_is_the_rms_distance_of_the_pairs() -> None:
    grown = TOUCHED.mean(axis=0) + 1.1 * (TOUCHED - TOUCHED.mean(axis=0))
    _, residual = pose_from_landmarks(MODEL, grown)
    expected = 0.1 * np.sqrt(((MODEL - MODEL.mean(axis=0))**2).sum(axis=1).mean())
    assert residual == pytest.approx(expected, rel=1e-9)


def replaced(points: Array, row: int, value: object) -> Array:
    points = points.copy()
    points[row] = value
    return points


LINE = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.09, 0.001, 0.0]])


@pytest.mark.parametrize(('model', 'tracker', 'message'), [
    (MODEL[:2], TOUCHED[:2], '2 landmarks cannot determine a pose'),
    (MODEL[:0], TOUCHED[:0], '0 landmarks cannot'),
    (MODEL, TOUCHED[:2], 'one touched point for each model point'),
    (MODEL[:, :2], TOUCHED[:, :2], 'the shapes (3, 2)'),
    (MODEL[0], TOUCHED[0], 'the shapes (3,)'),
    (replaced(MODEL, 1, np.nan), TOUCHED, 'not finite'),
    (MODEL, replaced(TOUCHED, 2, np.inf), 'not finite'),
    (MODEL, replaced(TOUCHED, 2,
                     TOUCHED[0] + 0.001), 'landmarks 1 and 3 as touched are only 1.7 mm apart'),
    (replaced(MODEL, 1, MODEL[0]), TOUCHED, 'landmarks 1 and 2 on the model are only 0.0 mm apart'),
    (LINE, TOUCHED, 'on the model lie on a line'),
    (MODEL, rigid.transform(T_TRACKER_BONE, LINE), 'as touched lie on a line'),
])
def test_degenerate_landmarks_are_refused(model: Array, tracker: Array,
                                          message: str) -> None:
    with pytest.raises(InputError) as error:
        pose_from_landmarks(model, tracker)
    assert message in error.value.message
    assert error.value.reason is Reason.BAD_INPUT
    assert '\n' not in error.value.message


@pytest.mark.parametrize('garbage', [None, 'abc', [[1.0, 2.0], [3.0]], object()])
def test_landmarks_that_are_not_arrays_are_refused(garbage: object) -> None:
    with pytest.raises(InputError):
        pose_from_landmarks(garbage, TOUCHED)       # type: ignore[arg-type]


NAMES = ['a', 'b', 'c', 'd']
FOUR = np.vstack([MODEL, [[0.05, 0.0, 0.0]]])


def test_landmarks_with_usual_errors_agree() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        side = rng.normal(size=FOUR.shape)
        side *= 0.004 / np.linalg.norm(side, axis=1, keepdims=True)
        for k in (1, 2, 3, 4):
            assert disagreement(NAMES[:k], FOUR[:k],
                                rigid.transform(T_TRACKER_BONE, FOUR[:k] + side[:k])) == ''


@pytest.mark.parametrize('wrong', [0, 1, 2, 3])
def test_the_wrong_landmark_is_named(wrong: int) -> None:
    touched = FOUR.copy()
    touched[wrong] += 0.05 * (touched[wrong] - FOUR.mean(axis=0)) / np.linalg.norm(
        touched[wrong] - FOUR.mean(axis=0))
    message = disagreement(NAMES, FOUR, rigid.transform(T_TRACKER_BONE, touched))
    assert message.startswith(f'"{NAMES[wrong]}" is up to ')


def test_the_order_of_swapped_landmarks_is_named() -> None:
    message = disagreement(NAMES[:3], MODEL, TOUCHED[[1, 0, 2]])
    assert message == 'the landmarks were probably touched in this order: "b", "a", "c"'
    message = disagreement(NAMES[:2], MODEL[:2], TOUCHED[[0, 2]])
    assert message == ('"a" and "b" are 185 mm apart, but 110 mm on the model; check that the '
                       'right places were touched')
