# SPDX-License-Identifier: Apache-2.0
"""Where to touch next: what was promised comes true, and it is said in words one can follow."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, bone_mesh, touched

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config, SolverConfig
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.confidence import Confidence, assess_at
from gsdf_registration.registration.guidance import (
    REACH,
    Touch,
    advise,
    in_words,
    named_points,
    where_they_differ,
    where_to_touch,
)
from gsdf_registration.solver import solve

CONFIG = SolverConfig()
SIGMA = 3e-4
T_BONE_TRACKER = rigid.inverse(T_TRACKER_BONE)


def confidence_of(points: Array) -> tuple[Confidence, Array]:
    """Return what points (n, 3) of the bone frame, seen by the tracker, say, and where they lie."""
    seen = rigid.transform(T_TRACKER_BONE, points)
    solution = solve(seen, bone_field(), T_BONE_TRACKER, CONFIG)
    confidence = assess_at(solution, seen, bone_field(), CONFIG)
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


def test_no_other_place_within_reach_would_have_taught_much_more() -> None:
    points = touched(150, 0, SIGMA, radius=0.02)
    _, touches = best(points)
    surface = bone_field().surface_points.astype(np.float64)
    near = surface[np.linalg.norm(surface[:, None] - points[::10], axis=2).min(axis=1) < REACH]
    chosen = bone_wide(confidence_of(
        np.concatenate([points, stroke_at(touches[0].position, 1)]))[0])
    others = [bone_wide(confidence_of(np.concatenate([points, stroke_at(place, 2)]))[0])
              for place in near[::len(near) // 25]]
    assert chosen < 1.15 * min(others) and chosen < 0.8 * np.median(others)


def test_a_touch_tells_what_it_gains() -> None:
    confidence, touches = best(touched(150, 0, SIGMA, radius=0.02))
    assert touches[0].present_tre == pytest.approx(bone_wide(confidence), rel=1e-6)
    before, after = (f'{1e3 * tre:.1f}' for tre in (touches[0].present_tre,
                                                    touches[0].predicted_tre))
    assert touches[0].promise == f'the expected error falls from {before} to {after} mm'


def test_a_stroke_over_a_model_that_is_off_promises_less() -> None:
    points = touched(150, 0, SIGMA, radius=0.02)
    confidence, on_bone = confidence_of(points)
    surface = bone_field().surface_points.astype(np.float64)
    plain, doubtful = (
        where_to_touch(dataclasses.replace(confidence, model_sd=sd), bone_field(), on_bone, surface,
                       1)[0].predicted_tre for sd in (0.0, 0.0005))
    assert doubtful > plain


def test_what_faces_away_or_is_out_of_reach_is_not_proposed() -> None:
    points = touched(150, 0, radius=0.02)
    confidence, on_bone = confidence_of(points)
    surface = bone_field().surface_points.astype(np.float64)
    toward = bone_field().sample(points)[1].mean(axis=0)
    touches = where_to_touch(confidence, bone_field(), on_bone, surface, 20, 1.0)
    assert len(touches) > 5
    assert min(touch.normal @ toward for touch in touches) > -0.3
    nearest = where_to_touch(confidence, bone_field(), on_bone, surface, 20, 0.002)
    assert 0 < len(nearest) < len(touches)
    assert where_to_touch(confidence, bone_field(), on_bone + 1.0, surface) == []


def test_the_settings_name_a_region() -> None:
    points = touched(150, 0, SIGMA, radius=0.02)
    confidence, on_bone = confidence_of(points)
    surface = bone_field().surface_points.astype(np.float64)
    crest = surface[np.argmax(surface[:, 2])]
    config = Config.from_flat({'landmarks.names': ['crest'], 'landmarks.positions': crest.tolist(),
                               'guidance.near': ['crest'], 'guidance.reach': 0.015})
    np.testing.assert_array_equal(named_points(config)['crest'], crest)
    touches = advise(confidence, bone_field(), on_bone, surface, config)
    assert touches and max(np.linalg.norm(touch.position - crest) for touch in touches) < 0.015
    elsewhere = advise(confidence, bone_field(), on_bone, surface,
                       config.replaced({'guidance.near': []}))
    assert np.linalg.norm(elsewhere[0].position - crest) > 0.015


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
    touch = where_they_differ([T_BONE_TRACKER, turned], bone_field(), points)
    place = touch.position
    off_surface, outward = bone_field().sample(place[None])
    assert abs(off_surface[0]) < 1e-4 and outward[0] @ touch.normal > 0.9
    assert (touch.label, touch.promise) == ('decides', 'it decides which of the poses is right')
    surface = bone_field().surface_points.astype(np.float64)

    def off(x: Array) -> Array:
        in_tracker = rigid.transform(T_TRACKER_BONE, x)
        return np.abs(bone_field().sample(rigid.transform(turned, in_tracker))[0])

    assert off(place[None])[0] > 0.95 * off(surface).max()


def words(place: list[float], names: dict[str, list[float]], touched: Array | None = None) -> str:
    """Say where a place is, all lengths in mm; touched is the tip of +x unless given."""
    return in_words(1e-3 * np.array(place), tip() if touched is None else touched,
                    {name: 1e-3 * np.array(point) for name, point in names.items()}, bone_field())


def tip() -> Array:
    """Return surface points round the one farthest in +x."""
    return touched(100, 0, radius=0.015)


def test_a_place_is_told_from_the_nearest_name_towards_another() -> None:
    names: dict[str, list[float]] = {'crest': [0, 0, 50], 'notch': [0, 40, 50]}
    assert words([0, 1, 52], names) == "at 'crest'"
    assert words([0, 12, 50], names) == "12 mm from 'crest' towards 'notch'"
    assert words([0, -12, 48], names) == "12 mm from 'crest' away from 'notch'"
    assert words([0, 30, 50], names) == "10 mm from 'notch' towards 'crest'"
    assert "20 mm from 'crest' at " in words([0, 0, 70], {'crest': [0, 0, 50]})
    assert 'crest' not in words([0, 0, -50], names)


def test_without_names_it_is_told_by_a_clock_that_one_can_follow() -> None:
    surface = bone_field().surface_points.astype(np.float64)
    # the middle of the bone is not right beneath
    points = surface[np.linalg.norm(surface - [0.02, 0.0, -0.04], axis=1) < 0.012]
    above = bone_field().sample(points)[1].mean(axis=0)
    above /= np.linalg.norm(above)
    noon = surface.mean(axis=0) - points.mean(axis=0)
    noon -= (noon @ above) * above
    noon /= np.linalg.norm(noon)
    right = np.cross(noon, above)

    def told(up: float, aside: float, deeper: float = 0.0) -> str:
        place = points.mean(axis=0) + up * noon + aside * right - deeper * above
        return words((1e3 * place).tolist(), {}, points)

    where = 'from the middle of what was touched'
    assert told(0.03, 0.0) == f"30 mm {where} at 12 o'clock (12 is towards the middle of the bone)"
    assert f"20 mm {where} at 3 o'clock" in told(0.0, 0.02)
    assert f"20 mm {where} at 6 o'clock" in told(-0.02, 0.001)
    assert f"20 mm {where} at 9 o'clock" in told(0.0, -0.02)
    assert told(0.02, 0.02, 0.012).endswith('of the bone), 12 mm deeper')
    assert told(0.02, 0.02, -0.012).endswith('of the bone), 12 mm higher')
    assert told(0.0, 0.0, 0.012) == '12 mm deeper than the middle of what was touched'
    assert told(0.001, 0.0) == 'at the middle of what was touched'


def test_where_the_bone_lies_beneath_the_clock_goes_by_the_model() -> None:
    surface = bone_field().surface_points.astype(np.float64)
    end = surface[surface[:, 2] > surface[:, 2].max() - 0.004]
    place = end.mean(axis=0) + [0.02, 0.0, 0.0]
    assert "at 12 o'clock (12 is towards +x of the model)" in words((1e3 * place).tolist(), {}, end)
