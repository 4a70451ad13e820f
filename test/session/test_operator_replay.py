# SPDX-License-Identifier: Apache-2.0
"""The replay of what an operator did gives the node's own result, to the bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from recorded_operation import ARRAY, EVENTS, STEP, TIP, TOOL, RecordedOperation, held
from smooth_bone import LANDMARKS, T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, exp, from_rt, rotation_exp, transform
from gsdf_registration.session.replay import Replayed, replay_events
from gsdf_registration.simulation.moving import Sway
from gsdf_registration.simulation.pivoting import HIP_CENTRE, leg_swing, pivoting
from gsdf_registration.simulation.pivoting import TIP as TOOL_TIP
from msg_adapters.bag import read_bag

CONFIG = Config.from_flat({
    'collect.automatic': False, 'gate.max_speed': 100.0, 'limits.max_error': 0.004,
    'search.rotations': 50, 'search.places': 50, 'search.parts': 2,
    'landmarks.names': ['a', 'b', 'c'], 'landmarks.positions': LANDMARKS.ravel().tolist()})
POINTS = transform(T_TRACKER_BONE, touched_points(600, sigma=0.0002))
# the recorder receives the events before or after the samples
DELAYS = [{EVENTS: -0.3}, {EVENTS: 1.0, TIP: 0.2, TOOL: 0.2}]


def assert_replayed(run: RecordedOperation, tmp_path: Path,
                    config: Config | None = CONFIG) -> Replayed:
    """
    Check that all recordings of an operation give its result; return the replay.

    ``config``: at the start, for service introspection; None: what was done cannot be seen there.
    """
    run.end()
    status, points = run.session.status(), run.session.points()
    expected = status.pose_result or status.result
    for number, delays in enumerate([*DELAYS, None] if config else DELAYS):
        services = delays is None
        run.write(tmp_path / f'bag{number}', delays, services)
        start = config if services else None
        recording = read_bag(tmp_path / f'bag{number}', events=None,
                             reference=start.reference.topic if start else '')
        done = replay_events(recording, bone_field(),
                             lambda given, start=start: start or given)
        assert done.notes == () and len(recording.notes) == services
        found, again = done.result, done.session.status()
        assert found.message == expected.message
        for name in ('T_tracker_bone', 'covariance', 'residuals_m', 'weights'):
            ours, theirs = getattr(found, name), getattr(expected, name)
            assert (ours is None) == (theirs is None)
            assert ours is None or ours.tobytes() == theirs.tobytes(), name
        assert (found.received, found.rejected, found.used, found.left_out) == (
            expected.received, expected.rejected, expected.used, expected.left_out)
        assert (again.received, again.kept, again.rejected) == (
            status.received, status.kept, status.rejected)
        assert again.received == again.kept + sum(again.rejected.values())
        for ours, theirs in zip(done.session.points(), points):
            assert ours.tobytes() == theirs.tobytes()
        assert done.session.landmarks().touched.tobytes() == (
            run.session.landmarks().touched.tobytes())
        assert again.verification == status.verification
    return done


def touch_landmarks(run: RecordedOperation) -> None:
    for place in transform(T_TRACKER_BONE, LANDMARKS):
        run.tip(held(place))
        assert run.call('capture_landmark').success


def stroke(run: RecordedOperation, points: Array) -> None:
    run.call('collect', data=True)
    run.tip(points)
    run.call('collect', data=False)
    run.time += 1.0


def test_a_clear_and_a_second_register(tmp_path: Path) -> None:
    run = RecordedOperation(bone_field(), CONFIG)
    touch_landmarks(run)
    stroke(run, POINTS[:200] + 0.02)
    run.call('register')
    run.call('clear')
    touch_landmarks(run)
    stroke(run, POINTS[:300])
    assert run.call('register').success
    stroke(run, POINTS[300:])
    assert run.call('register').success
    run.tip(held(POINTS[7]))
    assert run.call('verify').detail is not None
    assert assert_replayed(run, tmp_path).session.status().registration_id == 2


def test_dropped_strokes_of_the_pose(tmp_path: Path) -> None:
    run = RecordedOperation(bone_field(), CONFIG)
    touch_landmarks(run)
    for part in np.split(POINTS, 4):
        stroke(run, part)
    assert run.call('register').success
    assert run.call('drop_stroke', stroke=2).success        # registered without it
    assert not run.call('drop_stroke', stroke=2).success
    assert run.call('undo').success
    done = assert_replayed(run, tmp_path)
    assert done.session.status().registration_id == 3
    assert done.session.status().rejected['undone'] >= 250


def test_a_pose_that_is_withdrawn_after_an_undo(tmp_path: Path) -> None:
    run = RecordedOperation(bone_field(), CONFIG)
    touch_landmarks(run)
    stroke(run, POINTS[:10])
    stroke(run, POINTS)
    assert run.call('register').success
    assert run.call('undo').success
    assert run.session.status().withdrawn is not None
    done = assert_replayed(run, tmp_path)
    assert done.session.status().withdrawn.reason == run.session.status().withdrawn.reason


def test_changed_parameters_and_an_initial_pose(tmp_path: Path) -> None:
    run = RecordedOperation(bone_field(), CONFIG)
    run.refuse('register')
    run.call('initial_pose', T_tracker_bone=(T_TRACKER_BONE @ exp(np.full(6, 0.01))).tolist(),
             frame_id='tracker')
    stroke(run, POINTS[:200])
    run.call('parameters', **{'gate.min_distance': 0.0005, 'search.rotations': 100})
    stroke(run, POINTS[200:])
    run.call('parameters', **{'solver.max_iterations': 50, 'collect.max_points': 500})
    assert run.call('register').success
    run.call('parameters', **{'probe.tip_radius': 0.0005})      # withdraws the pose
    assert run.call('register').detail is not None
    assert_replayed(run, tmp_path)


def test_a_node_that_is_deactivated_meanwhile(tmp_path: Path) -> None:
    run = RecordedOperation(bone_field(), CONFIG)
    touch_landmarks(run)
    stroke(run, POINTS[:200])
    assert run.call('register').success
    run.call('collect', data=True)
    run.tip(POINTS[200:300])
    run.change('deactivate')
    run.tip(POINTS[300:400])        # not used
    for name in ('register', 'clear'):
        run.refuse(name, 'the node is inactive; activate it first')
    run.change('activate')
    stroke(run, POINTS[400:])
    assert run.call('register').success
    assert assert_replayed(run, tmp_path).session.status().received == len(POINTS) - 100 + 3 * 50


def tool_at(positions: Array) -> Array:
    """Return poses (n, 4, 4) of a tool whose tip is at these positions, and that tilts."""
    R = [rotation_exp(5.0 * position) for position in positions]
    return np.array([from_rt(turn, position - turn @ np.array(TOOL_TIP))
                     for turn, position in zip(R, positions)])


def test_a_calibration_of_the_tip(tmp_path: Path) -> None:
    run = RecordedOperation(bone_field(), CONFIG)
    run.call('collect', data=True)
    run.tool(tool_at(POINTS[:100]))     # before the tip is known
    run.tool(tool_at(POINTS[:5]), np.array([0.0, 0.0, 0.0, 0.5]))
    run.call('calibrate_tip')
    run.tool(pivoting(np.random.default_rng(0), 10.0, 1.0 / STEP).T_tracker_body)
    assert run.call('calibrate_tip').success
    run.time += 1.0
    run.tool(tool_at(POINTS[100:]))
    run.call('parameters', **{'collect.air': True})
    assert run.call('register', T_tracker_bone=T_TRACKER_BONE.tolist()).success
    done = assert_replayed(run, tmp_path)
    assert done.session.config.probe.tip == run.session.config.probe.tip != []
    assert done.session.status().rejected['calibrating'] > 700
    assert done.session.status().rejected['bad_quaternion'] == 5


MOVING = CONFIG.replaced({
    'reference.topic': ARRAY, 'landmarks.names': ['a', 'b', 'c', 'hip'],
    'landmarks.positions': [*LANDMARKS.ravel(), *HIP_CENTRE], 'landmarks.joint_centre': 'hip'})


class WithArray:
    """Sends samples and poses of a moving array, of which the last samples always wait."""

    def __init__(self, run: RecordedOperation) -> None:
        self.run, self.sway = run, Sway(exp([0.3, -0.2, 0.5, 0.05, -0.1, -1.1]))
        self.T_array_bone = exp([0.1, 0.2, -0.1, 0.02, 0.05, 0.1])

    def tip(self, positions: Array, hidden: slice = slice(0)) -> None:
        """Touch positions (n, 3), bone frame; the array is hidden for some samples."""
        hidden_rows = range(len(positions))[hidden]
        for row, position in enumerate(positions):
            T = self.sway.pose(self.run.time + STEP) @ self.T_array_bone
            self.run.tip(transform(T, position)[None])
            stamp = self.run.time - 2.3 * STEP
            if row not in hidden_rows:
                self.run.array(self.sway.pose(stamp), stamp)


@pytest.fixture
def moving() -> WithArray:
    return WithArray(RecordedOperation(bone_field(), MOVING))


def test_a_moving_reference_array(moving: WithArray, tmp_path: Path) -> None:
    run, points = moving.run, touched_points(600, sigma=0.0002)
    for place in LANDMARKS:
        moving.tip(held(place))
        assert run.call('capture_landmark').success
    run.call('collect', data=True)
    moving.tip(points[:200])
    run.call('collect', data=False)     # while two samples wait
    run.call('collect', data=True)
    moving.tip(points[200:400], hidden=slice(50, 120))      # 0.9 s
    assert run.call('register').success
    moving.tip(points[400:500])
    run.call('clear')                   # drops samples that wait
    run.call('collect', data=True)
    moving.tip(points)
    assert run.call('register', T_tracker_bone=moving.T_array_bone.tolist()).success
    assert_replayed(run, tmp_path, MOVING)


def test_the_poses_of_an_array_end_with_the_configuration(moving: WithArray,
                                                          tmp_path: Path) -> None:
    run = moving.run
    run.call('collect', data=True)
    moving.tip(touched_points(100))
    for name in ('deactivate', 'configure', 'activate'):
        run.change(name)
    run.call('collect', data=True)
    moving.tip(touched_points(100), hidden=slice(3))        # before the first pose
    run.call('register')
    done = assert_replayed(run, tmp_path, None)
    assert done.session.status().rejected['no_reference'] > 2


def test_samples_that_wait_while_the_topics_change_are_counted(moving: WithArray,
                                                               tmp_path: Path) -> None:
    run, points = moving.run, touched_points(600, sigma=0.0002)
    run.call('collect', data=True)
    moving.tip(points[:100])
    before = run.session.status()
    waiting = 100 - before.received
    assert waiting > 0
    run.call('parameters', **{'probe.topics': [TIP, '/probe/other']})
    after = run.session.status()
    assert after.received == 100
    assert after.rejected['no_reference'] == before.rejected['no_reference'] + waiting
    moving.tip(points, hidden=slice(3))         # before the first pose of the new subscription
    assert run.call('register', T_tracker_bone=moving.T_array_bone.tolist()).success
    assert_replayed(run, tmp_path, None)


def test_the_centre_of_a_joint_and_a_landmark_that_is_captured_while_it_is_found(
        moving: WithArray, tmp_path: Path) -> None:
    run = moving.run
    assert run.call('find_joint_centre').success
    swing = leg_swing(np.random.default_rng(1), seconds=20.0, rate=1.0 / STEP)
    for T in swing.T_tracker_body:
        run.time += STEP
        run.array(T, run.time)

    def capture() -> None:
        moving.tip(held(LANDMARKS[0]))
        assert run.call('capture_landmark').success
    assert run.end_joint_search(meanwhile=capture).success
    run.time += 1.0
    run.call('collect', data=True)
    moving.tip(touched_points(600, sigma=0.0002))
    run.call('register', T_tracker_bone=moving.T_array_bone.tolist())
    done = assert_replayed(run, tmp_path, MOVING)
    assert [each.name for each in done.session.status().captured] == ['a', 'hip']


def test_samples_from_before_the_node_are_not_used(tmp_path: Path) -> None:
    """The recorder and the tracker run before the node is started."""
    run = RecordedOperation(bone_field(), CONFIG.replaced({'collect.automatic': True}))
    run.tip(POINTS)
    run.call('register', T_tracker_bone=T_TRACKER_BONE.tolist())
    early = RecordedOperation(bone_field(), CONFIG)
    early.time = -5.0
    early.tip(POINTS[:100])
    run.messages[:0] = [each for each in early.messages if each[1] == TIP]
    assert_replayed(run, tmp_path, None)


def test_a_recorder_that_is_started_before_the_second_session(tmp_path: Path) -> None:
    """The events of the first session are recorded, as they are latched, its samples are not."""
    run = RecordedOperation(bone_field(), CONFIG)
    touch_landmarks(run)
    stroke(run, POINTS[:300])
    assert run.call('register').success
    begin = len(run.messages)
    run.tip(POINTS[:5])         # recorded, and not used
    run.call('clear')
    touch_landmarks(run)
    stroke(run, POINTS[300:])
    assert run.call('register').success
    run.messages = [each for number, each in enumerate(run.messages)
                    if number >= begin or each[1] == EVENTS]
    assert_replayed(run, tmp_path, None)
