# SPDX-License-Identifier: Apache-2.0
"""A few places on the bone where an accepted pose must be accurate, to compare poses at them."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from gsdf_registration.common.config import Config
from gsdf_registration.common.downsampling import farthest_point_sample
from gsdf_registration.common.result import INLIER_WEIGHT, RegistrationResult
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.field import Field
from gsdf_registration.registration.zone import NEARBY

# Two poses differ most at the border of a part of the bone, where farthest-point sampling begins
PLACES, CANDIDATES = 8, 200


def required_places(result: RegistrationResult, points: Array, field: Field,
                    config: Config) -> Array:
    """
    Return places (k, 3), m, bone frame, in the part of the bone that ``limits.require`` names.

    These are the targets, or at most 8 places that span the part, see `zone.required_part`.

    Parameters
    ----------
    result : with a pose
    points : (n, 3) float, m, tracker frame
        Those that were registered.
    field : Field
    config : Config

    """
    part = config.limits.require or ('targets' if config.targets.names else 'touched')
    if part == 'targets':
        return np.reshape(config.targets.positions, (-1, 3))
    surface = field.surface_points.astype(np.float64)
    spread = surface[farthest_point_sample(surface, CANDIDATES)]
    if part == 'touched':
        assert result.T_tracker_bone is not None
        on_bone = points if result.weights is None else points[result.weights > INLIER_WEIGHT]
        touched = transform(inverse(result.T_tracker_bone), on_bone)
        near = spread[cKDTree(touched).query(spread)[0] < NEARBY]
        spread = near if len(near) else touched
    return np.asarray(spread[farthest_point_sample(spread, PLACES)])
