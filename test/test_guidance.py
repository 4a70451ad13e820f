# SPDX-License-Identifier: Apache-2.0
"""Where to touch next: what was promised comes true, and it is said in words one can follow."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, bone_mesh, touched

from gsdf_registration import rigid
from gsdf_registration.confidence import Confidence, assess
from gsdf_registration.config import SolverConfig
from gsdf_registration.guidance import REACH, Touch, in_words, where_they_differ, where_to_touch
from gsdf_registration.rigid import Array
from gsdf_registration.solver import nearest_neighbours, solve

CONFIG = SolverConfig()
SIGMA = 3e-4
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)


def confidence_of(points: Array) -> tuple[Confidence, Array]:
    """Return what points (n, 3) of the bone frame, seen by the tracker, say, and where they lie."""
    seen = rigid.transform(T_TRACKER_BONE, points)
    solution = solve(seen, bone_field(), T_BONE_TRACKER, CONFIG)
    around = nearest_neighbours(seen, bone_field(), solution.T_bone_tracker, 3 * CONFIG.neighbours)
    confidence = assess(solution, seen, around)
    assert confidence is not None
    return confidence, rigid.transform(solution.T_bone_tracker, seen)


def bone_wide(confidence: Confidence) -> float:
    surface = bone_field().surface_points.astype(np.float64)
    return float(np.sqrt(np.mean(confidence.predicted_tre(surface) ** 2)))


def stroke_at(place: Array, seed: int) -> Array:
    """Return 60 noisy points of the surface within 8 mm of a place."""
    rng = np.random.default_rng(seed)
    vertices = np.asarray(bone_mesh().vertices)
    near = vertices[np.linalg.norm(vertices - place, axis=1) < 0.008]
    return near[rng.integers(len(near), size=60)] + SIGMA * rng.normal(size=(60, 3))


def best(points: Array, count: int = 3) -> tuple[Confidence, list[Touch]]:
    confidence, on_bone = confidence_of(points)
    surface = bone_field().surface_points.astype(np.float64)
    return confidence, where_to_touch(confidence, bone_field(), on_bone, surface, count)


def test_touching_there_brings_what_was_promised() -> None:
    points = touched(150, 0, SIGMA, radius=0.02)
    before, touches = best(points)
    after, _ = confidence_of(np.concatenate([points, stroke_at(touches[0].position, 1)]))
    assert bone_wide(after) == pytest.approx(touches[0].predicted_tre, rel=0.3)
    assert bone_wide(after) < 0.6 * bone_wide(before)


def test_no_other_place_would_have_taught_much_more() -> None:
    points = touched(150, 0, SIGMA, radius=0.02)
    _, touches = best(points)
    surface = bone_field().surface_points.astype(np.float64)
    chosen = bone_wide(confidence_of(
        np.concatenate([points, stroke_at(touches[0].position, 1)]))[0])
    others = [bone_wide(confidence_of(np.concatenate([points, stroke_at(place, 2)]))[0])
              for place in surface[::len(surface) // 25]]
    assert chosen < 1.15 * min(others) and chosen < 0.8 * np.median(others)


def test_places_are_apart_best_first_and_within_reach() -> None:
    points = touched(200, 1, SIGMA)
    _, touches = best(points, 4)
    assert len(touches) == 4
    gains = [touch.predicted_tre for touch in touches]
    assert gains == sorted(gains)
    places = np.array([touch.position for touch in touches])
    assert all(np.linalg.norm(a - b) >= 0.02 for k, a in enumerate(places) for b in places[:k])
    assert np.linalg.norm(places[:, None] - points, axis=2).min(axis=1).max() < REACH


def test_the_place_that_tells_two_poses_apart_lies_off_the_bone_at_the_other() -> None:
    points = touched(200, 0)
    turned = rigid.exp([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]) @ T_BONE_TRACKER
    place = where_they_differ([T_BONE_TRACKER, turned], bone_field(), points)
    assert abs(bone_field().sample(place[None])[0][0]) < 1e-4
    surface = bone_field().surface_points.astype(np.float64)

    def off(x: Array) -> Array:
        in_tracker = rigid.transform(T_TRACKER_BONE, x)
        return np.abs(bone_field().sample(rigid.transform(turned, in_tracker))[0])

    assert off(place[None])[0] > 0.95 * off(surface).max()


def test_a_place_is_named_by_what_is_near_or_by_direction() -> None:
    points = touched(100, 0)
    place = points.mean(axis=0) + [0.0, 0.0, -0.05]
    assert in_words(place, points, {'crest': place + 0.01}) == 'near crest'
    words = in_words(place, points, {'crest': place + 0.1})
    assert '50 mm' in words and '-z' in words and 'crest' not in words
