# SPDX-License-Identifier: Apache-2.0
"""What the 3-D view of the report draws, in millimetres: arrays in base64 for `report.js`."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.registration.confidence import error_bound
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.decimation import drawn_surface
from gsdf_registration.visualization.report_content import ReportContent
from gsdf_registration.visualization.zone_border import border_segments

MAX_POINTS = 20_000     # more would only make the file larger
MAX_FACES = 40_000
TOUCHED = '#0969da'
# letters at the ends of x, y and z: first those of the positive directions
LETTERS = {'lps': ('LPS', 'RAI'), 'ras': ('RAS', 'LPI')}


def scene(content: ReportContent) -> dict[str, Any]:
    """
    Return the content of the 3-D view as JSON values.

    With a pose everything is in the bone frame; without one only the points are drawn, in the
    tracker frame.
    """
    if content.field is None or content.pose is None:
        points = content.points.positions
        points = _evenly(points[np.isfinite(points).all(axis=1)])
        colour = np.tile(colours.rgb(TOUCHED), (len(points), 1))
        return {'bone': None, 'letters': None, 'labels': [], 'focus': None,
                'sets': [_cloud('points, tracker frame', points, colour)]}
    clouds = [_points(content, pose, number) for number, pose in enumerate(content.poses, start=1)]
    return {'bone': _bone(content), 'letters': LETTERS[content.axes], 'labels': _labels(content),
            'focus': _focus(content), 'sets': clouds}


def _bone(content: ReportContent) -> dict[str, Any]:
    """Return the surface with its colours, and the border of the zone."""
    assert content.field is not None and content.pose is not None
    vertices, faces = drawn_surface(content.field, MAX_FACES)
    border = np.zeros((0, 2, 3))
    if content.covariance is None:
        colour = np.tile(colours.rgb(colours.ERROR[0]), (len(vertices), 1))
    else:
        limits = content.config.limits
        errors = error_bound(content.pose, content.covariance, vertices)
        colour = colours.error_colours(errors, limits)
        border = border_segments(vertices, faces, errors, limits.max_error)
    return {'vertices': _mm(vertices), 'faces': _encoded(faces.astype(np.uint32)),
            'colours': _rgb(colour), 'border': _mm(border.reshape(-1, 3))}


def _points(content: ReportContent, pose: Array, number: int) -> dict[str, Any]:
    """Return the points on the bone at a pose, coloured by their distance from the surface."""
    points = content.on_bone(content.points.positions, pose)
    residuals = content.residuals
    if number > 1:
        assert content.field is not None
        known = np.isfinite(residuals)
        residuals = residuals.copy()
        residuals[known] = content.field.for_tip(0.0).sample(points[known])[0]
    colour = colours.residual_colours(residuals, content.weights, content.config.limits)
    name = 'points' if len(content.poses) == 1 else f'pose {number}'
    finite = np.isfinite(points).all(axis=1)
    return _cloud(name, _evenly(points[finite]), _evenly(colour[finite]))


def _labels(content: ReportContent) -> list[dict[str, Any]]:
    """Return the named places: where to touch next, landmarks, verification points."""
    assert content.pose is not None
    considered = content.result.considered
    touches = () if considered is None else considered.next_touches
    labels = [_label(str(number), touch.position, 'next')
              for number, touch in enumerate(touches, start=1)]
    T_bone_tracker = inverse(content.pose)
    labels += [_label(name, transform(T_bone_tracker, touched), 'landmark')
               for name, touched in zip(
                   content.landmarks.names, content.landmarks.touched)]
    labels += [_label(each.name, transform(T_bone_tracker, each.position), 'verified')
               for each in content.verifications]
    targets = content.config.targets
    return labels + [_label(name, position, 'target') for name, position in zip(
        targets.names, np.reshape(targets.positions, (-1, 3)))]


def _label(text: str, position: Array, kind: str) -> dict[str, Any]:
    return {'text': text.replace('_', ' '), 'at': np.round(1e3 * position, 2).tolist(),
            'kind': kind}


def _focus(content: ReportContent) -> dict[str, Any] | None:
    """Return middle and radius, mm, of the touched area, and the direction to the viewer."""
    assert content.field is not None and content.pose is not None
    touched = content.on_bone(content.points.positions[content.inlier], content.pose)
    if not len(touched):
        return None
    low, high = touched.min(axis=0), touched.max(axis=0)
    outward = content.field.sample(touched)[1].mean(axis=0)
    return {'centre': np.round(500.0 * (low + high), 2).tolist(),
            'radius': round(500.0 * float(np.linalg.norm(high - low)) + 10.0, 2),
            'from': np.round(outward, 3).tolist()}


def _cloud(name: str, points: Array, colour: Array) -> dict[str, Any]:
    return {'name': name, 'points': _mm(points), 'colours': _rgb(colour)}


def _evenly(rows: Array) -> Array:
    """Return at most `MAX_POINTS` rows, downsampled evenly."""
    return rows[::-(-len(rows) // MAX_POINTS) or 1]


def _mm(points: Array) -> str:
    return _encoded((1e3 * points).astype(np.float32))


def _rgb(colour: Array) -> str:
    return _encoded(np.round(255.0 * colour).astype(np.uint8))


def _encoded(values: np.ndarray) -> str:
    return base64.b64encode(values.tobytes()).decode('ascii')
