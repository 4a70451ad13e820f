# SPDX-License-Identifier: Apache-2.0

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsdf_registration.common.result import (
    LandmarkFit,
    NextTouch,
    Reason,
    RegistrationResult,
    WeakestDirection,
    Zone,
)
from gsdf_registration.common.rigid import exp, transform
from gsdf_registration.common.withdrawal import Withdrawal

try:
    from rclpy.serialization import deserialize_message, serialize_message

    from msg_adapters import results, ros
except ImportError:
    results = None

pytestmark = pytest.mark.skipif(
    results is None or not results.available(),
    reason='gsdf_registration_msgs is not built, see tools/build_messages.py')

T = exp(np.array([0.3, -0.2, 0.1, 0.01, 0.02, -0.5]))
COVARIANCE = np.arange(36.0).reshape(6, 6)
WEAKEST = WeakestDirection(np.array([0.0, 0.6, 0.8]), np.array([0.01, 0.02, 0.03]), 0.005, 1e-3,
                           2e-4, 'least constrained: a rotation')
ACCEPTED = RegistrationResult(
    Reason.CONVERGED, 'registered', T, COVARIANCE, received=120, used=100, inliers=90,
    sigma_m=3e-4, residual_rms_m=2.5e-4,
    predicted_tre_m={'neck': 4e-4, 'cup': 6e-4, 'rms': 5e-4, 'max': 9e-4},
    weakest_direction=WEAKEST, runner_up_ratio=7.5,
    zone=Zone(2e-3, 0.15, 0.6, {'neck': 7e-4, 'cup': 1e-3}, 1.5e-3, 4e-3))
STROKES = [SimpleNamespace(number=1, points=60, share_on_bone=0.9, rms_m=2e-4, interference=False),
           SimpleNamespace(number=3, points=60, share_on_bone=0.0, rms_m=None, interference=True)]
LANDMARK = SimpleNamespace(name='tip', model=np.array([0.1, 0.0, 0.0]),
                           tracker=transform(T, np.array([0.1, 0.003, 0.004])))


def header():
    return results.ResultHeader(ros.seconds_to_stamp(12.25), 'tracker', 'hip', 'a1b2', 4, 11.5)


def sent(message):
    """Return the message after it has been serialized and deserialized by ROS."""
    return deserialize_message(serialize_message(message), type(message))


def position_of(point):
    return [point.x, point.y, point.z]


def test_an_accepted_registration_keeps_all_its_numbers():
    message = sent(results.result_msg(ACCEPTED, header(), rejected={'too_fast': 2, 'stale': 0}))
    assert message.valid and message.reason == message.CONVERGED
    assert message.message == 'registered' and message.grade == 'B'
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (12, 250_000_000)
    assert (message.header.frame_id, message.bone_frame_id) == ('tracker', 'hip')
    assert (message.session_id, message.registration_id) == ('a1b2', 4)
    assert ros.stamp_to_seconds(message.pose_stamp) == 11.5
    pose = message.pose.pose
    assert position_of(pose.position) == T[:3, 3].tolist()
    turn = pose.orientation
    assert np.allclose(Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(), T[:3, :3])
    assert np.array_equal(message.pose.covariance, COVARIANCE.ravel())
    assert message.target_names == ['neck', 'cup'] and list(message.target_tre) == [4e-4, 6e-4]
    assert (message.tre_rms, message.tre_max) == (5e-4, 9e-4)
    assert (message.sigma, message.residual_rms, message.runner_up_ratio) == (3e-4, 2.5e-4, 7.5)
    assert (message.received, message.used, message.inliers) == (120, 100, 90)
    assert message.rejected_causes == ['too_fast', 'stale']
    assert list(message.rejected_counts) == [2, 0]
    assert (message.zone_limit, message.zone_distance, message.zone_share) == (2e-3, 0.15, 0.6)
    assert list(message.target_p95) == [7e-4, 1e-3]


def test_strokes_are_reported_with_points_on_the_bone():
    first, second = sent(results.result_msg(ACCEPTED, header(), strokes=STROKES)).strokes
    assert (first.number, first.points, first.on_bone, first.rms) == (1, 60, 54, 2e-4)
    assert not first.interference
    assert (second.number, second.on_bone, second.interference) == (3, 0, True)
    assert math.isnan(second.rms)


def test_landmarks_are_reported_with_their_miss():
    report, = sent(results.result_msg(ACCEPTED, header(), landmarks=[LANDMARK])).landmarks
    assert report.name == 'tip'
    assert position_of(report.model) == [0.1, 0.0, 0.0]
    assert position_of(report.touched) == LANDMARK.tracker.tolist()
    assert report.miss == pytest.approx(0.005)
    assert report.sigma == 0.0 and math.isnan(report.deviations) and not report.used


def test_a_landmark_that_was_a_measurement_is_reported_against_its_standard_deviation():
    fit = LandmarkFit('tip', False, 0.001, 0.005, 5.0)
    measured = dataclasses.replace(ACCEPTED, landmarks=(fit,))
    report, = sent(results.result_msg(measured, header(), landmarks=[LANDMARK])).landmarks
    assert (report.sigma, report.deviations, report.used) == (0.001, 5.0, False)


def test_the_weakest_direction_is_given_as_a_screw():
    weakest = sent(results.result_msg(ACCEPTED, header())).weakest_direction
    assert position_of(weakest.axis) == [0.0, 0.6, 0.8]
    assert position_of(weakest.point) == [0.01, 0.02, 0.03]
    assert (weakest.pitch, weakest.rotation_sigma, weakest.translation_sigma) == (5e-3, 1e-3, 2e-4)
    assert weakest.sentence == WEAKEST.sentence


@pytest.mark.parametrize('reason', [reason for reason in Reason if reason != Reason.CONVERGED])
def test_a_rejected_registration_has_its_reason_and_no_pose(reason):
    rejected = RegistrationResult.refused(reason, 'touch more', received=7)
    message = sent(results.result_msg(rejected, header(), landmarks=[LANDMARK]))
    assert not message.valid and message.grade == ''
    assert message.reason == getattr(message, reason.name)
    assert message.message == 'touch more' and message.received == 7
    assert_unknown(message)
    assert math.isnan(message.landmarks[0].miss)


@pytest.mark.parametrize('reason', list(Withdrawal))
def test_a_withdrawal_has_its_reason_and_no_pose(reason):
    message = sent(results.withdrawal_msg(reason, 'the session was cleared', header()))
    assert not message.valid and message.registration_id == 4
    assert message.reason == getattr(message, reason.name)
    assert message.message == 'the session was cleared'
    assert_unknown(message)


def assert_unknown(message):
    pose, weakest = message.pose.pose, message.weakest_direction
    assert np.isnan(position_of(pose.position)).all()
    assert ros.stamp_to_seconds(message.pose_stamp) == 0.0
    assert np.isnan([pose.orientation.w, *message.pose.covariance]).all()
    assert np.isnan([message.tre_rms, message.tre_max, message.sigma, message.residual_rms,
                     message.runner_up_ratio, weakest.rotation_sigma]).all()
    assert weakest.sentence == '' and position_of(weakest.axis) == [0.0, 0.0, 0.0]


def test_guidance_lists_places_with_the_error_after_each_touch():
    touches = [NextTouch(np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, 1.0]), 1e-3, 2e-3),
               NextTouch(np.array([0.0, 0.1, 0.2]), np.array([1.0, 0.0, 0.0]))]
    message = sent(results.guidance_msg(touches, 'touch the rim', 'hip', header().stamp))
    assert message.header.frame_id == 'hip' and message.sentence == 'touch the rim'
    assert [position_of(point) for point in message.points] == [[0.1, 0.2, 0.3], [0.0, 0.1, 0.2]]
    assert [position_of(normal) for normal in message.normals] == [[0, 0, 1], [1, 0, 0]]
    assert message.predicted_tre[0] == 1e-3 and math.isnan(message.predicted_tre[1])
    assert message.current_tre == 2e-3


def test_guidance_without_a_place_is_empty():
    message = sent(results.guidance_msg([], 'register', 'hip', header().stamp))
    assert message.points == [] and math.isnan(message.current_tre)
