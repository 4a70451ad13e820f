# SPDX-License-Identifier: Apache-2.0
"""The next touches: the predicted gain is reached, and the places are reachable."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, bone_mesh, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config, SolverConfig
from gsdf_registration.common.result import NextTouch
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.confidence import Confidence, assess_at
from gsdf_registration.registration.guidance import (
    REACH,
    best_touches,
    distinguishing_touch,
    next_touches,
)
from gsdf_registration.registration.landmarks import named_points
from gsdf_registration.solver import solve

CONFIG = SolverConfig()
SIGMA = 3e-4
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)


def confidence_of(points: Array) -> tuple[Confidence, Array]:
    """Return the confidence from points (n, 3), m, bone frame, and their places at the pose."""
    measured = rigid.transform(T_TRACKER_BONE, points)
    solution = solve(measured, bone_field(), T_BONE_TRACKER, CONFIG)
    confidence = assess_at(solution, measured, bone_field(), 0.0)
    assert confidence is not None
    return confidence, rigid.transform(solution.T_bone_tracker, measured)


def rms_error(confidence: Confidence) -> float:
    surface = bone_field().surface_points.astype(np.float64)
    return float(np.sqrt(np.mean(confidence.predicted_tre(surface) ** 2)))


def stroke_at(place: Array, seed: int) -> Array:
    """Return 60 noisy points of the surface within 8 mm of a place."""
    rng = np.random.default_rng(seed)
    vertices = np.asarray(bone_mesh().vertices)
    near = vertices[np.linalg.norm(vertices - place, axis=1) < 0.008]
    return near[rng.integers(len(near), size=60)] + SIGMA * rng.normal(size=(60, 3))


def best(points: Array, count: int = 3) -> tuple[Confidence, list[NextTouch]]:
    confidence, on_bone = confidence_of(points)
    surface = bone_field().surface_points.astype(np.float64)
    return confidence, best_touches(confidence, bone_field(), on_bone, surface, count)


def test_a_touch_at_the_best_place_reaches_the_predicted_error() -> None:
    points = touched_points(150, 0, SIGMA, radius=0.02)
    before, touches = best(points)
    after, _ = confidence_of(np.concatenate([points, stroke_at(touches[0].position, 1)]))
    assert rms_error(after) == pytest.approx(touches[0].predicted_tre, rel=0.3)
    assert rms_error(after) < 0.6 * rms_error(before)


def test_no_other_place_within_reach_is_much_better() -> None:
    points = touched_points(150, 0, SIGMA, radius=0.02)
    _, touches = best(points)
    surface = bone_field().surface_points.astype(np.float64)
    near = surface[np.linalg.norm(surface[:, None] - points[::10], axis=2).min(axis=1) < REACH]
    chosen = rms_error(confidence_of(
        np.concatenate([points, stroke_at(touches[0].position, 1)]))[0])
    others = [rms_error(confidence_of(np.concatenate([points, stroke_at(place, 2)]))[0])
              for place in near[::len(near) // 25]]
    assert chosen < 1.15 * min(others) and chosen < 0.8 * np.median(others)


def test_a_touch_reports_its_expected_gain() -> None:
    confidence, touches = best(touched_points(150, 0, SIGMA, radius=0.02))
    assert touches[0].current_tre == pytest.approx(rms_error(confidence), rel=1e-6)
    before, after = (f'{1e3 * tre:.1f}' for tre in (touches[0].current_tre,
                                                    touches[0].predicted_tre))
    assert touches[0].expected_gain == f'the expected error falls from {before} mm to {after} mm'


def test_an_inaccurate_model_reduces_the_expected_gain() -> None:
    points = touched_points(150, 0, SIGMA, radius=0.02)
    confidence, on_bone = confidence_of(points)
    surface = bone_field().surface_points.astype(np.float64)
    plain, doubtful = (
        best_touches(dataclasses.replace(confidence, model_sd=sd), bone_field(), on_bone, surface,
                       1)[0].predicted_tre for sd in (0.0, 0.0005))
    assert doubtful > plain


def test_patches_facing_away_or_out_of_reach_are_not_returned() -> None:
    points = touched_points(150, 0, radius=0.02)
    confidence, on_bone = confidence_of(points)
    surface = bone_field().surface_points.astype(np.float64)
    toward = bone_field().sample(points)[1].mean(axis=0)
    touches = best_touches(confidence, bone_field(), on_bone, surface, 20, 1.0)
    assert len(touches) > 5
    assert min(touch.normal @ toward for touch in touches) > -0.3
    nearest = best_touches(confidence, bone_field(), on_bone, surface, 20, 0.002)
    assert 0 < len(nearest) < len(touches)
    assert best_touches(confidence, bone_field(), on_bone + 1.0, surface) == []


def test_the_settings_select_the_region() -> None:
    points = touched_points(150, 0, SIGMA, radius=0.02)
    confidence, on_bone = confidence_of(points)
    surface = bone_field().surface_points.astype(np.float64)
    crest = surface[np.argmax(surface[:, 2])]
    config = Config.from_flat({'landmarks.names': ['crest'], 'landmarks.positions': crest.tolist(),
                               'guidance.near': ['crest'], 'guidance.reach': 0.015})
    np.testing.assert_array_equal(named_points(config)['crest'], crest)
    touches = next_touches(confidence, bone_field(), on_bone, surface, config)
    assert touches and max(np.linalg.norm(touch.position - crest) for touch in touches) < 0.015
    elsewhere = next_touches(confidence, bone_field(), on_bone, surface,
                       config.replaced({'guidance.near': []}))
    assert np.linalg.norm(elsewhere[0].position - crest) > 0.015


def test_places_are_spaced_sorted_and_within_reach() -> None:
    points = touched_points(200, 1, SIGMA)
    _, touches = best(points, 4)
    assert len(touches) == 4
    gains = [touch.predicted_tre for touch in touches]
    assert gains == sorted(gains)
    places = np.array([touch.position for touch in touches])
    assert all(np.linalg.norm(a - b) >= 0.02 for k, a in enumerate(places) for b in places[:k])
    assert np.linalg.norm(places[:, None] - points, axis=2).min(axis=1).max() < REACH


def test_the_distinguishing_place_is_off_the_bone_at_the_other_pose() -> None:
    points = touched_points(200, 0)
    turned = rigid.exp([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]) @ T_BONE_TRACKER
    touch = distinguishing_touch([T_BONE_TRACKER, turned], bone_field(), points)
    place = touch.position
    off_surface, outward = bone_field().sample(place[None])
    assert abs(off_surface[0]) < 1e-4 and outward[0] @ touch.normal > 0.9
    assert (touch.label, touch.expected_gain) == (
        'disambiguates', 'it shows which of the poses is right')
    surface = bone_field().surface_points.astype(np.float64)

    def off(x: Array) -> Array:
        in_tracker = rigid.transform(T_TRACKER_BONE, x)
        return np.abs(bone_field().sample(rigid.transform(turned, in_tracker))[0])

    assert off(place[None])[0] > 0.95 * off(surface).max()
