# SPDX-License-Identifier: Apache-2.0
"""
Writes the topics of the node to a recording: the same messages that the node publishes.

docs/interface.md lists them. `visualization.session_messages` decides, as for the node, what is
written after which event.
"""

from __future__ import annotations

import uuid
from typing import Any

from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Sample
from gsdf_registration.field import Field
from gsdf_registration.live import LivePose, LiveStatus
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.session import Session
from gsdf_registration.session.status import Status
from gsdf_registration.session.status_message import status_message
from gsdf_registration.visualization.marker_scene import centre_msg
from gsdf_registration.visualization.session_messages import SessionMessages
from msg_adapters import messages, ros, stamps
from msg_adapters.bag_writer import BagWriter
from msg_adapters.messages import DiagnosticArray, DiagnosticStatus, Header, Time
from msg_adapters.session_result import SessionStatus

NODE = '/registration'
MARKERS = 'visualization_msgs/msg/MarkerArray'
LATCHED = {'/tf_static', *(f'{NODE}/{name}' for name in (
    'bone_pose', 'bone_pose_with_covariance', 'result', 'guidance', 'status', 'events', 'points',
    'markers'))}


class SessionTopics:
    """
    Writes what one session shows at the time `time`.

    Parameters
    ----------
    bag : BagWriter
    session : Session
    field : Field
        Of its bone.

    Attributes
    ----------
    time : float
        Of what is written, s, clock of the samples.

    """

    def __init__(self, bag: BagWriter, session: Session, field: Field) -> None:
        self.time = 0.0
        self._bag, self._session, self._field = bag, session, field
        self._frame = session.config.bone_frame
        self._messages = SessionMessages(self, self._frame)
        self._messages.set_bone(field)
        self._sessions: dict[str, int] = {}     # their numbers
        self._status: DiagnosticStatus | None = None
        self._transform: Array | None = None

    def write_centre(self) -> None:
        """Write the frame at the centre of the bone."""
        self._write('/tf_static', messages.tf_message([centre_msg(self._field, self._frame,
                                                                  self.now())]))

    def write_tip(self, sample: Sample) -> None:
        """Write the tip, in the frame of the points."""
        self.send('tip', ros.point_msg(sample.position, sample.frame_id,
                                       ros.seconds_to_stamp(sample.stamp)))

    def write_event(self, event: OperatorEvent) -> None:
        """Write what the operator did."""
        self.send('events', ros.event_msg(event, NODE))

    def write_status(self, status: Status, live: LiveStatus, diagnostics: bool = False) -> None:
        """Write the status if it has changed, and with ``diagnostics`` the array of it."""
        message = status_message(status, live, NODE)
        stamped = ros.with_stamp(message, self.now())
        if message != self._status:
            self._status = message
            self.send('status', stamped)
        if diagnostics:
            self._write('/diagnostics', DiagnosticArray(
                header=Header(stamp=self.now(), frame_id=''), status=[stamped]))

    def write_registration(self) -> None:
        """Write the accepted registration or its withdrawal, with the scene, if it has changed."""
        self._messages.show_registration(self._session)

    def write_assessment(self, found: FullAssessment) -> None:
        """Write the scene of the estimate, and where to touch next."""
        self._messages.show_assessment(self._session, found, found.points, found.rejection_reason)

    def write_transform(self, status: SessionStatus) -> None:
        """Write the transform of the accepted registration, if there is one."""
        if self._transform is not None:
            self._write('/tf', messages.tf_message([ros.transform_msg(
                self._transform, status.pose_frame_id, self._frame, self.now())]))

    def write_live_pose(self, pose: LivePose, frame_id: str) -> None:
        """Write the estimate while points come in."""
        self.send('live_pose', ros.pose_with_covariance_msg(
            pose.T_tracker_bone, pose.covariance, frame_id, ros.seconds_to_stamp(pose.stamp)))

    # ---- the outlet of the messages

    def now(self) -> Time:
        """Return the present time."""
        return ros.seconds_to_stamp(self.time)

    def show_pose(self, status: SessionStatus) -> None:
        """Write the pose of the accepted registration, if there is one."""
        result = status.pose_result
        self._transform = None
        if result is not None and result.T_tracker_bone is not None:
            assert result.covariance is not None    # an accepted registration has one
            stamp, frame = ros.seconds_to_stamp(status.pose_stamp), status.pose_frame_id
            self._transform = result.T_tracker_bone
            self.send('bone_pose', ros.pose_msg(result.T_tracker_bone, frame, stamp))
            self.send('bone_pose_with_covariance', ros.pose_with_covariance_msg(
                result.T_tracker_bone, result.covariance, frame, stamp))
            self.write_transform(status)

    def send(self, topic: str, message: Any) -> None:
        """Write a message on a topic of the node."""
        if topic == 'markers':
            self._write_bytes(f'{NODE}/{topic}', MARKERS, message)
            return
        if topic == 'result':       # sessions are numbered: their names are random
            number = self._sessions.setdefault(message.session_id, len(self._sessions))
            message.session_id = str(uuid.UUID(int=number))
        self._write(f'{NODE}/{topic}', message)

    def _write(self, topic: str, message: Any) -> None:
        self._write_bytes(topic, messages.type_of(message), messages.serialized(message))

    def _write_bytes(self, topic: str, kind: str, data: bytes) -> None:
        if topic not in self._bag.counts:
            self._bag.add_topic(topic, kind, messages.definition(kind), topic in LATCHED)
        self._bag.write(topic, stamps.to_nanoseconds(self.time), data)
