# SPDX-License-Identifier: Apache-2.0
"""
Messages of gsdf_registration_msgs from results.

The package is optional: only after `available` returns true may the other functions be called.
Metres and radians, as in the messages; a number that is not known becomes NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common.result import (
    LandmarkFit,
    NextTouch,
    RegistrationResult,
    WeakestDirection,
)
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.common.withdrawal import Withdrawal
from msg_adapters import ros
from msg_adapters.messages import (
    Header,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    Time,
    Vector3,
)

NAN = float('nan')
OVER_THE_BONE = ('rms', 'max')  # entries of `RegistrationResult.predicted_tre_m` beside the targets


class ResultHeader(NamedTuple):
    """The registration that a message is about, and when the message was made."""

    stamp: Time
    frame_id: str           # of the points, in which the pose is given
    bone_frame_id: str
    session_id: str
    registration_id: int    # from 1; 0: none yet
    pose_stamp: float = 0.0     # s, of the newest point that the pose was found from


class Stroke(Protocol):
    """A stroke at the registered pose."""

    @property
    def number(self) -> int:
        """Number in the session, from 1."""

    @property
    def points(self) -> int:
        """Number of points."""

    @property
    def share_on_bone(self) -> float:
        """Share of the points on the bone, 0 to 1."""

    @property
    def rms_m(self) -> float | None:
        """RMS residual of those on the bone, m; None if none is."""

    @property
    def interference(self) -> bool:
        """Whether hardly any point is on the bone."""


class Landmark(Protocol):
    """A captured landmark."""

    @property
    def name(self) -> str:
        """Name."""

    @property
    def model(self) -> Array:
        """Position on the model (3,), m, bone frame."""

    @property
    def tracker(self) -> Array:
        """Where the tip touched it (3,), m, frame of the points."""


@cache
def available() -> bool:
    """Return whether gsdf_registration_msgs is installed and built for this Python."""
    try:
        message = message_types().RegistrationResult
    except (ImportError, AttributeError):   # a folder of this name without the built messages
        return False
    type(message).__import_type_support__()
    return type(message)._TYPE_SUPPORT is not None


def result_msg(result: RegistrationResult, header: ResultHeader, *,
               rejected: Mapping[str, int] | None = None, strokes: Sequence[Stroke] = (),
               landmarks: Sequence[Landmark] = ()) -> Any:
    """
    Return the RegistrationResult message of an accepted or rejected registration.

    Parameters
    ----------
    result : RegistrationResult
    header : ResultHeader
    rejected : mapping of str to int, optional
        Number of rejected points by cause.
    strokes, landmarks : sequences
        What the registration was found with.

    """
    message = _empty_result(header)
    message.valid, message.reason = result.success, _reason(result.reason.name)
    message.message, message.grade = result.message, result.grade or ''
    if result.T_tracker_bone is not None:
        message.pose = _pose(result.T_tracker_bone, result.covariance)
        message.pose_stamp = ros.seconds_to_stamp(header.pose_stamp)
    tre = result.predicted_tre_m
    message.target_names = [name for name in tre if name not in OVER_THE_BONE]
    message.target_tre = [_number(tre[name]) for name in message.target_names]
    message.tre_rms, message.tre_max = (_number(tre.get(name)) for name in OVER_THE_BONE)
    if result.zone is not None:
        message.zone_limit, message.zone_distance = result.zone.limit_m, result.zone.distance_m
        message.zone_share = result.zone.bone_share
        message.target_p95 = [result.zone.p95_m[name] for name in message.target_names]
    message.sigma = _number(result.sigma_m)
    message.residual_rms = _number(result.residual_rms_m)
    message.runner_up_ratio = _number(result.runner_up_ratio)
    message.received, message.used, message.inliers = result.received, result.used, result.inliers
    message.rejected_causes = list(rejected or ())
    message.rejected_counts = list((rejected or {}).values())
    message.strokes = [stroke_msg(each) for each in strokes]
    fits = {fit.name: fit for fit in result.landmarks}
    message.landmarks = [landmark_msg(each, result.T_tracker_bone, fits.get(each.name))
                         for each in landmarks]
    if result.weakest_direction is not None:
        message.weakest_direction = weakest_direction_msg(result.weakest_direction)
    return message


def withdrawal_msg(reason: Withdrawal, sentence: str, header: ResultHeader) -> Any:
    """Return the RegistrationResult message that withdraws the pose; ``sentence`` says why."""
    message = _empty_result(header)
    message.reason, message.message = _reason(reason.name), sentence
    return message


def stroke_msg(stroke: Stroke) -> Any:
    """Return the StrokeReport message of a stroke."""
    return message_types().StrokeReport(number=stroke.number, points=stroke.points,
                                 on_bone=round(stroke.share_on_bone * stroke.points),
                                 rms=_number(stroke.rms_m), interference=stroke.interference)


def landmark_msg(landmark: Landmark, T_tracker_bone: Array | None,
                 fit: LandmarkFit | None = None) -> Any:
    """
    Return the LandmarkReport message of a landmark at a pose (4, 4), or without one.

    ``fit``: of a landmark with a standard deviation, in the registration of this pose.
    """
    miss = NAN
    if T_tracker_bone is not None:
        miss = float(np.linalg.norm(transform(T_tracker_bone, landmark.model) - landmark.tracker))
    return message_types().LandmarkReport(name=landmark.name, model=_point(landmark.model),
                                   touched=_point(landmark.tracker), miss=miss,
                                   sigma=0.0 if fit is None else fit.sigma_m,
                                   deviations=NAN if fit is None else fit.deviations,
                                   used=fit is not None and fit.used)


def weakest_direction_msg(direction: WeakestDirection) -> Any:
    """Return the WeakestDirection message of a direction."""
    return message_types().WeakestDirection(
        axis=_vector(direction.axis), point=_point(direction.point),
        pitch=float(direction.pitch_m_per_rad), sentence=direction.sentence,
        rotation_sigma=float(direction.rotation_sigma_rad),
        translation_sigma=float(direction.translation_sigma_m))


def guidance_content(touches: Sequence[NextTouch], sentence: str) -> tuple[Any, ...]:
    """Return what `guidance_msg` says, to find out whether it has changed."""
    return (sentence, *((*touch.position, touch.predicted_tre, touch.current_tre)
                        for touch in touches))


def guidance_msg(touches: Sequence[NextTouch], sentence: str, bone_frame_id: str,
                 stamp: Time) -> Any:
    """Return the Guidance message of places to touch next, best first."""
    return message_types().Guidance(
        header=Header(stamp=stamp, frame_id=bone_frame_id), sentence=sentence,
        points=[_point(touch.position) for touch in touches],
        normals=[_vector(touch.normal) for touch in touches],
        predicted_tre=[_number(touch.predicted_tre) for touch in touches],
        current_tre=_number(touches[0].current_tre if touches else None))


def message_types() -> Any:
    """Return the module of the message classes; imported on use because it may be missing."""
    return import_module('gsdf_registration_msgs.msg')


def service_types() -> Any:
    """Return the module of the service classes."""
    return import_module('gsdf_registration_msgs.srv')


def _reason(name: str) -> int:
    return int(getattr(message_types().RegistrationResult, name))


def _empty_result(header: ResultHeader) -> Any:
    """Return a RegistrationResult that is not valid, with every number unknown."""
    weakest = message_types().WeakestDirection(pitch=NAN, rotation_sigma=NAN, translation_sigma=NAN)
    return message_types().RegistrationResult(
        header=Header(stamp=header.stamp, frame_id=header.frame_id),
        bone_frame_id=header.bone_frame_id, session_id=header.session_id,
        registration_id=header.registration_id,
        pose=PoseWithCovariance(pose=Pose(position=Point(x=NAN, y=NAN, z=NAN),
                                          orientation=Quaternion(x=NAN, y=NAN, z=NAN, w=NAN)),
                                covariance=np.full(36, NAN)),
        tre_rms=NAN, tre_max=NAN, sigma=NAN, residual_rms=NAN, runner_up_ratio=NAN,
        weakest_direction=weakest)


def _pose(T: Array, covariance: Array | None) -> PoseWithCovariance:
    known = np.full((6, 6), NAN) if covariance is None else covariance
    return ros.pose_with_covariance_msg(T, known, '', Time()).pose


def _number(value: float | None) -> float:
    return NAN if value is None else float(value)


def _point(position: ArrayLike) -> Point:
    return ros.point_msg(position, '', Time()).point


def _vector(direction: ArrayLike) -> Vector3:
    x, y, z = (float(value) for value in np.asarray(direction, dtype=np.float64))
    return Vector3(x=x, y=y, z=z)
