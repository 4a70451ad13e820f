# SPDX-License-Identifier: Apache-2.0
"""
Rests: where the tip of the probe stayed in one place.

Consecutive positions in a small ball are a stay. A moving tip passes through the ball: the first
half of its positions is on one side, the second half on the other. At a rest both halves are in the
same place, and there are more positions than in the balls that the tip passes through. Nothing but
the order of the positions is used, as not every recording has stamps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common.components import components
from gsdf_registration.common.numba_options import compiled
from gsdf_registration.common.rigid import Array

RADIUS = (0.001, 0.003)     # m, of a stay: at least a hand's tremor; at most a feature of a bone
NOISE_RADII = 4.0           # standard deviations of the noise in the radius
# A stay goes on after at most this many positions elsewhere: outliers, or the tip of another probe
MEMORY = 8
MIN_STAY = 5                # positions at a rest
# times the positions of a slow passage: a hand on a bone is sometimes that slow
LINGERING = 2.0
SLOW = 0.9                  # quantile of the passages that is slow
SAME_PLACE = 0.5            # radii between the halves of a rest
# m, standard deviation of a long rest: the error of the tracker that does not average out
TRACKER_ERROR = 1e-4
MEDIAN_VARIANCE = 1.18      # of a geometric median in space over that of a mean
WEISZFELD = 20              # iterations, which leave a thousandth of the noise
# The noise is that of the smoothest tenth of the path, as half of it may be outliers: the squared
# second difference of noise is 6 times chi-square (3) times its variance
SMOOTH, SECOND_DIFFERENCE = 0.1, 6.0 * 0.5844


class Rests(NamedTuple):
    """
    The rests of a recording of n positions.

    which : (n,) int, rest of each position; -1: the tip moves
    positions : (r, 3) float, m, the geometric medians: as it lands and lifts off, a tip is slow
        as well
    noise : (r,) float, m, standard deviation of each position along any axis
    spread : (r,) float, m, standard deviation of a position at each rest along any axis
    """

    which: NDArray[np.int64]
    positions: Array
    noise: Array
    spread: Array


def find_rests(points: Array) -> Rests:
    """Return the rests among ``points`` (n, 3), m, finite, in the order they were measured."""
    radius = float(np.clip(NOISE_RADII * _noise(points), *RADIUS))
    stay, count = _stays(points, radius)
    first, second = _halves(points, stay, count)
    apart = np.sqrt(((first - second)**2).sum(axis=1))
    passed = (count > 2) & (apart >= SAME_PLACE * radius)
    slow = float(np.quantile(count[passed], SLOW)) if passed.any() else 0.0
    resting = np.flatnonzero((count >= max(MIN_STAY, LINGERING * slow)) & ~passed)
    rest_of_stay = np.full(len(count), -1)
    rest_of_stay[resting] = _places(0.5 * (first + second)[resting], radius)
    return _rests(points, rest_of_stay[stay])


def _noise(points: Array) -> float:
    """Return the standard deviation of the noise, m, at most: smooth motion hardly changes it."""
    if len(points) < 3:
        return 0.0
    bend = points[2:] - 2.0 * points[1:-1] + points[:-2]
    return float(np.sqrt(np.quantile((bend**2).sum(axis=1), SMOOTH) / SECOND_DIFFERENCE))


def _stays(points: Array, radius: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the stay of each position (n,), and the number of positions of each stay (m,)."""
    stay = np.empty(len(points), dtype=np.int64)
    total, count = np.zeros((len(points), 3)), np.zeros(len(points), dtype=np.int64)
    last = np.zeros(len(points), dtype=np.int64)
    # a copy: of the read-only points of a session another kernel would be compiled
    number = _assign(np.array(points, order='C'), radius * radius, stay, total, count, last)
    return stay, count[:number]


@compiled
def _assign(points: Array, radius2: float, stay: NDArray[np.int64], total: Array,
            count: NDArray[np.int64], last: NDArray[np.int64]) -> int:
    """Fill ``stay``, the sum and number of its positions, and its last one; return how many."""
    number = 0
    recent = np.full(MEMORY, -1)     # stays
    for k in range(len(points)):
        chosen, least = -1, radius2
        for j in range(MEMORY):
            s = recent[j]
            if s < 0 or k - last[s] > MEMORY:
                continue
            squared = 0.0
            for i in range(3):
                squared += (points[k, i] - total[s, i] / count[s]) ** 2
            if squared < least:
                chosen, least = s, squared
        if chosen < 0:
            chosen, oldest = number, 0
            for j in range(MEMORY):     # outliers must not displace the stay that goes on
                if recent[j] < 0 or last[recent[j]] < last[recent[oldest]]:
                    oldest = j
                if recent[oldest] < 0:
                    break
            recent[oldest] = chosen
            number += 1
        stay[k] = chosen
        last[chosen] = k
        count[chosen] += 1
        for i in range(3):
            total[chosen, i] += points[k, i]
    return number


def _halves(points: Array, stay: NDArray[np.int64],
            count: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the mean of the earlier and of the later half of the positions of each stay (m, 3)."""
    order = np.argsort(stay, kind='stable')
    rank = np.empty(len(stay), dtype=np.int64)
    rank[order] = np.arange(len(stay)) - np.repeat(np.cumsum(count) - count, count)
    early = 2 * rank < count[stay]
    return _means(points[early], stay[early], len(count)), _means(
        points[~early], stay[~early], len(count))


def _means(points: Array, which: NDArray[np.int64], count: int) -> Array:
    """Return the mean of the points with each number (count, 3); zero if there are none."""
    number = np.maximum(np.bincount(which, minlength=count), 1)
    return np.stack([np.bincount(which, x, count) for x in points.T], axis=1) / number[:, None]


def _geometric_medians(points: Array, which: NDArray[np.int64], count: int) -> Array:
    """
    Return the geometric median of the points with each number (count, 3).

    It moves with the points in any rotation, unlike the median of each coordinate (Weiszfeld 1937).
    """
    median = _means(points, which, count)
    number = np.maximum(np.bincount(which, minlength=count), 1)
    for _ in range(WEISZFELD):
        distance = np.sqrt(((points - median[which])**2).sum(axis=1))
        typical = np.bincount(which, distance, count) / number
        weight = 1.0 / np.maximum(distance, 0.001 * typical[which] + 1e-300)
        total = np.maximum(np.bincount(which, weight, count), 1e-300)
        median = np.stack([np.bincount(which, weight * x, count) for x in points.T],
                          axis=1) / total[:, None]
    return median


def _places(positions: Array, radius: float) -> NDArray[np.int64]:
    """Return the number of the place of each position (r, 3): those within ``radius`` share it."""
    if not len(positions):
        return np.zeros(0, dtype=np.int64)
    pairs = cKDTree(positions).query_pairs(radius, output_type='ndarray')
    return components(pairs, len(positions))[1]


def _rests(points: Array, which: NDArray[np.int64]) -> Rests:
    """Return the rests with their position and noise; ``which`` (n,) as in `Rests`."""
    own = np.flatnonzero(which >= 0)
    own = own[np.argsort(which[own], kind='stable')]
    place, count = which[own], np.bincount(which[own])
    middle = _geometric_medians(points[own], place, len(count))
    off = ((points[own] - middle[place])**2).sum(axis=1)
    variance = np.bincount(place, off, len(count)) / (3.0 * np.maximum(count - 1, 1))
    # a tremor or a drift does not average out: the halves differ by more than the noise of a mean
    first, second = _halves(points[own], place, count)
    drift = ((first - second)**2).sum(axis=1) / 12.0
    noise = np.sqrt(TRACKER_ERROR**2 + np.maximum(MEDIAN_VARIANCE * variance / count, drift))
    return Rests(which, middle, noise, np.sqrt(variance))
