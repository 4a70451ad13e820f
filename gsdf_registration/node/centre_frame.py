# SPDX-License-Identifier: Apache-2.0
"""The frame at the centre of the bone on /tf_static, which displays follow."""

from __future__ import annotations

from rclpy.lifecycle import LifecycleNode

try:
    from tf2_msgs.msg import TFMessage
except ImportError:     # there is no wheel of it; a ROS installation has it
    TFMessage = None

from gsdf_registration.field import Field
from gsdf_registration.node.qos import LATCHED, UNWATCHED
from gsdf_registration.visualization.marker_scene import centre_msg


class CentreFrame:
    """
    Publishes the transform from the bone frame to its centre (latched) while the node is active.

    The coordinates of a model are those of its scan: the bone may lie a metre from its origin,
    where a camera would look past it. The transform is static: it changes only with the bone.
    """

    def __init__(self, node: LifecycleNode, bone_frame: str) -> None:
        self._node, self._bone_frame = node, bone_frame
        # as in tf2_ros, but without its broadcaster: that one never sends a frame a second time
        self._publisher = node.create_lifecycle_publisher(
            TFMessage, '/tf_static', LATCHED, event_callbacks=UNWATCHED) if TFMessage else None

    def show(self, field: Field) -> None:
        """Publish the centre of this bone."""
        if self._publisher is not None:
            self._publisher.publish(TFMessage(transforms=[centre_msg(
                field, self._bone_frame, self._node.get_clock().now().to_msg())]))

    def destroy(self) -> None:
        """Destroy the publisher."""
        if self._publisher is not None:
            self._node.destroy_lifecycle_publisher(self._publisher)
