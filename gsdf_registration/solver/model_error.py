# SPDX-License-Identifier: Apache-2.0
"""
Model error: correlated over a region of the bone, whereas noise is independent for every point.

A segmentation is off by half a voxel in places, cartilage is missing, an electromagnetic field is
distorted. A hundred points in such a region carry hardly more information than one, so they share
their weight: generalized least squares (Aitken 1936), with the error as a Gaussian process over the
surface with Matern 3/2 covariance. Its standard deviation and correlation length maximize the
restricted likelihood (REML; Patterson and Thompson 1971), the likelihood of the part of the
residuals that no motion of the bone explains. A model error is accepted if it raises the
likelihood by more than chance does; with noise alone, nothing changes.
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

# Points are grouped in cells over which the error is constant. Each pair: maximum number of cells,
# points per cell on average. A coarse grouping suffices to estimate the error, which takes many
# evaluations; the pose needs a fine one.
COARSE, FINE = (100, 6), (300, 2)
MIN_CELLS = 12      # twice the degrees of freedom
LENGTHS = (0.004, 0.008, 0.016, 0.032)      # m, candidates for the correlation length
# candidates for the model error over the noise of a point
RATIOS = (0.1, 0.15, 0.22, 0.33, 0.5, 0.7, 1.0, 1.5, 2.2, 3.3)
MIN_GAIN = 5.0      # of the log-likelihood, which noise alone hardly ever reaches


class ModelError(NamedTuple):
    """
    The error of a model in the area touched.

    sd : float, m, standard deviation along the normal
    length : float, m, correlation length
    noise : float, m, standard deviation of the independent noise of a point of precision 1
    jacobian : (n, 6) float, of the residuals, less the part that the model error may explain
    information_loss : (6, 6) float, by which it reduces the information J^T W J
    score_covariance : (6, 6) float, its contribution to the covariance of J^T W e, in units of the
        squared noise
    residuals : (n,) float, m, at the pose before it was allowed for
    """

    sd: float
    length: float
    noise: float
    jacobian: Array
    information_loss: Array
    score_covariance: Array
    residuals: Array


class _Cells(NamedTuple):
    """
    Points grouped by their position along the bone, in m cells.

    which : (n,) int, cell of each point
    root : (m,) float, square root of the sum of the weights
    J, e : (m, 6), (m,) float, weighted sums divided by ``root``: their noise has equal variance
    distance : (m, m) float, m, between cells
    within : float, m^2, weighted sum of squares of the residuals about the cell means
    points : float, sum of the weights
    """

    which: NDArray[np.intp]
    root: Array
    J: Array
    e: Array
    distance: Array
    within: float
    points: float


def find_model_error(x: Array, e: Array, J: Array, weight: Array,
                     precision: Array) -> ModelError | None:
    """
    Estimate the model error from residuals; return None if they contain only noise.

    Parameters
    ----------
    x : (n, 3) float, m, bone frame
        The points.
    e, J : (n,), (n, 6) float
        Their residuals and the derivatives by the pose; the last three columns are the normal.
    weight : (n,) float in [0, 1]
        Probability that a point is on the bone.
    precision : (n,) float
        Mean noise over the noise of each point.

    """
    points = x - e[:, None] * J[:, 3:], e, J, weight, precision     # on the surface
    cells = _group(*points, *COARSE)
    if cells is None or not cells.within > 0.0:
        return None
    scale = np.sqrt(np.maximum((cells.J**2).sum(axis=0), 1e-300))
    rows = np.concatenate([cells.J.T / scale[:, None], cells.e[None]])
    ratio, length, noise = _maximize_likelihood(cells.distance, cells.root, rows, cells.within,
                                                cells.points)
    cells = _group(*points, *FINE)
    if ratio == 0.0 or cells is None:
        return None
    # V^-1 J, where V = I + S is the covariance of the means; the expected model error is S V^-1 e
    rest = cells.J.T.copy()
    _solve(np.eye(len(cells.e)) + ratio**2 * _matern(cells.distance, cells.root, length), rest)
    expected = cells.J - rest.T
    explained = expected / cells.root[:, None]
    return ModelError(ratio * noise, length, noise, J - explained[cells.which],
                      cells.J.T @ expected, rest @ expected, e)


def _group(x: Array, e: Array, J: Array, weight: Array, precision: Array, max_cells: int,
           per_cell: int) -> _Cells | None:
    """Group points ``x`` (n, 3) in cells; return None if there are too few on the bone."""
    on = x[weight > 0.5]
    count = min(max_cells, len(on) // per_cell)
    if count < MIN_CELLS:
        return None
    which = cKDTree(on[farthest_point_sample(on, count)]).query(x)[1]
    w = weight * precision**2

    def total(v: Array) -> Array:
        return np.asarray(np.bincount(which, w * v, count), dtype=np.float64)
    N, sums = total(np.ones(len(e))), total(e)
    within = float((w * (e - (sums / N)[which])**2).sum())
    centroids = np.stack([total(axis) for axis in x.T], axis=1) / N[:, None]
    distance = np.sqrt(((centroids[:, None] - centroids)**2).sum(axis=2))
    root = np.sqrt(N)
    return _Cells(which, root, np.stack([total(column) for column in J.T], axis=1) / root[:, None],
                  sums / root, distance, within, float(weight.sum()))


@kernel
def _maximize_likelihood(distance, root, rows, within, points):
    """
    Return the ratio of model error to noise (0 if there is none), its length, and the noise.

    distance, root, within, points : as in `_Cells`
    rows : (7, m) the columns of J, of any scale, and e
    """
    best, noise = _restricted_likelihood(np.eye(len(root)), rows.copy(), within, points)
    best, found = best + MIN_GAIN, (0.0, 0.0, noise)
    for length in LENGTHS:
        correlation, last = _matern(distance, root, length), -np.inf
        for ratio in RATIOS:
            V = np.eye(len(root)) + ratio * ratio * correlation
            likely, noise = _restricted_likelihood(V, rows.copy(), within, points)
            if likely > best:
                best, found = likely, (ratio, length, noise)
            if likely < last:
                break
            last = likely
    return found


@kernel
def _matern(distance, root, length):
    """Return the Matern 3/2 correlation of cells (m, m), scaled by the roots of their weights."""
    S = np.empty(distance.shape)
    for i in range(len(S)):
        for j in range(i + 1):
            d = math.sqrt(3.0) * distance[i, j] / length
            S[i, j] = S[j, i] = (1.0 + d) * math.exp(-d) * root[i] * root[j]
    return S


@kernel
def _restricted_likelihood(V, rows, within, points):
    """
    Return the log-likelihood, up to a constant, and the noise that maximizes it.

    V, rows : (m, m) covariance in units of the noise, (7, m) columns of J and e; both overwritten
    """
    log_det_V = _factor(V)
    _forward_substitute(V, rows)
    G = np.empty((7, 7))
    for i in range(7):
        for j in range(7):
            G[i, j] = (rows[i] * rows[j]).sum()
    log_det_G = _factor(G)
    # the last pivot is the part of e that no motion explains
    squared = within + G[6, 6] * G[6, 6]
    freedom = points - 6.0
    log_det_G -= 2.0 * math.log(G[6, 6])
    return (-0.5 * (log_det_V + log_det_G + freedom * math.log(squared / freedom)),
            math.sqrt(squared / freedom))


@kernel
def _solve(V, rows):
    """Replace each row r of ``rows`` (k, m) by V^-1 r; ``V`` (m, m) is overwritten."""
    _factor(V)
    _forward_substitute(V, rows)
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

    Not from a library: the last bits would depend on its threads.
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
def _forward_substitute(U, rows):
    """Replace each row r of ``rows`` (k, m) by U^-T r."""
    for row in rows:
        for k in range(len(U)):
            row[k] /= U[k, k]
            for j in range(k + 1, len(U)):
                row[j] -= U[k, j] * row[k]
