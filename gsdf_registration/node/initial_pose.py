# SPDX-License-Identifier: Apache-2.0
"""The subscription of ``~/initial_pose``, a first guess as ``initialpose`` of Nav2."""

from __future__ import annotations

from typing import Any, Protocol

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rclpy.impl.rcutils_logger import RcutilsLogger

from gsdf_registration.common.result import InputError
from gsdf_registration.node.events import EventPublisher
from gsdf_registration.session import Answer, Session
from msg_adapters import ros


class InitialPoseNode(Protocol):
    """The node, as far as the subscription uses it."""

    session: Session
    events: EventPublisher
    state: str

    def get_logger(self) -> RcutilsLogger:
        """Return the logger of the node."""

    def create_subscription(self, msg_type: Any, topic: str, callback: Any,
                            qos_profile: int) -> Any:
        """Create a subscription."""

    def destroy_subscription(self, subscription: Any) -> bool:
        """Destroy a subscription."""

    def registration_finished(self, success: bool) -> None:
        """Let the live registration search again from its first guess."""


class InitialPoseInput:
    """
    Passes the poses of ``~/initial_pose`` to the session while the node is active.

    The covariance and the stamp are not used.  A pose that cannot be used is rejected; log and
    status say why.
    """

    def __init__(self, node: InitialPoseNode) -> None:
        self._node = node
        self._subscription = node.create_subscription(
            PoseWithCovarianceStamped, '~/initial_pose', self._on_pose, 10)

    def destroy(self) -> None:
        """Remove the subscription."""
        self._node.destroy_subscription(self._subscription)

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        node = self._node
        if node.state != 'active':
            return
        answer = self._use(message)
        if answer.success:
            node.get_logger().info(answer.message)
            node.registration_finished(True)
        else:
            node.get_logger().warning(answer.message, throttle_duration_sec=1.0)

    def _use(self, message: PoseWithCovarianceStamped) -> Answer:
        session = self._node.session
        try:
            _, T, frame_id = ros.pose_from(PoseStamped(header=message.header,
                                                       pose=message.pose.pose))
        except InputError as error:
            answer = Answer(False, f'the initial pose is rejected: {error.message}')
            session.set_notice(answer.message, warning=True)
            return answer
        place = self._node.events.begin(session.kept)
        answer = session.set_initial_pose(T, frame_id)
        self._node.events.publish('initial_pose', place, answer, {
            'T_tracker_bone': T.tolist(), 'frame_id': frame_id})
        return answer
