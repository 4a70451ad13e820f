# SPDX-License-Identifier: Apache-2.0
"""
Writes the topics of the node to a recording: the same messages that the node publishes.

`node.outputs` and `node.publishers` publish them; docs/interface.md lists them.
"""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.result import NextTouch
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points, Sample
from gsdf_registration.field import Field
from gsdf_registration.live import LivePose, LiveStatus
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.session import Session
from gsdf_registration.session.status import Status
from gsdf_registration.session.status_values import level_name, shown_message, status_values
from gsdf_registration.visualization.marker_scene import MarkerScene, centre_msg
from msg_adapters import messages, results, ros, stamps
from msg_adapters.bag_writer import BagWriter
from msg_adapters.marker_cdr import Marker, to_bytes
from msg_adapters.messages import DiagnosticArray, DiagnosticStatus, Header
from msg_adapters.session_result import current_msg

NODE = '/registration'
MARKERS = 'visualization_msgs/msg/MarkerArray'
LATCHED = {'/tf_static', *(f'{NODE}/{name}' for name in (
    'bone_pose', 'bone_pose_with_covariance', 'result', 'guidance', 'status', 'events', 'points',
    'markers'))}


class SessionTopics:
    """
    Writes what one session shows at the time `now`.

    Parameters
    ----------
    bag : BagWriter
    session : Session
    field : Field
        Of its bone.

    Attributes
    ----------
    now : float
        Time of what is written, s, clock of the samples.

    """

    def __init__(self, bag: BagWriter, session: Session, field: Field) -> None:
        self.now = 0.0
        self._bag, self._session, self._field = bag, session, field
        self._scene = MarkerScene()
        self._frame = session.config.bone_frame
        self._names: dict[str, str] = {}        # of sessions
        self._status: DiagnosticStatus | None = None
        self._transform: Array | None = None
        self._guidance: tuple[Any, ...] = ()
        self._shows_live = self._has_cloud = False      # what the scene shows at present

    def write_centre(self) -> None:
        """Write the frame at the centre of the bone."""
        self._write('/tf_static', messages.tf_message([centre_msg(self._field, self._frame,
                                                                  self._stamp)]))

    def write_tip(self, sample: Sample) -> None:
        """Write the tip, in the frame of the points."""
        self._write(f'{NODE}/tip', ros.point_msg(sample.position, sample.frame_id,
                                                 ros.seconds_to_stamp(sample.stamp)))

    def write_event(self, event: OperatorEvent) -> None:
        """Write what the operator did."""
        level = DiagnosticStatus.OK if event.success else DiagnosticStatus.WARN
        self._write(f'{NODE}/events', ros.diagnostic_status(NODE, level, event.message,
                                                            event.values()))

    def write_status(self, status: Status, live: LiveStatus, diagnostics: bool = False) -> None:
        """Write the status if it has changed, and with ``diagnostics`` the array of it."""
        message = ros.diagnostic_status(NODE, getattr(DiagnosticStatus, level_name(status)),
                                        shown_message(status), status_values(status, live))
        stamped = ros.with_stamp(message, self._stamp)
        if message != self._status:
            self._status = message
            self._write(f'{NODE}/status', stamped)
        if diagnostics:
            self._write('/diagnostics', DiagnosticArray(
                header=Header(stamp=self._stamp, frame_id=''), status=[stamped]))

    def write_registration(self, status: Status) -> None:
        """Write the accepted registration with its scene, or that there is none."""
        result = status.pose_result
        self._transform = None
        if result is not None and result.T_tracker_bone is not None:
            assert result.covariance is not None    # an accepted registration has one
            stamp, frame = ros.seconds_to_stamp(status.pose_stamp), status.pose_frame_id
            self._transform = result.T_tracker_bone
            self._write(f'{NODE}/bone_pose', ros.pose_msg(result.T_tracker_bone, frame, stamp))
            self._write(f'{NODE}/bone_pose_with_covariance', ros.pose_with_covariance_msg(
                result.T_tracker_bone, result.covariance, frame, stamp))
            self.write_transform(status)
        if results.available():
            self._write(f'{NODE}/result', current_msg(self._renamed(status), self._frame,
                                                      self._stamp))
        self.write_guidance()
        self.write_scene()

    def _renamed(self, status: Status) -> Status:
        """Return a status with sessions named by their number: their names are random."""
        def name(session_id: str) -> str:
            return self._names.setdefault(session_id, str(uuid.UUID(int=len(self._names))))
        withdrawn = status.withdrawn
        return replace(status, session_id=name(status.session_id), withdrawn=(
            None if withdrawn is None else withdrawn._replace(
                session_id=name(withdrawn.session_id))))

    def write_transform(self, status: Status) -> None:
        """Write the transform of the accepted registration, if there is one."""
        if self._transform is not None:
            self._write('/tf', messages.tf_message([ros.transform_msg(
                self._transform, status.pose_frame_id, self._frame, self._stamp)]))

    def write_live_pose(self, pose: LivePose, frame_id: str) -> None:
        """Write the estimate while points come in."""
        self._write(f'{NODE}/live_pose', ros.pose_with_covariance_msg(
            pose.T_tracker_bone, pose.covariance, frame_id, ros.seconds_to_stamp(pose.stamp)))

    def write_assessment(self, found: FullAssessment) -> None:
        """Write the scene of the estimate, and where to touch next."""
        reason = found.rejection_reason
        self.write_guidance(found.next_touches, '' if reason is None else reason.advice)
        if found.T_tracker_bone is not None and found.covariance is not None:
            self._write_scene(found.T_tracker_bone, found.covariance, found.points,
                              found.residuals_m, found.weights, found.next_touches)
            self._shows_live = True
        elif self._shows_live or found.next_touches:
            self.write_scene(found.next_touches)
            self._shows_live = bool(found.next_touches)

    def write_guidance(self, touches: Sequence[NextTouch] = (), sentence: str = '') -> None:
        """Write where to touch next, if that has changed."""
        guidance = results.guidance_content(touches, sentence)
        if results.available() and guidance != self._guidance:
            self._guidance = guidance
            self._write(f'{NODE}/guidance', results.guidance_msg(touches, sentence, self._frame,
                                                                 self._stamp))

    def write_scene(self, next_touches: Sequence[NextTouch] = ()) -> None:
        """Write the accepted registration with its points, or the bone alone."""
        self._shows_live, session = False, self._session
        result, points = session.status().pose_result, session.registered_points()
        if (result is not None and points is not None and result.T_tracker_bone is not None
                and result.covariance is not None and result.residuals_m is not None
                and result.weights is not None):
            self._write_scene(result.T_tracker_bone, result.covariance, points, result.residuals_m,
                              result.weights, next_touches)
            return
        self._write_markers(self._scene.bone(self._field, next_touches))
        if self._has_cloud:
            self._write_cloud(np.zeros((0, 3)), *np.zeros((3, 0)))

    def _write_scene(self, T_tracker_bone: Array, covariance: Array, points: Points,
                     residuals: Array, weights: Array, next_touches: Sequence[NextTouch]) -> None:
        config = self._session.config
        field = self._field.for_tip(config.probe.tip_radius)
        contacts = field.contacts_at(T_tracker_bone, points.positions)
        self._write_markers(self._scene.pose(field, config.limits, T_tracker_bone, covariance,
                                             contacts, residuals, weights, next_touches))
        self._write_cloud(contacts, residuals, weights, points.strokes)

    def _write_markers(self, shown: Sequence[Marker]) -> None:
        self._write_bytes(f'{NODE}/markers', MARKERS, to_bytes(shown, self._frame))

    def _write_cloud(self, contacts: Array, residuals: Array, weights: Array,
                     strokes: NDArray[Any]) -> None:
        self._write(f'{NODE}/points', ros.cloud_msg(contacts, residuals, weights, strokes,
                                                    self._frame, self._stamp))
        self._has_cloud = len(contacts) > 0

    def _write(self, topic: str, message: Any) -> None:
        self._write_bytes(topic, messages.type_of(message), messages.serialized(message))

    def _write_bytes(self, topic: str, kind: str, data: bytes) -> None:
        if topic not in self._bag.counts:
            self._bag.add_topic(topic, kind, messages.definition(kind), topic in LATCHED)
        self._bag.write(topic, stamps.to_nanoseconds(self.now), data)

    @property
    def _stamp(self) -> Any:
        return ros.seconds_to_stamp(self.now)
