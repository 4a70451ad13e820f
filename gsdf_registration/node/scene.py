# SPDX-License-Identifier: Apache-2.0
"""Publishers of the 3D scene, ``~/markers`` and ``~/points``, in the bone frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.common.result import NextTouch
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.node.qos import LATCHED, UNWATCHED
from gsdf_registration.visualization.marker_scene import MarkerScene
from msg_adapters import ros
from msg_adapters.marker_cdr import DELETE_ALL, Marker, to_bytes


class ScenePublisher:
    """
    Publishes ``~/markers`` and ``~/points`` (latched) while the node is active.

    Each message contains the complete scene, so a late joiner sees what the others see.
    """

    def __init__(self, node: LifecycleNode, frame_id: str) -> None:
        self._node = node
        self._frame_id = frame_id
        create = node.create_lifecycle_publisher
        self._points = create(PointCloud2, '~/points', LATCHED, event_callbacks=UNWATCHED)
        self._markers = create(MarkerArray, '~/markers', LATCHED, event_callbacks=UNWATCHED)
        self._scene = MarkerScene()
        self._has_cloud = False     # whether the last cloud published has points

    def show_bone(self, field: Field, next_touches: Sequence[NextTouch] = ()) -> None:
        """Show the bone and where to touch next, without points: there is no pose for them."""
        self._publish(self._scene.bone(field, next_touches))
        if self._has_cloud:
            self._publish_cloud(np.zeros((0, 3)), *np.zeros((3, 0)))

    def clear(self) -> None:
        """Show nothing, not even the bone."""
        self._publish([Marker('', 0, action=DELETE_ALL)])
        if self._has_cloud:
            self._publish_cloud(np.zeros((0, 3)), *np.zeros((3, 0)))

    def show_pose(self, field: Field, limits: LimitsConfig, T_tracker_bone: Array,
                  covariance: Array, positions: Array, residuals: Array, weights: Array,
                  strokes: NDArray[np.int32], next_touches: Sequence[NextTouch]) -> None:
        """
        Show the bone with its error and the zone, the points on it, and where to touch next.

        May be called from any thread, but not by two at the same time.

        Parameters
        ----------
        field, limits, T_tracker_bone, covariance, residuals, weights, next_touches
            As in `MarkerScene.pose`; the field is that for the tip of the probe.
        positions : (n, 3) float, m, tracker frame
        strokes : (n,) int

        """
        contacts = field.contacts_at(T_tracker_bone, positions)
        self._publish(self._scene.pose(field, limits, T_tracker_bone, covariance, contacts,
                                       residuals, weights, next_touches))
        self._publish_cloud(contacts, residuals, weights, strokes)

    def destroy(self) -> None:
        """Destroy the publishers."""
        for publisher in (self._points, self._markers):
            self._node.destroy_lifecycle_publisher(publisher)

    def _publish_cloud(self, positions: Array, residuals: Array, weights: Array,
                       strokes: NDArray[Any]) -> None:
        stamp = self._node.get_clock().now().to_msg()
        self._points.publish(ros.cloud_msg(positions, residuals, weights, strokes, self._frame_id,
                                           stamp))
        self._has_cloud = len(positions) > 0

    def _publish(self, shown: Sequence[Marker]) -> None:
        self._markers.publish(to_bytes(shown, self._frame_id))
