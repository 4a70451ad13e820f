# SPDX-License-Identifier: Apache-2.0
"""
Where the probe was in the air there is no bone: the likelihood of a pose given these places.

A probe can pierce soft tissue but not bone. Each place is a mixture: with a small probability its
reading is wrong and says nothing, otherwise it is outside the bone up to the accuracy of tip, shaft
and pose. So a place far inside the bone costs a pose a fixed amount, however deep it is. Nothing is
expected of places outside: a place far from the bone is no better than one just above it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from gsdf_registration.common import rigid
from gsdf_registration.common.result import InputError, as_numbers
from gsdf_registration.common.rigid import MAX_COORDINATE, Array
from gsdf_registration.field import Field

PLACE = 0.005       # m, edge of a cell that counts once, however long the probe stays in it
MOST_PLACES = 10_000        # bounds the time: 1 ms per pose
ACCURACY = 0.001    # m, standard deviation of the depth of a place
TOLERATED = 2.0     # standard deviations inside the bone at which half of the places are wrong
CLEARLY_INSIDE = 0.003      # m
WRONG = 0.1         # share of wrong readings: a place costs at most log(0.1) = -2.3
# Log-likelihood that the places cost at most, twice the usual `limits.min_gap`. They decide between
# poses that fit the points equally well, and not against the points.
MOST = 48.0

NO_PLACES = np.zeros((0, 3))


class Blocked(NamedTuple):
    """
    What is inside the bone at a pose.

    places, total : int, number of places clearly inside the bone, and of all places
    depth : float, m, of the deepest place; 0 if none is inside
    log_likelihood : float, see `log_likelihood`
    """

    places: int
    total: int
    depth: float
    log_likelihood: float


NOTHING_BLOCKED = Blocked(0, 0, 0.0, 0.0)


def places(positions: ArrayLike) -> Array:
    """
    Return one position (m, 3) for each cell of 5 mm that contains any of ``positions`` (n, 3), m.

    Which one does not depend on the order. Of more than 10 000 cells, evenly spread ones are
    returned.

    Raises
    ------
    InputError
        If the positions are not rows of three finite numbers.

    """
    rows = as_numbers(positions, 'positions in the air')
    if rows.size == 0:
        return NO_PLACES
    if rows.ndim != 2 or rows.shape[1] != 3 or not (np.abs(rows) < MAX_COORDINATE).all():
        raise InputError('positions in the air must be rows of three finite numbers in metres')
    cells = np.floor(rows / PLACE)
    order = np.lexsort((*rows.T, *cells.T))
    starts = (np.diff(cells[order], axis=0, prepend=np.nan) != 0.0).any(axis=1)
    first = order[starts]
    return rows[first[::-(-len(first) // MOST_PLACES)]]


def log_likelihood(air: Array, T_bone_tracker: Array, field: Field) -> float:
    """
    Return the log-likelihood of a pose: 0 if all places are outside the bone, else less.

    Parameters
    ----------
    air : (m, 3) float, m, tracker frame, see `places`
    T_bone_tracker : (4, 4) float, m
    field : Field

    """
    return blocked(air, T_bone_tracker, field).log_likelihood


def blocked(air: Array, T_bone_tracker: Array, field: Field) -> Blocked:
    """Return how many of the places are inside the bone; arguments as in `log_likelihood`."""
    if not len(air):
        return NOTHING_BLOCKED
    depths = -field.sample(rigid.transform(T_bone_tracker, air))[0]
    return Blocked(int((depths > CLEARLY_INSIDE).sum()), len(air), float(depths.max(initial=0.0)),
                   max(float(_terms(depths).sum()), -MOST))


def start_poses(found: Array, air: Array, field: Field, count: int) -> Array:
    """
    Return the first ``count`` poses, and the first ``count`` of all that the air does not rule out.

    Otherwise the air could rule out all of the first few but a wrong one, which would then seem to
    be without alternatives.

    Parameters
    ----------
    found : (n, 4, 4) float, T_bone_tracker, m, best first
    air : as in `log_likelihood`
    field : Field
    count : int

    """
    if not len(air):
        return found[:count]
    free = [k for k, T in enumerate(found) if log_likelihood(air, T, field) > -0.25 * MOST]
    return found[sorted({*range(min(count, len(found))), *free[:count]})]


def _terms(depths: Array) -> Array:
    """Return the log-likelihood of each place, log(WRONG + (1 - WRONG) P(free | depth)), (m,)."""
    free = ndtr(TOLERATED - depths / ACCURACY)
    return np.asarray(np.log(WRONG + (1.0 - WRONG) * free))
