# SPDX-License-Identifier: Apache-2.0
"""The motion that the points constrain least, as a screw and as a sentence."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gsdf_registration.common.formatting import format_error
from gsdf_registration.common.result import WeakestDirection
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.confidence import Confidence, motion_at
from gsdf_registration.registration.wording import describe_axis, describe_direction

# The motion is a translation if its rotation moves the bone by less than this share of it
TURNING = 0.2


def weakest_direction(confidence: Confidence, surface: Array, touched: Array, outward: Array,
                      names: Mapping[str, Array]) -> WeakestDirection:
    """
    Return the motion that the points constrain least, at one standard deviation.

    Parameters
    ----------
    confidence : Confidence
    surface : (n, 3) float, m, bone frame
        Surface points of the whole bone.
    touched : (m, 3) float, m, bone frame
        The points on the bone.
    outward : (3,) float
        Mean outward normal of the bone at those points, of any length.
    names : mapping of str to (3,) float, m, bone frame
        Landmarks and targets to describe the axis with.

    """
    arms = surface - confidence.centroid
    xi, phi = _largest_motion(confidence, arms)
    angle, distance = float(np.linalg.norm(xi)), float(np.linalg.norm(phi))
    radius = float(np.sqrt((arms**2).sum(axis=1).mean()))
    if angle * radius <= TURNING * distance:
        axis = phi / distance
        sentence = (f'least constrained: translation '
                    f'{describe_direction(axis, surface, outward)} '
                    f'(1 SD: {format_error(distance)})')
        return WeakestDirection(axis, confidence.centroid, float('inf'), angle, distance, sentence)
    axis, pitch = xi / angle, float(xi @ phi) / angle**2
    point = confidence.centroid + np.cross(xi, phi) / angle**2
    farthest = float(np.linalg.norm(np.cross(xi, arms) + phi, axis=1).max())
    sentence = (f'least constrained: rotation about the axis '
                f'{describe_axis(axis, point, surface, touched, outward, names)} '
                f'(1 SD: {_screw(angle, abs(pitch) * angle, farthest)})')
    return WeakestDirection(axis, point, pitch, angle, distance, sentence)


def _largest_motion(confidence: Confidence, arms: Array) -> tuple[Array, Array]:
    """
    Return the rotation and translation of one standard deviation that move the bone most (RMS).

    They are the eigenvector of the largest eigenvalue of the covariance in the metric M = mean of
    B^T B over the surface, which weighs radians against metres by the size of the bone.
    """
    B = motion_at(arms).reshape(-1, 6)
    L = np.linalg.cholesky(3.0 * B.T @ B / len(B))
    values, vectors = np.linalg.eigh(L.T @ confidence.motion_covariance @ L)
    motion = np.linalg.solve(L.T, vectors[:, -1]) * np.sqrt(values[-1])
    return motion[:3], motion[3:]


def _screw(angle: float, along: float, farthest: float) -> str:
    """Return a rotation in degrees and the translations it comes with, along its axis and most."""
    degrees = f'{np.degrees(angle):.2f}'
    parts = [f'{"< 0.01" if degrees == "0.00" else degrees} deg']
    if format_error(along) != format_error(0.0):
        parts.append(f'{format_error(along)} along the axis')
    parts.append(f'{format_error(farthest)} where the bone is farthest from the axis')
    return ', '.join(parts)
