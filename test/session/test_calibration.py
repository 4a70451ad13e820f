# SPDX-License-Identifier: Apache-2.0
"""Test the calibration of the tip and the search for a joint centre within a session."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from gsdf_registration.common.config import Config
from gsdf_registration.common.json_values import plain
from gsdf_registration.common.rigid import exp, inverse, quaternion_from_rotation, transform
from gsdf_registration.common.samples import Sample
from gsdf_registration.session import Session
from gsdf_registration.session.record import landmark_from
from gsdf_registration.simulation.moving import Sway
from gsdf_registration.simulation.pivoting import (
    HIP_CENTRE,
    TIP,
    PivotRecording,
    PoseFaults,
    Turning,
    leg_swing,
    pivoting,
)

JOINT = Config.from_flat({
    'reference.topic': '/array', 'landmarks.names': ['hip_centre', 'other'],
    'landmarks.positions': [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]})


def tool_sample(stamp: float, T: np.ndarray, topic: str = '/probe/measured_cp') -> Sample:
    x, y, z = T[:3, 3].tolist()
    qx, qy, qz, qw = quaternion_from_rotation(T[:3, :3]).tolist()
    return Sample(stamp, (x, y, z), 'cam', topic, tool=(x, y, z, qx, qy, qz, qw))


def turn(session: Session, recording: PivotRecording, **more: Any) -> None:
    for stamp, T in zip(recording.stamps.tolist(), recording.T_tracker_body):
        assert session.take(tool_sample(stamp, T, **more))


def record(seconds: float = 12.0, **options: Any) -> PivotRecording:
    return pivoting(np.random.default_rng(0), seconds, **options)


def test_the_second_call_answers_with_the_tip() -> None:
    session = Session(Config())
    session.collect(True)
    assert 'divot' in session.calibrations.calibrate_tip().message
    recording = record()
    turn(session, recording)
    status = session.status()
    count = len(recording.stamps)
    assert status.calibration is not None and status.calibration.poses == count
    assert f'{count} poses so far, turned by' in status.message
    assert status.kept == 0 and status.rejected['calibrating'] == count == status.received
    answer = session.calibrations.calibrate_tip()
    assert answer.success and np.linalg.norm(answer.detail.point - TIP) < 2e-4
    for words in ('tip found', 'deg', 'standard deviation', 'residual', '95 %'):
        assert words in answer.message
    assert session.status().calibration is None and not session.take(tool_sample(99.0, np.eye(4)))


@pytest.mark.parametrize('recording, reason', [
    (record(turning=Turning(np.radians(2.0), np.radians(2.0))), 'range_too_small'),
    (record(turning=Turning(0.0, 0.0)), 'stood_still'),
    (record(20.0, turning=Turning(np.radians(25.0), np.radians(15.0), 20.0, 40.0, 30.0),
            faults=PoseFaults(slips=tuple((2.0 * k, 0.01) for k in range(1, 10)))),
     'slipped')], ids=['small', 'still', 'slips'])
def test_a_bad_pivoting_is_refused_with_one_sentence(recording: PivotRecording,
                                                     reason: str) -> None:
    session = Session(Config())
    session.calibrations.calibrate_tip()
    turn(session, recording)
    answer = session.calibrations.calibrate_tip()
    assert not answer.success and answer.detail is None
    assert answer.message.startswith(f'{reason}: ') and '\n' not in answer.message


def test_positions_of_the_tip_are_still_collected_and_do_not_calibrate() -> None:
    session = Session(Config())
    session.collect(True)
    session.calibrations.calibrate_tip()
    point = Sample(1.0, (0.0, 0.0, 0.0), 'cam', '/other/tip')
    assert not session.take(point) and session.add(point) is None
    answer = session.calibrations.calibrate_tip()
    assert not answer.success and 'no pose of a tool has arrived' in answer.message


def test_of_several_tools_the_one_that_turns_is_calibrated() -> None:
    session = Session(Config())
    session.calibrations.calibrate_tip()
    for i in range(900):
        session.take(tool_sample(0.01 * i, exp([1e-4 * i, 0, 0, 1, 1, 1]), topic='/resting'))
    turn(session, record())
    assert np.linalg.norm(session.calibrations.calibrate_tip().detail.point - TIP) < 2e-4


def test_bad_poses_are_counted_under_their_own_causes() -> None:
    session = Session(Config())
    session.calibrations.calibrate_tip()
    for w, x in ((0.0, 0.0), (float('nan'), 0.0), (1.0, float('nan')), (1.0, 0.0)):
        assert session.take(Sample(1.0, (x, 0.0, 0.0), 'cam', '/t',
                                   tool=(x, 0.0, 0.0, 0.0, 0.0, 0.0, w)))
    rejected = session.status().rejected
    assert (rejected['bad_quaternion'], rejected['not_finite'], rejected['calibrating']) == (2, 1,
                                                                                             1)


def test_the_divot_may_be_on_the_moving_reference_array() -> None:
    session, array, recording = Session(JOINT), Sway(exp([0.1, 0.2, 0.3, 0.0, 0.1, 0.2])), record()
    session.calibrations.calibrate_tip()
    for stamp, T_array_tool in zip(recording.stamps.tolist(), recording.T_tracker_body):
        session.add_reference_pose(stamp, array.pose(stamp))
        session.take(tool_sample(stamp, array.pose(stamp) @ T_array_tool))
    answer = session.calibrations.calibrate_tip()
    assert answer.success and np.linalg.norm(answer.detail.point - TIP) < 3e-4


def swing(session: Session, recording: PivotRecording) -> None:
    for stamp, T in zip(recording.stamps.tolist(), recording.T_tracker_body):
        session.add_reference_pose(stamp, T)


def test_a_joint_centre_becomes_a_landmark_with_its_standard_deviation() -> None:
    session = Session(JOINT)
    assert session.status().remaining_landmarks == ('other',)    # a joint is not touched
    assert 'swing' in session.calibrations.find_joint_centre().message
    recording = leg_swing(np.random.default_rng(0))
    swing(session, recording)
    answer = session.calibrations.find_joint_centre()
    assert answer.success and 'landmark "hip_centre" found' in answer.message
    (landmark,) = session.status().captured
    assert landmark.name == 'hip_centre' and landmark.model.tolist() == [0.1, 0.2, 0.3]
    error = float(np.linalg.norm(landmark.tracker - HIP_CENTRE))
    assert error < 3.0 * landmark.sigma_m < 0.015 and landmark.sigma_m > 0.002

    record = json.loads(json.dumps(plain(landmark)))
    assert landmark_from(record).sigma_m == landmark.sigma_m

    session.calibrations.find_joint_centre()        # once more: it replaces the one before
    swing(session, leg_swing(np.random.default_rng(1)))
    assert session.calibrations.find_joint_centre().success
    (again,) = session.status().captured
    assert not np.array_equal(again.tracker, landmark.tracker)
    assert session.landmarks().names == ('hip_centre',)


def test_the_settings_decide_what_a_joint_centre_says() -> None:
    sigmas = []
    for given in ([], [0.005, 0.0], [0.0, 0.003]):
        session = Session(JOINT.replaced({'landmarks.sigmas': given}))
        session.calibrations.find_joint_centre()
        swing(session, leg_swing(np.random.default_rng(0)))
        session.calibrations.find_joint_centre()
        sigmas.append(session.status().captured[0].sigma_m)
    assert 0.002 < sigmas[0] < sigmas[1] and sigmas[1] > 0.005 and sigmas[2] == 0.0


def test_a_joint_centre_needs_an_array_and_a_place_on_the_model() -> None:
    answer = Session(Config()).calibrations.find_joint_centre()
    assert not answer.success and 'reference.topic' in answer.message
    unnamed = Session(Config.from_flat({'reference.topic': '/array'}))
    answer = unnamed.calibrations.find_joint_centre()
    assert not answer.success and 'add "hip_centre" to landmarks.names' in answer.message
    session = Session(JOINT)
    session.calibrations.find_joint_centre()
    answer = session.calibrations.find_joint_centre()
    assert not answer.success and 'is it in view' in answer.message


def test_nothing_is_collected_while_a_limb_swings() -> None:
    session = Session(JOINT)
    session.collect(True)
    session.calibrations.find_joint_centre()
    assert session.take(Sample(1.0, (0.0, 0.0, 0.0), 'cam', '/probe/tip'))
    assert not session.calibrations.calibrate_tip().success     # one at a time
    assert session.status().rejected['calibrating'] == 1


def test_a_clear_a_restart_and_a_cancel_end_a_calibration() -> None:
    session = Session(Config())
    for end in (session.clear, lambda: session.restart('the clock went back'),
                lambda: session.calibrations.cancel('the node was deactivated')):
        session.calibrations.calibrate_tip()
        end()
        assert session.status().calibration is None
    assert 'cancelled: the node was deactivated' in session.status().message
    session.calibrations.calibrate_tip()
    assert 'calibration is cancelled' in session.clear().message


def test_poses_in_millimetres_are_refused_by_their_unit() -> None:
    session, recording = Session(Config()), record()
    recording.T_tracker_body[:, :3, 3] *= 1e3
    session.calibrations.calibrate_tip()
    turn(session, recording)
    answer = session.calibrations.calibrate_tip()
    assert not answer.success and answer.message.startswith('wrong_unit: ')
    assert 'metres, not mm' in answer.message


def test_a_joint_centre_is_a_measurement_of_the_pose() -> None:
    from smooth_bone import T_TRACKER_BONE as T_ARRAY_BONE
    from smooth_bone import bone_field, touched_points
    place = transform(inverse(T_ARRAY_BONE), HIP_CENTRE)
    session = Session(JOINT.replaced({
        'landmarks.names': ['hip_centre'], 'landmarks.positions': place.tolist(),
        'gate.max_speed': 100.0}), bone_field())
    session.calibrations.find_joint_centre()
    swing(session, leg_swing(np.random.default_rng(0)))
    assert session.calibrations.find_joint_centre().success
    session.collect(True)
    for stamp, point in enumerate(transform(T_ARRAY_BONE, touched_points(400, 0, 3e-4)).tolist()):
        session.add(Sample(1e3 + stamp, tuple(point), 'reference_array', '/probe/tip'))
    result = session.register()
    assert result.success, result.message
    (landmark,), (fit,) = session.status().captured, result.landmarks
    assert fit.used and fit.sigma_m == landmark.sigma_m and fit.residual_m < 4.0 * fit.sigma_m
    other = Session(session.config, bone_field())
    other.restore(session.to_dict())
    assert other.register().T_tracker_bone.tobytes() == result.T_tracker_bone.tobytes()


@pytest.mark.parametrize('own, error', [([], 5e-4), ([0.0, 0.0, 0.2], 1e-4)])
def test_a_restored_session_brings_its_tip_with_the_error_unless_one_is_set(
        own: list[float], error: float) -> None:
    from smooth_bone import bone_field
    saved = Session(Config().replaced({'probe.tip': [0.0, 0.0, 0.1]}), bone_field())
    followed: dict[str, Any] = {}
    saved.listen(followed.__setitem__)
    saved.configure(saved.config.replaced({'probe.tip_error': 5e-4}))
    assert followed['tip_error'] == 5e-4
    session = Session(Config().replaced({'probe.tip': own, 'probe.tip_error': 1e-4}), bone_field())
    session.restore(saved.to_dict())
    assert session.config.probe.tip == (own or [0.0, 0.0, 0.1])
    assert session.config.probe.tip_error == error
