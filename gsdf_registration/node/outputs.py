# SPDX-License-Identifier: Apache-2.0
"""
What the node publishes about the bone: poses, results, points, and where to touch next.

`visualization.session_messages` decides what is published after which event.
"""

from __future__ import annotations

from typing import Any

from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from gsdf_registration.common.config import Config
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.live import LivePose
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.node.centre_frame import CentreFrame
from gsdf_registration.node.publishers import PosePublishers
from gsdf_registration.node.qos import LATCHED, RESULT, UNWATCHED
from gsdf_registration.session import Session
from gsdf_registration.visualization.session_messages import SessionMessages
from msg_adapters import results
from msg_adapters.messages import Time
from msg_adapters.session_result import SessionStatus

MISSING = ('gsdf_registration_msgs is not installed: ~/result, ~/guidance, ~/typed/* and '
           '~/drop_stroke are missing, all else works; build it from the repository')
DELIVERY = Duration(seconds=0.2)    # time for the last message of a node that is stopped


class Outputs:
    """Publishes the registered and the live pose with their scene; may be used by any thread."""

    def __init__(self, node: LifecycleNode, config: Config) -> None:
        self._node = node
        self._poses = PosePublishers(node, config)
        self._centre = CentreFrame(node, config.bone_frame)
        self._publishers: dict[str, LifecyclePublisher] = {}
        self._messages = SessionMessages(self, config.bone_frame)
        topics: list[tuple[str, Any, Any]] = [
            ('points', PointCloud2, LATCHED), ('markers', MarkerArray, LATCHED)]
        if results.available():
            kinds = results.message_types()
            topics += [('result', kinds.RegistrationResult, RESULT),
                       ('guidance', kinds.Guidance, LATCHED)]
        else:
            node.get_logger().warning(MISSING, once=True)
        for name, kind, qos in topics:
            self._publishers[name] = node.create_lifecycle_publisher(
                kind, f'~/{name}', qos, event_callbacks=UNWATCHED)

    @property
    def problem(self) -> str:
        """What is wrong with the transform on /tf, and what to do; empty: nothing."""
        return self._poses.problem

    def set_tf_rate(self, rate: float) -> None:
        """Repeat the transform on /tf at this rate, Hz; 0: never."""
        self._poses.set_rate(rate)

    def show_bone(self, field: Field | None, session: Session) -> None:
        """Show this bone from now on, with the registered pose if there is one."""
        self._messages.set_bone(field)
        if field is not None:
            self._centre.show(field)
        self.show_registration(session)

    def show_registration(self, session: Session) -> None:
        """Publish the accepted registration or its withdrawal, if either has changed."""
        self._messages.show_registration(session)

    def withdraw(self, session: Session) -> None:
        """Publish that there is no pose and an empty scene; the session keeps its pose."""
        self._poses.withdraw()
        self._messages.withdraw(session, Withdrawal.DEACTIVATED,
                                'the node is deactivated: activate it to use the pose again')

    def show_live_pose(self, pose: LivePose, frame_id: str) -> None:
        """Publish the live pose."""
        self._poses.publish_live(pose, frame_id)

    def show_assessment(self, found: FullAssessment, session: Session) -> None:
        """Show the live registration if its pose is trusted, else the accepted registration."""
        self._messages.show_assessment(session, found, found.points, found.rejection_reason)

    def destroy(self) -> None:
        """Destroy all publishers, once the last result is delivered."""
        self._messages.set_bone(None)
        self._poses.destroy()
        if 'result' in self._publishers:
            self._publishers['result'].wait_for_all_acked(DELIVERY)
        for publisher in self._publishers.values():
            self._node.destroy_lifecycle_publisher(publisher)
        self._centre.destroy()

    # ---- the outlet of the messages

    def now(self) -> Time:
        """Return the time of the node's clock."""
        return self._node.get_clock().now().to_msg()

    def show_pose(self, status: SessionStatus) -> None:
        """Publish the pose of the accepted registration, or withdraw it."""
        if status.pose_result is None:
            self._poses.withdraw()
        else:
            self._poses.publish(status.pose_result, status.pose_frame_id, status.pose_stamp)

    def send(self, topic: str, message: Any) -> None:
        """Publish a message."""
        self._publishers[topic].publish(message)
