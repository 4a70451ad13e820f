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

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common.downsampling import farthest_point_sample
from gsdf_registration.common.numba_options import kernel
from gsdf_registration.common.rigid import Array

# that points are gathered in, over each of which the error is one: few tell its size, which takes
# many trials, more the pose; and how many points there must be in each, on average
FEW, MANY = (100, 6), (300, 2)
FEWEST = 12         # cells, twice the motions
LENGTHS = (0.004, 0.008, 0.016, 0.032)      # m, that are tried
RATIOS = (0.1, 0.15, 0.22, 0.33, 0.5, 0.7, 1.0, 1.5, 2.2, 3.3)      # to the noise of a point
GAIN = 5.0          # of the log-likelihood, which noise alone hardly ever gives


class ModelError(NamedTuple):
    """
    The error of a model where it was touched.

    sd : float, m, standard deviation along the normal
    length : float, m, over which it is alike
    noise : float, m, standard deviation of what is new with every point, relative precision 1
    jacobian : (n, 6) float, of the residuals, less what the error of the model may explain of it
    lost : (6, 6) float, what that takes from the information J^T W J
    spread : (6, 6) float, covariance that it gives J^T W e, in units of the squared noise
    residuals : (n,) float, m, at the pose that takes it for noise
    """

    sd: float
    length: float
    noise: float
    jacobian: Array
    lost: Array
    spread: Array
    residuals: Array


class _Cells(NamedTuple):
    """
    Points gathered where they lie along the bone: m cells.

    which : (n,) int, the cell of each point
    root : (m,) float, square root of the sum of the weights
    J, e : (m, 6), (m,) float, weighted sums over that, of the one variance that noise has
    apart : (m, m) float, m, between cells
    within : float, m^2, weighted sum of the squares of what is left of the residuals in them
    points : float, how many they hold
    """

    which: NDArray[np.intp]
    root: Array
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
    scale = np.sqrt(np.maximum((cells.J**2).sum(axis=0), 1e-300))
    rows = np.concatenate([cells.J.T / scale[:, None], cells.e[None]])
    ratio, length, noise = _most_likely(cells.apart, cells.root, rows, cells.within, cells.points)
    cells = _gathered(*points, *MANY)
    if ratio == 0.0 or cells is None:
        return None
    # V^-1 J, V = I + S the covariance of the means; the model's error is believed to be S V^-1 e
    rest = cells.J.T.copy()
    _solve(np.eye(len(cells.e)) + ratio**2 * _alike(cells.apart, cells.root, length), rest)
    believed = cells.J - rest.T
    explained = believed / cells.root[:, None]
    return ModelError(ratio * noise, length, noise, J - explained[cells.which],
                      cells.J.T @ believed, rest @ believed, e)


def _gathered(x: Array, e: Array, J: Array, weight: Array, precision: Array, most: int,
              in_each: int) -> _Cells | None:
    """Return the cells of points ``x`` (n, 3) on the bone, or None if there are too few."""
    on = x[weight > 0.5]
    count = min(most, len(on) // in_each)
    if count < FEWEST:
        return None
    which = cKDTree(on[farthest_point_sample(on, count)]).query(x)[1]
    w = weight * precision**2

    def total(v: Array) -> Array:
        return np.asarray(np.bincount(which, w * v, count), dtype=np.float64)
    N, sums = total(np.ones(len(e))), total(e)
    within = float((w * (e - (sums / N)[which])**2).sum())
    centres = np.stack([total(axis) for axis in x.T], axis=1) / N[:, None]
    apart = np.sqrt(((centres[:, None] - centres)**2).sum(axis=2))
    root = np.sqrt(N)
    return _Cells(which, root, np.stack([total(column) for column in J.T], axis=1) / root[:, None],
                  sums / root, apart, within, float(weight.sum()))


@kernel
def _most_likely(apart, root, rows, within, points):
    """
    Return the ratio of the model's error to the noise, 0 if there is none, its length, the noise.

    rows : (7, m) the columns of J, of any length, and e
    within, points : what the residuals within the cells add up to, and how many there are
    """
    best, noise = _restricted_likelihood(np.eye(len(root)), rows.copy(), within, points)
    best, found = best + GAIN, (0.0, 0.0, noise)
    for length in LENGTHS:
        alike, last = _alike(apart, root, length), -np.inf
        for ratio in RATIOS:
            V = np.eye(len(root)) + ratio * ratio * alike
            likely, noise = _restricted_likelihood(V, rows.copy(), within, points)
            if likely > best:
                best, found = likely, (ratio, length, noise)
            if likely < last:
                break
            last = likely
    return found


@kernel
def _alike(apart, root, length):
    """Return the Matern 3/2 correlation of cells (m, m), each times the root of its weight."""
    S = np.empty(apart.shape)
    for i in range(len(S)):
        for j in range(i + 1):
            d = math.sqrt(3.0) * apart[i, j] / length
            S[i, j] = S[j, i] = (1.0 + d) * math.exp(-d) * root[i] * root[j]
    return S


@kernel
def _restricted_likelihood(V, rows, within, points):
    """
    Return its logarithm, but for a constant, and the noise at which it is highest.

    V, rows : (m, m) covariance in units of the noise, (7, m) the columns of J and e; overwritten
    """
    spread = _factor(V)
    _forward(V, rows)
    G = np.empty((7, 7))
    for i in range(7):
        for j in range(7):
            G[i, j] = (rows[i] * rows[j]).sum()
    held = _factor(G)
    # the last pivot is what of e no motion explains
    squared = within + G[6, 6] * G[6, 6]
    free = points - 6.0
    held -= 2.0 * math.log(G[6, 6])
    return -0.5 * (spread + held + free * math.log(squared / free)), math.sqrt(squared / free)


@kernel
def _solve(V, rows):
    """Replace each of ``rows`` (k, m) by V^-1 times it; ``V`` (m, m) is overwritten."""
    _factor(V)
    _forward(V, rows)
    for row in rows:
        for k in range(len(V) - 1, -1, -1):
            total = row[k]
            for j in range(k + 1, len(V)):
                total -= V[k, j] * row[j]
            row[k] = total / V[k, k]


@kernel
def _factor(V):
    """
    Replace the upper triangle of ``V`` by U, V = U^T U (Cholesky); return log det V.

    Here and not by a library, whose threads would decide on the last bits.
    """
    m = len(V)
    log_det = 0.0
    for k in range(m):
        pivot = math.sqrt(V[k, k])
        log_det += 2.0 * math.log(pivot)
        for i in range(k, m):
            V[k, i] /= pivot
        for j in range(k + 1, m):
            factor = V[k, j]
            for i in range(j, m):
                V[j, i] -= factor * V[k, i]
    return log_det


@kernel
def _forward(U, rows):
    """Replace each of ``rows`` (k, m) by U^-T times it."""
    for row in rows:
        for k in range(len(U)):
            row[k] /= U[k, k]
            for j in range(k + 1, len(U)):
                row[j] -= U[k, j] * row[k]
