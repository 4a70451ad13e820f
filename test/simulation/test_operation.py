# SPDX-License-Identifier: Apache-2.0
"""A simulated operation: what the tracker reports agrees with its ground truth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import inverse, rotation_log, transform
from gsdf_registration.simulation.air import along_shaft
from gsdf_registration.simulation.ball_tip import BallContact
from gsdf_registration.simulation.losses import Losses
from gsdf_registration.simulation.moving import Sway
from gsdf_registration.simulation.operation import Operation, Plan, simulate_operation
from gsdf_registration.simulation.patch import exposed_patch
from gsdf_registration.simulation.probe import REAL_HAND, Tracker, random_pose
from gsdf_registration.simulation.touched_bone import TouchedBone

BALL = trimesh.creation.icosphere(subdivisions=4, radius=0.04)
VERTICES, FACES = np.asarray(BALL.vertices), np.asarray(BALL.faces)
BONE = TouchedBone(VERTICES, FACES, exposed_patch(VERTICES, FACES, (0.0, 0.0, 0.04), 0.035), 0.001)
HIP = np.array([0.0, 0.05, 0.3])
MARKS = np.array([[0.0, 0.0, 0.04], [0.02, 0.0, 0.035]])
EXACT = Tracker(rate=40.0, sigma=0.0)
PLAN = Plan(900, 6.0, 6.0, EXACT, 0.0)


@cache
def operation(plan: Plan = PLAN) -> Operation:
    rng = np.random.default_rng(3)
    sway = Sway(random_pose(rng))
    return simulate_operation(BONE, plan, sway, random_pose(rng), MARKS, rng, HIP)


def test_the_tip_stays_in_the_divot() -> None:
    poses, made = operation().probe['pivoting'], operation()
    np.testing.assert_allclose([transform(T, PLAN.tool.tip) for T in poses.T_tracker_body],
                               np.tile(made.pivot, (len(poses.stamps), 1)), atol=1e-9)


def test_the_hip_stays_in_place_while_the_leg_swings() -> None:
    made = operation()
    place = transform(made.T_array_bone, HIP)
    centres = np.array([transform(T, place) for T in made.array['swinging'].T_tracker_body])
    assert np.linalg.norm(centres - centres.mean(axis=0), axis=1).max() < 0.008
    first, last = made.array['swinging'].T_tracker_body[[0, 60], :3, :3]
    assert np.linalg.norm(rotation_log(first.T @ last)) > np.radians(2.0)


def test_neither_tip_nor_shaft_enters_the_bone_seen_from_the_array() -> None:
    made = operation()
    np.testing.assert_array_equal(made.array['still'].stamps[-len(made.probe['strokes'].stamps):],
                                  made.probe['strokes'].stamps)
    arrays = made.array['still'].T_tracker_body[-len(made.probe['strokes'].stamps):]
    T = np.array([inverse(made.T_array_bone) @ inverse(array) @ probe
                  for array, probe in zip(arrays, made.probe['strokes'].T_tracker_body)])
    tips = T[:, :3, :3] @ np.array(PLAN.tool.tip) + T[:, :3, 3]
    shafts = T[:, :3, :3] @ np.array(PLAN.tool.shaft)
    distance = BallContact(VERTICES, FACES).distance
    heights = distance(tips)[0]
    assert heights.min() > -1e-6 and (np.abs(heights - 0.001) < 1e-5).mean() > 0.6
    assert (heights > 0.005).any()      # between strokes
    assert distance(along_shaft(tips, shafts))[0].min() > 0.0


def test_a_real_hand_has_published_speeds() -> None:
    strokes = operation().probe['strokes']
    arrays = operation().array['still'].T_tracker_body[-len(strokes.stamps):]
    tips = [transform(inverse(array) @ probe, PLAN.tool.tip)
            for array, probe in zip(arrays, strokes.T_tracker_body)]
    speeds = 1e3 * np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(strokes.stamps)
    median, fast = np.percentile(speeds, [50.0, 99.0])
    assert 18.0 < median < 40.0 and 90.0 < fast < 170.0     # mm/s; published: 27 and 127
    assert PLAN.hand is REAL_HAND


def test_calls_are_in_the_order_of_the_operation() -> None:
    calls = operation().calls
    assert [call.service for call in calls] == [
        'calibrate_tip', 'calibrate_tip', 'find_joint_centre', 'find_joint_centre',
        'capture_landmark', 'capture_landmark', 'collect', 'collect', 'register']
    assert [call.data for call in calls if call.service == 'collect'] == [True, False]
    assert sorted(calls) == list(calls)
    strokes = operation().probe['strokes'].stamps
    on, off = (call.stamp for call in calls if call.service == 'collect')
    assert on < strokes[0] and strokes[-1] < off


def test_the_tracker_distorts_all_parts_alike_and_loses_each_tool() -> None:
    tracker = replace(EXACT, distortion=0.002)
    made = operation(replace(PLAN, points=200, tracker=tracker, losses=Losses(0.1, 6.0)))
    probe, array = made.probe['strokes'].stamps, made.array['still'].stamps
    assert {*probe} != {*array}
    places = [transform(T, PLAN.tool.tip) for T in made.probe['pivoting'].T_tracker_body]
    away = np.linalg.norm(np.array(places) - made.pivot, axis=1)
    assert 1e-4 < away.mean() < 0.01


def test_the_same_seed_gives_the_same_operation() -> None:
    first = operation(replace(PLAN, points=100))
    operation.cache_clear()
    again = operation(replace(PLAN, points=100))
    for name, poses in first.probe.items():
        assert poses.T_tracker_body.tobytes() == again.probe[name].T_tracker_body.tobytes()


def test_a_swing_needs_the_centre_of_the_hip() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match='centre of the hip'):
        simulate_operation(BONE, PLAN, Sway(), np.eye(4), MARKS, rng)
