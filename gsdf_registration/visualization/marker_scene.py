# SPDX-License-Identifier: Apache-2.0
"""The 3D scene as markers in the bone frame: the bone, its zone, points and places to touch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gsdf_registration.common.config import LimitsConfig
from gsdf_registration.common.naming import centre_frame
from gsdf_registration.common.result import NextTouch
from gsdf_registration.common.rigid import Array, from_rt
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import error_bound
from gsdf_registration.registration.guidance import PATCH
from gsdf_registration.registration.point_selection import evenly_spread
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.decimation import Faces, drawn_surface
from gsdf_registration.visualization.zone_border import border_segments
from msg_adapters import markers, ros
from msg_adapters.marker_cdr import Marker

MAX_FACES = 12_000      # of the bone: at 120 bytes each, a message stays below 2 MB
MAX_POINTS = 20_000     # drawn as markers, evenly spread over all; at 40 bytes each
# RViz draws triangles with colours of their own without light, so the light is in the colours: from
# where both layouts look first, bone axes. The side away from it has the brightness SHADE.
LIGHT, SHADE = np.array([0.81, 0.44, 0.39]), 0.55


def centre_of(field: Field) -> Array:
    """Return the centre (3,), m, bone frame, of the box around a bone, which displays look at."""
    corners = [field.surface_points.min(axis=0), field.surface_points.max(axis=0)]
    return np.mean(corners, axis=0, dtype=np.float64)


def centre_msg(field: Field, bone_frame: str, stamp: Any) -> Any:
    """Return the transform from the bone frame to the frame at the centre of the bone."""
    return ros.transform_msg(from_rt(np.eye(3), centre_of(field)), bone_frame,
                             centre_frame(bone_frame), stamp)


class MarkerScene:
    """Makes the markers of complete scenes; it keeps the decimated surface of the last bone."""

    def __init__(self) -> None:
        # vertices, faces and brightness of the vertices, with the hash of the bone
        self._surface: tuple[str, Array, Faces, Array] | None = None

    def bone(self, field: Field, next_touches: Sequence[NextTouch] = ()) -> list[Marker]:
        """Return the bone and where to touch next, without points: there is no pose for them."""
        empty = np.zeros((0, 3))
        vertices, faces, bright = self._drawn_surface(field)
        plain = np.tile(colours.rgb(colours.ERROR[0]), (len(vertices), 1))
        return (markers.bone(vertices, faces, bright * plain)
                + markers.border(np.zeros((0, 2, 3)), plain) + markers.points(empty, empty)
                + _patches(next_touches))

    def pose(self, field: Field, limits: LimitsConfig, T_tracker_bone: Array, covariance: Array,
             contacts: Array, residuals: Array, weights: Array,
             next_touches: Sequence[NextTouch]) -> list[Marker]:
        """
        Return the bone with its error and the zone, the points on it, and where to touch next.

        Parameters
        ----------
        field : Field
        limits : LimitsConfig
            Scales of the colours.
        T_tracker_bone : (4, 4) float
        covariance : (6, 6) float
            Of the pose, REP-103 order.
        contacts : (n, 3) float, m, bone frame
            Where the tip touches the bone, see `Field.contacts_at`.
        residuals, weights : (n,)
            Of the points; residuals in m, NaN if unknown.
        next_touches : sequence of NextTouch
            Best first.

        """
        shown = evenly_spread(np.arange(len(contacts)), MAX_POINTS)
        vertices, faces, bright = self._drawn_surface(field)
        error = error_bound(T_tracker_bone, covariance, vertices)
        return (markers.bone(vertices, faces, bright * colours.error_colours(error, limits))
                + markers.border(border_segments(vertices, faces, error, limits.max_error),
                                 colours.rgb(colours.BORDER))
                + markers.points(contacts[shown], colours.residual_colours(
                    residuals[shown], weights[shown], limits))
                + _patches(next_touches))

    def _drawn_surface(self, field: Field) -> tuple[Array, Faces, Array]:
        if self._surface is None or self._surface[0] != field.bone_sha256:
            vertices, faces = drawn_surface(field, MAX_FACES)
            self._surface = field.bone_sha256, vertices, faces, _brightness(vertices, faces)
        return self._surface[1:]


def _brightness(vertices: Array, faces: Faces) -> Array:
    """Return the brightness (n, 1) of vertices by the angle of the surface to the light."""
    if not len(faces):
        return np.ones((len(vertices), 1))
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.stack([np.bincount(faces.ravel(), np.repeat(axis, 3), len(vertices))
                        for axis in across.T], axis=1)      # weighted by area
    length = np.linalg.norm(normals, axis=1)
    towards = (normals @ LIGHT) / np.where(length > 0.0, length, 1.0)
    return np.asarray(SHADE + (1.0 - SHADE) * 0.5 * (1.0 + towards))[:, None]


def _patches(next_touches: Sequence[NextTouch]) -> list[Marker]:
    """Return markers of the places to touch next, numbered, with the expected gain."""
    labels = [f'{number}: {touch.label}' for number, touch in enumerate(next_touches, start=1)]
    return markers.patches(np.array([touch.position for touch in next_touches]).reshape(-1, 3),
                           np.array([touch.normal for touch in next_touches]).reshape(-1, 3),
                           PATCH, labels, colours.rgb(colours.NEXT))
