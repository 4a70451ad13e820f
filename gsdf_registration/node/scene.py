# SPDX-License-Identifier: Apache-2.0
"""What a surgeon sees: ~/markers and ~/points, in the frame of the bone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Touch
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.field import Field
from gsdf_registration.node.qos import LATCHED, UNWATCHED
from gsdf_registration.registration.confidence import predicted_tre
from gsdf_registration.registration.guidance import PATCH
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.decimation import Faces, drawn_surface
from msg_adapters import markers, ros
from msg_adapters.marker_cdr import Marker, to_bytes

MOST_FACES = 12_000     # of the bone: 120 bytes each, and a message stays below 2 MB


class ScenePublisher:
    """
    Publishes ``~/markers`` and ``~/points`` (latched); silent unless the node is active.

    Each message tells all: a viewer that comes late sees what the others see.
    """

    def __init__(self, node: LifecycleNode, config: Config) -> None:
        self._node = node
        self._config = config
        self._frame_id = config.model.frame_id
        create = node.create_lifecycle_publisher
        self._points = create(PointCloud2, '~/points', LATCHED, event_callbacks=UNWATCHED)
        self._markers = create(MarkerArray, '~/markers', LATCHED, event_callbacks=UNWATCHED)
        self._surface: tuple[str, Array, Faces] | None = None   # of the bone of this hash
        self._stale = False     # whether a cloud stands that is not to be seen any more

    def configure(self, config: Config) -> None:
        """Colour by the limits of these settings from now on."""
        self._config = config

    def bone(self, field: Field, touches: Sequence[Touch] = ()) -> None:
        """Show the bone and where to touch it: no pose tells where on it the points are."""
        nothing = np.zeros((0, 3))
        vertices, faces = self._drawn(field)
        plain = np.tile(colours.rgb(colours.ERROR[0]), (len(vertices), 1))
        self._publish(markers.bone(vertices, faces, plain) + markers.points(nothing, nothing)
                      + self._patches(touches))
        if self._stale:
            self._cloud(nothing, *np.zeros((3, 0)))

    def show(self, field: Field, T_tracker_bone: Array, covariance: Array, positions: Array,
             residuals: Array, weights: Array, strokes: NDArray[np.int32],
             touches: Sequence[Touch]) -> None:
        """
        Show points on the bone, how far off it may be, and where to touch next.

        May be called from any thread, one at a time.

        Parameters
        ----------
        field : Field
        T_tracker_bone : (4, 4) float
        covariance : (6, 6) float
            Of the pose, REP-103 order.
        positions : (n, 3) float, m, tracker frame
        residuals, weights, strokes : (n,)
            Of the points; residuals in m, NaN where unknown.
        touches : sequence of Touch
            Best first.

        """
        limits = self._config.limits
        on_bone = transform(inverse(T_tracker_bone), positions)
        vertices, faces = self._drawn(field)
        error = predicted_tre(T_tracker_bone, covariance, vertices)
        self._publish(
            markers.bone(vertices, faces, colours.error_colours(error, limits))
            + markers.points(on_bone, colours.residual_colours(residuals, weights, limits))
            + self._patches(touches))
        self._cloud(on_bone, residuals, weights, strokes)

    def destroy(self) -> None:
        """Take all off the air."""
        for publisher in (self._points, self._markers):
            self._node.destroy_lifecycle_publisher(publisher)

    def _drawn(self, field: Field) -> tuple[Array, Faces]:
        if self._surface is None or self._surface[0] != field.bone_sha256:
            self._surface = (field.bone_sha256, *drawn_surface(field, MOST_FACES))
        return self._surface[1:]

    def _patches(self, touches: Sequence[Touch]) -> list[Marker]:
        """Return where to touch next, numbered, with what is gained by it."""
        labels = [f'{number}: {touch.label}' for number, touch in enumerate(touches, start=1)]
        return markers.patches(np.array([touch.position for touch in touches]).reshape(-1, 3),
                               np.array([touch.normal for touch in touches]).reshape(-1, 3),
                               PATCH, labels, colours.rgb(colours.NEXT))

    def _cloud(self, positions: Array, residuals: Array, weights: Array,
               strokes: NDArray[Any]) -> None:
        stamp = self._node.get_clock().now().to_msg()
        self._points.publish(ros.cloud_msg(positions, residuals, weights, strokes, self._frame_id,
                                           stamp))
        self._stale = len(positions) > 0

    def _publish(self, shown: Sequence[Marker]) -> None:
        self._markers.publish(to_bytes(shown, self._frame_id))
