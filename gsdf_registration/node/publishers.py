# SPDX-License-Identifier: Apache-2.0
"""What the node says, where, and how reliably."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TransformStamped
from rclpy.lifecycle import LifecycleNode
from rclpy.timer import Timer
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

try:
    from tf2_msgs.msg import TFMessage
except ImportError:     # not among the wheels; on a ROS install it is there
    TFMessage = None

from gsdf_registration.config import Config
from gsdf_registration.field import Field
from gsdf_registration.node.qos import LATCHED
from gsdf_registration.node.status import status_message
from gsdf_registration.rigid import inverse, transform
from gsdf_registration.session import Session
from gsdf_registration.session_status import Status
from msg_adapters import ros


class StatusPublisher:
    """Publishes ``~/status`` (latched, on change) and ``/diagnostics``, in every node state."""

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node
        self._last: DiagnosticStatus | None = None
        self._status = node.create_publisher(DiagnosticStatus, '~/status', LATCHED)
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    def show(self, status: Status) -> DiagnosticStatus:
        """Publish ``~/status`` if it says something new; return its message."""
        message = status_message(status, self._node.get_fully_qualified_name())
        if message != self._last:
            self._last = message
            self._status.publish(message)
        return message

    def tick(self, status: Status) -> None:
        """Publish both; called once a second."""
        stamp = self._node.get_clock().now().to_msg()
        message = DiagnosticArray(status=[self.show(status)])
        message.header.stamp = stamp
        self._diagnostics.publish(message)


class PosePublishers:
    """
    Publishes the registration: poses, transform, points, markers; silent unless active.

    The transform goes to /tf and is re-sent, never to /tf_static: in Jazzy a second static
    transform of a frame is dropped without a word, so that nobody would hear of a new registration.
    """

    def __init__(self, node: LifecycleNode, config: Config) -> None:
        self._node = node
        self._frame_id = config.model.frame_id
        create = node.create_lifecycle_publisher
        self._pose = create(PoseStamped, '~/bone_pose', LATCHED)
        self._pose_with_covariance = create(PoseWithCovarianceStamped,
                                            '~/bone_pose_with_covariance', LATCHED)
        self._points = create(PointCloud2, '~/points', LATCHED)
        self._markers = create(MarkerArray, '~/markers', LATCHED)
        self._tf = create(TFMessage, '/tf', 100) if TFMessage else None
        self._transform: TransformStamped | None = None
        self._timer: Timer | None = None
        self.configure(config)
        if TFMessage is None:
            node.get_logger().warning('tf2_msgs cannot be imported; nothing is published on /tf')

    def configure(self, config: Config) -> None:
        """Re-send the transform at ``tf.rate`` from now on."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        rate = config.tf.rate if self._tf else 0.0
        self._timer = self._node.create_timer(1.0 / rate, self._resend) if rate > 0.0 else None

    def surface(self, field: Field) -> None:
        """Show the bone."""
        stamp = self._node.get_clock().now().to_msg()
        self._markers.publish(ros.surface_msg(field.surface_points, self._frame_id, stamp))

    def publish(self, session: Session) -> None:
        """Publish the last good pose of ``session``, if any, to everyone, late joiners included."""
        status = session.status()
        result, frame_id = status.pose_result, status.pose_frame_id
        if result is None:
            return
        T, covariance = result.T_tracker_bone, result.covariance
        assert T is not None and covariance is not None     # a good pose has both
        stamp = self._node.get_clock().now().to_msg()
        self._pose.publish(ros.pose_msg(T, frame_id, stamp))
        self._pose_with_covariance.publish(
            ros.pose_with_covariance_msg(T, covariance, frame_id, stamp))
        self._transform = ros.transform_msg(T, frame_id, self._frame_id, stamp)
        self._resend()
        points = session.registered_points()
        if points is not None and result.residuals_m is not None and result.weights is not None:
            self._points.publish(
                ros.cloud_msg(transform(inverse(T), points.positions), result.residuals_m,
                              result.weights, points.strokes, self._frame_id, stamp))

    def _resend(self) -> None:
        if self._transform is not None and self._tf is not None:
            self._transform.header.stamp = self._node.get_clock().now().to_msg()
            self._tf.publish(TFMessage(transforms=[self._transform]))

    def destroy(self) -> None:
        """Take everything off the air."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        for publisher in (self._pose, self._pose_with_covariance, self._points, self._markers,
                          self._tf):
            if publisher is not None:
                self._node.destroy_lifecycle_publisher(publisher)
