# SPDX-License-Identifier: Apache-2.0
"""Publishers of the status and of the poses."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from rclpy.lifecycle import LifecycleNode, LifecyclePublisher
from rclpy.timer import Timer

try:
    from tf2_msgs.msg import TFMessage
except ImportError:     # there is no wheel of it; a ROS installation has it
    TFMessage = None

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.live import LivePose, LiveStatus
from gsdf_registration.node.frame_watch import FrameWatch
from gsdf_registration.node.qos import LATCHED, STEADY, UNWATCHED
from gsdf_registration.session.status import Status
from gsdf_registration.session.status_message import status_message
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

    def publish_status(self, status: Status, live: LiveStatus) -> DiagnosticStatus:
        """Publish ``~/status`` if anything but its stamp has changed; return the message."""
        message = status_message(status, live, self._node.get_fully_qualified_name())
        if status.state == 'ready' and self._state != 'ready':
            self._node.get_logger().info(status.message)
        self._state = status.state
        changed, self._last = message != self._last, message
        stamped = ros.with_stamp(message, self._node.get_clock().now().to_msg())
        if changed:
            self._status.publish(stamped)
        return stamped

    def publish_diagnostics(self, status: Status, live: LiveStatus) -> None:
        """Publish both topics; to be called once a second."""
        stamp = self._node.get_clock().now().to_msg()
        message = DiagnosticArray(status=[self.publish_status(status, live)])
        message.header.stamp = stamp
        self._diagnostics.publish(message)


class PosePublishers:
    """
    Publishes the registered pose and the live pose while the node is active.

    The transform goes to /tf and is repeated. It does not go to /tf_static: in Jazzy, a second
    static transform of the same frame is silently dropped, so a new registration would be lost.
    """

    def __init__(self, node: LifecycleNode, config: Config) -> None:
        self._node = node
        self._frame_id = config.model.frame_id
        self._rate = config.tf.rate
        self._pose, self._pose_with_covariance = self._create_latched()
        create = node.create_lifecycle_publisher
        self._live_pose = create(PoseWithCovarianceStamped, '~/live_pose', 10)
        self._tf = create(TFMessage, '/tf', 100, event_callbacks=UNWATCHED) if TFMessage else None
        self._transform: TransformStamped | None = None
        self._watch = FrameWatch(node, self._frame_id)
        self._timer: Timer | None = None
        if TFMessage is None:
            node.get_logger().warning('tf2_msgs cannot be imported; /tf is not published')

    def set_rate(self, rate: float) -> None:
        """Repeat the transform at this rate, Hz; 0: never."""
        self._rate = rate
        self._restart_timer()

    def publish(self, result: RegistrationResult, frame_id: str, newest: float) -> None:
        """
        Publish a registered pose in ``frame_id``; late joiners receive it too.

        The stamp of the pose is that of the ``newest`` point used, s, as of the live pose. The
        stamp of the transform is the time at which it is sent, as tf2 needs.
        """
        T, covariance = result.T_tracker_bone, result.covariance
        assert T is not None and covariance is not None     # an accepted result has both
        stamp = ros.seconds_to_stamp(newest)
        self._pose.publish(ros.pose_msg(T, frame_id, stamp))
        self._pose_with_covariance.publish(
            ros.pose_with_covariance_msg(T, covariance, frame_id, stamp))
        self._transform = ros.transform_msg(T, frame_id, self._frame_id, stamp)
        self._watch.start()
        self._publish_transform()
        self._restart_timer()

    @property
    def problem(self) -> str:
        """Why the bone jumps on /tf; empty if it does not."""
        return self._watch.problem

    def withdraw(self) -> None:
        """Stop repeating the transform, and give late joiners no pose any more."""
        if self._transform is None:
            return
        self._transform = None
        self._watch.stop()
        self._restart_timer()
        for publisher in (self._pose, self._pose_with_covariance):
            self._node.destroy_lifecycle_publisher(publisher)
        self._pose, self._pose_with_covariance = self._create_latched()
        for publisher in (self._pose, self._pose_with_covariance):
            # the node is active: else there was no transform to withdraw
            publisher.on_activate(None)

    def publish_live(self, pose: LivePose, frame_id: str) -> None:
        """Publish the live pose with the stamp of its newest point."""
        self._live_pose.publish(
            ros.pose_with_covariance_msg(pose.T_tracker_bone, pose.covariance, frame_id,
                                         ros.seconds_to_stamp(pose.stamp)))

    def destroy(self) -> None:
        """Destroy the publishers and the timer."""
        self._watch.stop()
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        for publisher in (self._pose, self._pose_with_covariance, self._live_pose, self._tf):
            if publisher is not None:
                self._node.destroy_lifecycle_publisher(publisher)

    def _create_latched(self) -> list[LifecyclePublisher]:
        """Return new publishers of the pose, which have no message for late joiners yet."""
        create = self._node.create_lifecycle_publisher
        return [create(kind, topic, LATCHED, event_callbacks=UNWATCHED) for kind, topic in (
            (PoseStamped, '~/bone_pose'),
            (PoseWithCovarianceStamped, '~/bone_pose_with_covariance'))]

    def _restart_timer(self) -> None:
        """Run the timer at the present rate, or none if there is no transform to repeat."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._timer = None
        if self._transform is not None and self._tf is not None and self._rate > 0.0:
            self._timer = self._node.create_timer(1.0 / self._rate, self._publish_transform,
                                                  clock=STEADY)

    def _publish_transform(self) -> None:
        if self._transform is not None and self._tf is not None:
            self._transform.header.stamp = self._node.get_clock().now().to_msg()
            self._watch.sent(self._transform)
            self._tf.publish(TFMessage(transforms=[self._transform]))
