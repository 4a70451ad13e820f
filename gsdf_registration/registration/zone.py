# SPDX-License-Identifier: Apache-2.0
"""
The zone of a pose: the part of the bone where it is accurate enough.

A place is in the zone if its error is within ``limits.max_error`` with a probability of 95 %.
``limits.require`` says which part of the bone must be in the zone; otherwise the pose is rejected.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Zone
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.confidence import Confidence

NEARBY = 0.1    # m: the part of the bone around the touched area that a surgeon works on


class ErrorMap(NamedTuple):
    """
    The error to expect all over the bone.

    surface : (m, 3) float, m, bone frame, points on the surface of the bone
    p95 : (m,) float, m: with a probability of 95 % the error there is smaller
    distance : (m,) float, m, from the nearest touched point
    target_p95 : dict of str to float, m, at the targets
    """

    surface: Array
    p95: Array
    distance: Array
    target_p95: dict[str, float]

    @property
    def nearby(self) -> NDArray[np.bool_]:
        """Which surface points are within 100 mm of the touched points, (m,)."""
        return np.asarray(self.distance < NEARBY)


class RequiredPart(NamedTuple):
    """
    The part of the bone that must be in the zone.

    where : str, as part of a sentence
    points : (n, 3) float, m, bone frame
    p95 : float, m, the largest there
    """

    where: str
    points: Array
    p95: float


def map_error(confidence: Confidence, surface: Array, touched: Array, config: Config) -> ErrorMap:
    """
    Return the error to expect at the surface points and at the targets.

    Parameters
    ----------
    confidence : Confidence
    surface : (m, 3) float, m, bone frame
    touched : (n, 3) float, m, bone frame
        The points on the bone.
    config : Config

    """
    targets = confidence.p95(np.reshape(config.targets.positions, (-1, 3)))
    return ErrorMap(surface, confidence.p95(surface), cKDTree(touched).query(surface)[0],
                    dict(zip(config.targets.names, targets.tolist())))


def find_zone(errors: ErrorMap, limit: float) -> Zone:
    """Return the part of the bone where the error is within ``limit``, m."""
    inside = errors.p95 <= limit
    outside = errors.distance[~inside]
    distance = outside.min() if len(outside) else errors.distance.max()
    return Zone(limit, float(distance), float(inside.mean()), errors.target_p95,
                float(errors.p95[errors.nearby].max(initial=0.0)), float(errors.p95.max()))


def required_part(errors: ErrorMap, config: Config) -> RequiredPart:
    """Return the part that ``limits.require`` names; by default the targets, if there are any."""
    part = config.limits.require or ('targets' if config.targets.names else 'touched')
    if part == 'targets':
        return RequiredPart('at the targets', np.reshape(config.targets.positions, (-1, 3)),
                            max(errors.target_p95.values()))
    rows = errors.nearby if part == 'touched' else np.ones(len(errors.surface), dtype=bool)
    where = 'around the touched area' if part == 'touched' else 'over the whole bone'
    return RequiredPart(where, errors.surface[rows], float(errors.p95[rows].max(initial=0.0)))
