# SPDX-License-Identifier: Apache-2.0
"""Describe places and directions on a bone in words that can be followed at the table."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field

NEAR_NAME = 0.06        # m: a place this near to a named point is described from it
NEAR_AREA = 0.02        # m: an axis this near to the middle of the touched area passes through it
HERE = 0.005            # m: two places nearer than this are the same
ALIGNED = 0.87          # cosine of 30 degrees: directions this close are described as the same
PERPENDICULAR = 0.5     # cosine of 60 degrees: directions with a smaller one are perpendicular
ELONGATED = 2.0         # length over width of a bone that has a long axis
UPRIGHT = 0.4           # sine of the angle at which the middle of the bone lies beneath the area


def describe_place(place: Array, touched: Array, names: Mapping[str, Array], field: Field) -> str:
    """
    Describe where a place is: from the nearest named point, else from the touched area.

    Parameters
    ----------
    place : (3,) float, m, bone frame
    touched : (n, 3) float, m, bone frame
    names : mapping of str to (3,) float, m, bone frame
        Landmarks and targets.
    field : Field
        Of the bone.

    """
    nearest = min(names, key=lambda name: float(np.linalg.norm(names[name] - place)), default=None)
    if nearest is not None and np.linalg.norm(names[nearest] - place) < NEAR_NAME:
        offset, origin = place - names[nearest], f"'{nearest}'"
    else:
        nearest, offset = None, place - touched.mean(axis=0)
        origin = 'the middle of the touched area'
    if np.linalg.norm(offset) < HERE:
        return f'at {origin}'
    direction = '' if nearest is None else _direction_by_names(offset, nearest, names)
    if direction:
        return f'{1e3 * np.linalg.norm(offset):.0f} mm from {origin} {direction}'
    return _clock_position(offset, origin, touched, field)


def describe_axis(axis: Array, point: Array, surface: Array, touched: Array, outward: Array,
                  names: Mapping[str, Array]) -> str:
    """
    Describe an axis by what it passes and by its direction.

    Parameters
    ----------
    axis : (3,) float, unit, bone frame
    point : (3,) float, m, bone frame
        On the axis.
    surface : (n, 3) float, m, bone frame
        Surface points of the whole bone.
    touched : (m, 3) float, m, bone frame
    outward : (3,) float
        Mean outward normal of the touched area, of any length.
    names : mapping of str to (3,) float, m, bone frame
        Landmarks and targets.

    """
    def distance(place: Array) -> float:
        return float(np.linalg.norm(np.cross(place - point, axis)))

    nearest = min(names, key=lambda name: distance(names[name]), default=None)
    if nearest is not None and distance(names[nearest]) < NEAR_NAME:
        relation = 'through' if distance(names[nearest]) < HERE else 'near'
        others = _direction_by_names(axis, nearest, names).replace('away from', 'towards')
        direction = others or describe_direction(axis, surface, outward)
        return f"{relation} '{nearest}', {direction}"
    if distance(touched.mean(axis=0)) < NEAR_AREA:
        place = 'through the touched area'
    elif distance(surface.mean(axis=0)) < NEAR_AREA:
        place = 'through the middle of the bone'
    else:
        place = f'{1e3 * distance(touched.mean(axis=0)):.0f} mm from the touched area'
    return f'{place}, {describe_direction(axis, surface, outward)}'


def describe_direction(axis: Array, surface: Array, outward: Array) -> str:
    """
    Describe a direction by the long axis of the bone, else by the touched surface.

    Parameters
    ----------
    axis : (3,) float, unit, bone frame
        Its sign does not matter.
    surface : (n, 3) float, m, bone frame
        Surface points of the whole bone.
    outward : (3,) float
        Mean outward normal of the touched area, of any length.

    """
    _, spread, axes = np.linalg.svd(surface - surface.mean(axis=0), full_matrices=False)
    elongated = spread[0] > ELONGATED * spread[1]
    along_bone = abs(float(axes[0] @ axis))
    normal = outward / max(float(np.linalg.norm(outward)), 1e-12)
    along_normal = abs(float(normal @ axis))
    if elongated and along_bone > ALIGNED:
        return 'along the long axis of the bone'
    if along_normal > ALIGNED:
        return 'perpendicular to the touched surface'
    if elongated and along_bone < PERPENDICULAR:
        return 'perpendicular to the long axis of the bone'
    if along_normal < PERPENDICULAR:
        return 'parallel to the touched surface'
    angle = np.degrees(np.arcsin(min(along_normal, 1.0)))
    return f'inclined {angle:.0f} deg to the touched surface'


def _direction_by_names(offset: Array, origin: str, names: Mapping[str, Array]) -> str:
    """Return a direction from one named point by the others; empty if none lies that way."""
    best, direction = ALIGNED, ''
    for name in names.keys() - {origin}:
        arm = np.asarray(names[name] - names[origin])
        cosine = float(arm @ offset) / max(
            float(np.linalg.norm(arm) * np.linalg.norm(offset)), 1e-12)
        if abs(cosine) > best:
            best = abs(cosine)
            direction = f"{'towards' if cosine > 0.0 else 'away from'} '{name}'"
    return direction


def _clock_position(offset: Array, origin: str, touched: Array, field: Field) -> str:
    """Describe an ``offset`` (3,) from ``origin`` as on a clock face laid on the touched area."""
    above = field.sample(touched)[1].mean(axis=0)
    above /= max(float(np.linalg.norm(above)), 1e-12)
    arm = field.surface_points.astype(np.float64).mean(axis=0) - touched.mean(axis=0)
    noon, landmark = arm - (arm @ above) * above, 'the middle of the bone'
    if np.linalg.norm(noon) < UPRIGHT * np.linalg.norm(arm):    # it lies beneath the touched area
        axis = int(np.argmin(np.abs(above)))
        noon, landmark = np.eye(3)[axis] - above[axis] * above, f'+{"xyz"[axis]} of the model'
    noon /= np.linalg.norm(noon)
    up, right, deeper = offset @ noon, offset @ np.cross(noon, above), -float(offset @ above)
    hour = round(6.0 / np.pi * np.arctan2(right, up)) % 12 or 12
    depth = f'{1e3 * abs(deeper):.0f} mm {"deeper" if deeper > 0.0 else "higher"}'
    if np.hypot(up, right) < HERE:
        return f'{depth} than {origin}'
    return (f"{1e3 * np.hypot(up, right):.0f} mm from {origin} at {hour} o'clock (12 is towards "
            f'{landmark})' + (f', {depth}' if abs(deeper) > HERE else ''))
