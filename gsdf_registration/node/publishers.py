# SPDX-License-Identifier: Apache-2.0
"""What the node says, where, and how reliably."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from rclpy.timer import Timer

try:
    from tf2_msgs.msg import TFMessage
except ImportError:     # not among the wheels; on a ROS install it is there
    TFMessage = None

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.live import LivePose, LiveStatus
from gsdf_registration.node.qos import LATCHED, UNWATCHED
from gsdf_registration.node.status import status_message
from gsdf_registration.session.status import Status
from msg_adapters import ros


class StatusPublisher:
    """Publishes ``~/status`` (latched, on change) and ``/diagnostics``, in every node state."""

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node
        self._last: DiagnosticStatus | None = None
        self._state = ''
        self._status = node.create_publisher(DiagnosticStatus, '~/status', LATCHED,
                                             event_callbacks=UNWATCHED)
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10,
                                                  event_callbacks=UNWATCHED)

    def show(self, status: Status, live: LiveStatus) -> DiagnosticStatus:
        """Publish ``~/status`` if it says something new; return its message."""
        message = status_message(status, live, self._node.get_fully_qualified_name())
        if status.state == 'ready' and self._state != 'ready':
            self._node.get_logger().info(status.message)
        self._state = status.state
        if message != self._last:
            self._last = message
            self._status.publish(message)
        return message

    def tick(self, status: Status, live: LiveStatus) -> None:
        """Publish both; called once a second."""
        stamp = self._node.get_clock().now().to_msg()
        message = DiagnosticArray(status=[self.show(status, live)])
        message.header.stamp = stamp
        self._diagnostics.publish(message)


class PosePublishers:
    """
    Publishes the registration and the live pose; silent unless active.

    The transform goes to /tf and is re-sent, never to /tf_static: in Jazzy a second static
    transform of a frame is dropped without a word, so that nobody would hear of a new registration.
    """

    def __init__(self, node: LifecycleNode, config: Config) -> None:
        self._node = node
        self._frame_id = config.model.frame_id
        self._pose, self._pose_with_covariance = self._latched()
        create = node.create_lifecycle_publisher
        self._live_pose = create(PoseWithCovarianceStamped, '~/live_pose', 10)
        self._tf = create(TFMessage, '/tf', 100, event_callbacks=UNWATCHED) if TFMessage else None
        self._transform: TransformStamped | None = None
        self._timer: Timer | None = None
        self.configure(config)
        if TFMessage is None:
            node.get_logger().warning('tf2_msgs cannot be imported; nothing is published on /tf')

    def configure(self, config: Config) -> None:
        """Re-send the transform at ``tf.rate`` from now on."""
        self._rate = config.tf.rate
        self._time()

    def _time(self) -> None:
        """Have the transform re-sent, if there is one: a timer for nothing costs, too."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._timer = None
        if self._transform is not None and self._tf is not None and self._rate > 0.0:
            self._timer = self._node.create_timer(1.0 / self._rate, self._resend)

    def publish(self, result: RegistrationResult, frame_id: str) -> None:
        """Publish a good pose in ``frame_id`` to everyone, late joiners included."""
        T, covariance = result.T_tracker_bone, result.covariance
        assert T is not None and covariance is not None     # a good pose has both
        stamp = self._node.get_clock().now().to_msg()
        self._pose.publish(ros.pose_msg(T, frame_id, stamp))
        self._pose_with_covariance.publish(
            ros.pose_with_covariance_msg(T, covariance, frame_id, stamp))
        self._transform = ros.transform_msg(T, frame_id, self._frame_id, stamp)
        self._resend()
        self._time()

    def forget(self) -> None:
        """Take the pose off the air: it is not re-sent, and late joiners hear of none."""
        if self._transform is None:
            return
        self._transform = None
        self._time()
        for publisher in (self._pose, self._pose_with_covariance):
            self._node.destroy_lifecycle_publisher(publisher)
        self._pose, self._pose_with_covariance = self._latched()
        for publisher in (self._pose, self._pose_with_covariance):
            publisher.on_activate(None)     # as it was, or nothing would have been published

    def _latched(self) -> list[LifecyclePublisher]:
        """Return publishers of the pose that have nothing for late joiners yet."""
        create = self._node.create_lifecycle_publisher
        return [create(kind, topic, LATCHED, event_callbacks=UNWATCHED) for kind, topic in (
            (PoseStamped, '~/bone_pose'),
            (PoseWithCovarianceStamped, '~/bone_pose_with_covariance'))]

    def publish_live(self, pose: LivePose, frame_id: str) -> None:
        """Publish the present estimate, stamped as the newest point in it."""
        self._live_pose.publish(
            ros.pose_with_covariance_msg(pose.T_tracker_bone, pose.covariance, frame_id,
                                         ros.seconds_to_stamp(pose.stamp)))

    def _resend(self) -> None:
        if self._transform is not None and self._tf is not None:
            self._transform.header.stamp = self._node.get_clock().now().to_msg()
            self._tf.publish(TFMessage(transforms=[self._transform]))

    def destroy(self) -> None:
        """Take everything off the air."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        for publisher in (self._pose, self._pose_with_covariance, self._live_pose, self._tf):
            if publisher is not None:
                self._node.destroy_lifecycle_publisher(publisher)
