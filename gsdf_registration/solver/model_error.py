# SPDX-License-Identifier: Apache-2.0
"""
The error of the model: alike over a stretch of bone, where noise is new with every point.

A segmentation is half a voxel off here and there, cartilage is left out, an electromagnetic field
is bent. A hundred points on one such stretch know no more than one, so they share their weight:
generalized least squares (Aitken 1936), the error a Gaussian process over the surface with a Matern
3/2 covariance.  Its standard deviation and length are those of the highest restricted likelihood
(REML; Patterson and Thompson 1971), which is that of what no motion of the bone explains.  They
are believed if they raise it by more than chance does; where only noise is there, nothing changes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.density import spread_sample
from gsdf_registration.rigid import Array

# that points are gathered in, over each of which the error is one: few tell its size, which takes
# many trials, more the pose; and how many points there must be in each, on average
FEW, MANY = (100, 6), (300, 2)
FEWEST = 12         # cells, twice the motions
LENGTHS = (0.004, 0.008, 0.016, 0.032)      # m, that are tried
RATIOS = (0.1, 0.15, 0.22, 0.33, 0.5, 0.7, 1.0, 1.5, 2.2, 3.3)      # to the noise of a point
GAIN = 3.0          # of the log-likelihood; noise alone gives as much once in some hundred times


class ModelError(NamedTuple):
    """
    The error of a model where it was touched.

    sd : float, m, standard deviation along the normal
    length : float, m, over which it is alike
    noise : float, m, standard deviation of what is new with every point, relative precision 1
    jacobian : (n, 6) float, of the residuals, less what the error of the model may explain of it
    lost : (6, 6) float, what that takes from the information J^T W J
    spread : (6, 6) float, covariance that it gives J^T W e, in units of the squared noise
    """

    sd: float
    length: float
    noise: float
    jacobian: Array
    lost: Array
    spread: Array


class _Cells(NamedTuple):
    """
    Points gathered where they lie along the bone: m cells.

    which : (n,) int, the cell of each point
    weight : (m,) float, sum of the weights
    J, e : (m, 6), (m,) float, weighted sums
    apart : (m, m) float, m, between cells
    within : float, m^2, weighted sum of the squares of what is left of the residuals in them
    points : float, how many they hold
    """

    which: NDArray[np.intp]
    weight: Array
    J: Array
    e: Array
    apart: Array
    within: float
    points: float


def find_model_error(x: Array, e: Array, J: Array, weight: Array,
                     precision: Array) -> ModelError | None:
    """
    Return the error of the model that residuals speak of, or None if they are but noise.

    Parameters
    ----------
    x : (n, 3) float, m, bone frame
        The points.
    e, J : (n,), (n, 6) float
        Their residuals and the derivatives by the pose; J ends with the normal.
    weight : (n,) float in [0, 1]
        Whether they are on the bone.
    precision : (n,) float
        The mean noise over that of each.

    """
    points = x - e[:, None] * J[:, 3:], e, J, weight, precision     # where they lie along the bone
    cells = _gathered(*points, *FEW)
    if cells is None or not cells.within > 0.0:
        return None
    ratio, length, noise = _most_likely(cells)
    cells = _gathered(*points, *MANY)
    if ratio == 0.0 or cells is None:
        return None
    # (K^-1 + N)^-1, by which a mean residual is believed to be the model's, K the covariance
    N, K = cells.weight, ratio**2 * _matern(cells.apart / length)
    believed = np.linalg.solve(np.eye(len(N)) + K * N, K)
    explained = believed @ cells.J
    left = cells.J - N[:, None] * explained
    return ModelError(ratio * noise, length, noise, J - explained[cells.which],
                      cells.J.T @ explained, left.T @ K @ left)


def _gathered(x: Array, e: Array, J: Array, weight: Array, precision: Array, most: int,
              in_each: int) -> _Cells | None:
    """Return the cells of points ``x`` (n, 3) on the bone, or None if there are too few."""
    on = x[weight > 0.5]
    count = min(most, len(on) // in_each)
    if count < FEWEST:
        return None
    which = cKDTree(on[spread_sample(on, count)]).query(x)[1]
    w = weight * precision**2

    def total(v: Array) -> Array:
        return np.asarray(np.bincount(which, w * v, count), dtype=np.float64)
    N, sums = total(np.ones(len(e))), total(e)
    within = float((w * (e - (sums / N)[which])**2).sum())
    centres = np.stack([total(axis) for axis in x.T], axis=1) / N[:, None]
    apart = np.sqrt(((centres[:, None] - centres)**2).sum(axis=2))
    return _Cells(which, N, np.stack([total(column) for column in J.T], axis=1), sums, apart,
                  within, float(weight.sum()))


def _most_likely(cells: _Cells) -> tuple[float, float, float]:
    """Return the ratio of the model's error to the noise, 0 if there is none, its length, noise."""
    root = np.sqrt(cells.weight)
    J, e = cells.J / root[:, None], cells.e / root
    J = J / np.sqrt((J**2).sum(axis=0))     # whatever the units of a motion
    known = cells.within, cells.points
    best, noise = _restricted_likelihood(np.ones(len(e)), J, e, *known)
    best, found = best + GAIN, (0.0, LENGTHS[0], noise)
    for length in LENGTHS:
        # along the axes of the covariance all that it adds to the noise is a variance each
        more, axes = np.linalg.eigh(root[:, None] * _matern(cells.apart / length) * root)
        turned = axes.T @ J, axes.T @ e
        for ratio in RATIOS:
            likely, noise = _restricted_likelihood(1.0 + ratio**2 * np.maximum(more, 0.0), *turned,
                                                   *known)
            if likely > best:
                best, found = likely, (ratio, length, noise)
    return found


def _restricted_likelihood(variance: Array, J: Array, e: Array, within: float,
                           points: float) -> tuple[float, float]:
    """
    Return its logarithm, but for a constant, and the noise at which it is highest.

    Parameters
    ----------
    variance : (m,) float, of ``e`` over that of the noise
    J, e : (m, 6), (m,) float, of the cells, times the square root of their weights
    within, points : what the residuals within the cells add up to, and how many there are

    """
    weighted = J.T / variance
    A, b = weighted @ J, weighted @ e
    squared = within + float((e**2 / variance).sum() - b @ np.linalg.solve(A, b))
    free = points - J.shape[1]
    likely = -0.5 * (float(np.log(variance).sum() + np.linalg.slogdet(A)[1])
                     + free * np.log(squared / free))
    return float(likely), float(np.sqrt(squared / free))


def _matern(d: Array) -> Array:
    """Return the Matern 3/2 correlation at so many lengths."""
    d = np.sqrt(3.0) * d
    return np.asarray((1.0 + d) * np.exp(-d))
