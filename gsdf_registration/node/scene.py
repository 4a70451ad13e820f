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
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.field import Field
from gsdf_registration.node.qos import LATCHED, UNWATCHED
from gsdf_registration.registration.confidence import error_bound
from gsdf_registration.registration.guidance import PATCH
from gsdf_registration.registration.point_selection import evenly_spread
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.decimation import Faces, drawn_surface
from gsdf_registration.visualization.zone_border import border_segments
from msg_adapters import markers, ros
from msg_adapters.marker_cdr import DELETE_ALL, Marker, to_bytes

MAX_FACES = 12_000      # of the bone: at 120 bytes each, a message stays below 2 MB
MAX_POINTS = 20_000     # drawn as markers, evenly spread over all; at 40 bytes each


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
        self._surface: tuple[str, Array, Faces] | None = None   # with the hash of its bone
        self._has_cloud = False     # whether the last cloud published has points

    def show_bone(self, field: Field, next_touches: Sequence[NextTouch] = ()) -> None:
        """Show the bone and where to touch next, without points: there is no pose for them."""
        empty = np.zeros((0, 3))
        vertices, faces = self._drawn_surface(field)
        plain = np.tile(colours.rgb(colours.ERROR[0]), (len(vertices), 1))
        self._publish(markers.bone(vertices, faces, plain)
                      + markers.border(np.zeros((0, 2, 3)), plain) + markers.points(empty, empty)
                      + self._patches(next_touches))
        if self._has_cloud:
            self._publish_cloud(empty, *np.zeros((3, 0)))

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
        field : Field
            For the tip of the probe; points are drawn where the tip touches the bone.
        limits : LimitsConfig
            Scales of the colours.
        T_tracker_bone : (4, 4) float
        covariance : (6, 6) float
            Of the pose, REP-103 order.
        positions : (n, 3) float, m, tracker frame
        residuals, weights, strokes : (n,)
            Of the points; residuals in m, NaN if unknown.
        next_touches : sequence of NextTouch
            Best first.

        """
        on_bone = field.contacts(transform(inverse(T_tracker_bone), positions))
        shown = evenly_spread(np.arange(len(positions)), MAX_POINTS)
        vertices, faces = self._drawn_surface(field)
        error = error_bound(T_tracker_bone, covariance, vertices)
        self._publish(
            markers.bone(vertices, faces, colours.error_colours(error, limits))
            + markers.border(border_segments(vertices, faces, error, limits.max_error),
                             colours.rgb(colours.BORDER))
            + markers.points(on_bone[shown], colours.residual_colours(
                residuals[shown], weights[shown], limits))
            + self._patches(next_touches))
        self._publish_cloud(on_bone, residuals, weights, strokes)

    def destroy(self) -> None:
        """Destroy the publishers."""
        for publisher in (self._points, self._markers):
            self._node.destroy_lifecycle_publisher(publisher)

    def _drawn_surface(self, field: Field) -> tuple[Array, Faces]:
        if self._surface is None or self._surface[0] != field.bone_sha256:
            self._surface = (field.bone_sha256, *drawn_surface(field, MAX_FACES))
        return self._surface[1:]

    def _patches(self, next_touches: Sequence[NextTouch]) -> list[Marker]:
        """Return markers of the places to touch next, numbered, with the expected gain."""
        labels = [f'{number}: {touch.label}' for number, touch in enumerate(next_touches, start=1)]
        return markers.patches(np.array([touch.position for touch in next_touches]).reshape(-1, 3),
                               np.array([touch.normal for touch in next_touches]).reshape(-1, 3),
                               PATCH, labels, colours.rgb(colours.NEXT))

    def _publish_cloud(self, positions: Array, residuals: Array, weights: Array,
                       strokes: NDArray[Any]) -> None:
        stamp = self._node.get_clock().now().to_msg()
        self._points.publish(ros.cloud_msg(positions, residuals, weights, strokes, self._frame_id,
                                           stamp))
        self._has_cloud = len(positions) > 0

    def _publish(self, shown: Sequence[Marker]) -> None:
        self._markers.publish(to_bytes(shown, self._frame_id))
