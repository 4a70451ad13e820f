# SPDX-License-Identifier: Apache-2.0
"""Publishers of ``~/result`` and ``~/guidance``, and the messages of the typed services."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import NextTouch, RegistrationResult
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.node.qos import LATCHED, RESULT, UNWATCHED
from gsdf_registration.session import Session
from gsdf_registration.session.status import Status
from msg_adapters import results, ros
from msg_adapters.session_result import current_msg, header_of, registration_msg

MISSING = ('gsdf_registration_msgs is not installed: ~/result, ~/guidance, ~/typed/* and '
           '~/drop_stroke are missing, all else works; build it from the repository')
DELIVERY = Duration(seconds=0.2)    # time for the last message of a node that is stopped


class ResultPublishers:
    """
    Publishes ``~/result`` and ``~/guidance`` (latched) while the node is active.

    Without the package gsdf_registration_msgs it reports that once and does nothing.
    """

    def __init__(self, node: LifecycleNode, config: Config) -> None:
        self._node, self._bone_frame = node, config.bone_frame
        self._publishers: list[LifecyclePublisher] = []
        self._guidance: tuple[Any, ...] = ()       # published last
        if not results.available():
            node.get_logger().warning(MISSING, once=True)
            return
        kinds = results.message_types()
        self._publishers = [
            node.create_lifecycle_publisher(kind, topic, qos, event_callbacks=UNWATCHED)
            for kind, topic, qos in ((kinds.RegistrationResult, '~/result', RESULT),
                                     (kinds.Guidance, '~/guidance', LATCHED))]

    def publish(self, status: Status) -> None:
        """Publish the accepted registration, or why there is none."""
        if not self._publishers:
            return
        now = self._node.get_clock().now().to_msg()
        self._publishers[0].publish(current_msg(status, self._bone_frame, now))

    def withdraw(self, status: Status, reason: Withdrawal, sentence: str) -> None:
        """Publish that the pose is withdrawn, if there is one."""
        if self._publishers and status.pose_result is not None:
            now = self._node.get_clock().now().to_msg()
            self._publishers[0].publish(results.withdrawal_msg(
                reason, sentence, header_of(status, self._bone_frame, now)))

    def guide(self, touches: Sequence[NextTouch] = (), sentence: str = '') -> None:
        """Publish where to touch next, if that has changed."""
        guidance = results.guidance_content(touches, sentence)
        if self._publishers and guidance != self._guidance:
            self._guidance = guidance
            self._publishers[1].publish(results.guidance_msg(
                touches, sentence, self._bone_frame, self._node.get_clock().now().to_msg()))

    def destroy(self) -> None:
        """Destroy the publishers, once their last messages are delivered."""
        for publisher in self._publishers[:1]:
            publisher.wait_for_all_acked(DELIVERY)
        for publisher in self._publishers:
            self._node.destroy_lifecycle_publisher(publisher)


def attempt_message(result: RegistrationResult, session: Session, now: float) -> Any:
    """Return the message of one attempt at time ``now``, s, accepted or rejected."""
    status = session.status()
    header = header_of(status, session.config.bone_frame, ros.seconds_to_stamp(now))
    if not result.success:
        header = header._replace(registration_id=0, pose_stamp=0.0)
    return registration_msg(result, status, header)


def pose_identity(status: Status) -> tuple[str, int]:
    """Return session and number of the registration in force, or of the one withdrawn last."""
    if status.pose_result is None and status.withdrawn is not None:
        return status.withdrawn.session_id, status.withdrawn.registration_id
    return status.session_id, status.registration_id
