# SPDX-License-Identifier: Apache-2.0
"""
Model error: correlated over a region of the bone, whereas noise is independent for every point.

A segmentation is off by half a voxel in places, its threshold dilates the whole bone, cartilage is
missing, an electromagnetic field is distorted. A hundred points in such a region carry hardly more
information than one, so they share their weight: generalized least squares (Aitken 1936), with the
error as a Gaussian process over the surface with Matern 3/2 covariance. An offset that is the same
everywhere is estimated with the pose, with a prior.

Neither size nor length of the error is known. Each combination has a prior probability, which
depends on what the user knows of the model, and a restricted likelihood (REML; Patterson and
Thompson 1971), that of the part of the residuals that no motion explains, averaged over the sizes
of the offset: an offset of which nothing is known would hide most of an error that varies slowly.
The mean covariance over all combinations is used: that of the error given the residuals. With noise
alone, it is small; there is no threshold. It is used with two priors: for the pose most models are
taken to be exact, as weights for an error that is not there cost accuracy; for what is stated fewer
are, as that must be true also if an error does not show.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from gsdf_registration.common.downsampling import farthest_point_sample
from gsdf_registration.common.numba_options import kernel
from gsdf_registration.common.rigid import Array
from gsdf_registration.solver.process_matrices import (
    add_matern,
    factor,
    gram,
    solve,
    tridiagonalize,
)

# Points are grouped in cells over which the error is constant. Each pair: maximum number of cells,
# points per cell on average. A coarse grouping suffices to estimate the size of the error, which
# takes many evaluations; the pose needs a fine one.
COARSE, FINE = (100, 6), (200, 3)
MIN_CELLS = 12      # twice the degrees of freedom
LENGTHS = np.array([0.004, 0.008, 0.016, 0.032, 0.064])     # m, equally probable
# Standard deviations of the local error and of the offset, over the expected one
SIZES = np.array([0.0, 0.1, 0.16, 0.26, 0.43, 0.7, 1.15, 1.9, 3.1, 5.0])
# Prior probability that there is no such error, for the pose and for what is stated of it; in the
# evidence for a local error, that of the offset is the second. From `benchmarks calibration`
EXACT, STATED_EXACT = 0.9, 0.5
MIN_RANK = 1e-9     # smallest eigenvalue of a scaled information matrix that constrains all motions
FOUND = 0.95        # probability of an error that is reported


def _prior(sizes: Array, exact: float) -> Array:
    """Return the probability of each size: half-t with two degrees of freedom, or none."""
    edges = np.sqrt(sizes[1:-1] * sizes[2:])
    below = np.concatenate([[0.0], edges / np.sqrt(edges**2 + 2.0), [1.0]])
    return np.concatenate([[exact], (1.0 - exact) * np.diff(below)])


PRIOR, STATED_PRIOR = _prior(SIZES, EXACT), _prior(SIZES, STATED_EXACT)


class ModelError(NamedTuple):
    """
    The error of a model in the area touched, at a pose.

    sd : float, m, standard deviation along the normal of the local error; 0 if none was found
    offset : float, m, most likely offset of the points from the model, outward
    noise : float, m, standard deviation of the independent noise of a point of precision 1
    jacobian : (n, 6) float, of the residuals, less the part that the local error may explain
    information_loss : (6, 6) float, by which it reduces the information J^T W J
    score_covariance : (6, 6) float, its stated contribution to the covariance of J^T W e, in units
        of the squared noise
    step : (6,) float, motion to the most likely pose
    offset_covariance : (6, 6) float, of this pose, due to the offset
    residuals : (n,) float, m, at this pose
    """

    sd: float
    offset: float
    noise: float
    jacobian: Array
    information_loss: Array
    score_covariance: Array
    step: Array
    offset_covariance: Array
    residuals: Array


class ErrorVariances(NamedTuple):
    """
    What is known of the size of the error.

    expected : float, m, standard deviation that the user expects
    local : (k,) float, m^2, mean variance of the local error for each of `LENGTHS`
    stated : (k,) float, m^2, the same with the prior for what is stated
    found : float, probability that there is a local error
    """

    expected: float
    local: Array
    stated: Array
    found: float


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

    @property
    def noise(self) -> float:
        """Standard deviation of a point about its cell, m; 0 if there are no more points."""
        return math.sqrt(self.within / max(self.points - len(self.e), 1.0))


def error_variances(x: Array, e: Array, J: Array, weight: Array, precision: Array,
                    expected: float) -> ErrorVariances:
    """
    Return the size of the local error given the residuals; of few points, the expected one.

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
    expected : float, m
        Expected standard deviation of the error.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the points do not constrain the pose.

    """
    squares = (expected * SIZES)**2
    cells = _group(x, e, J, weight, precision, *COARSE)
    if cells is None or not cells.within > 0.0:
        # too few to tell error and noise apart, but the error is not larger than the residuals
        freedom = max(float(weight.sum()) - len(J[0]), 1.0)
        possible = squares <= float((weight * (precision * e)**2).sum()) / freedom
        return _mean(expected, np.tile(PRIOR * possible, (len(LENGTHS), 1)))
    scale = np.sqrt(np.maximum((cells.J**2).sum(axis=0), 1e-300))
    rows = np.concatenate([cells.J.T / scale[:, None], cells.root[None], cells.e[None]])
    log_likelihood = np.empty((len(LENGTHS), len(SIZES), len(SIZES)))
    _restricted_likelihood(cells.distance, cells.root, rows, cells.within, cells.points,
                           squares / cells.noise**2, LENGTHS, log_likelihood)
    if not np.isfinite(log_likelihood).all():
        raise np.linalg.LinAlgError
    likelihood = np.exp(log_likelihood - log_likelihood.max()) @ STATED_PRIOR
    return _mean(expected, PRIOR * likelihood)


def _mean(expected: float, probability: Array) -> ErrorVariances:
    """Return mean variances, given the ``probability`` (lengths, sizes) of the error, unscaled."""
    squares, total = (expected * SIZES)**2, float(probability.sum())
    stated = probability * (STATED_PRIOR / PRIOR)
    return ErrorVariances(expected, probability @ squares / total, stated @ squares / stated.sum(),
                          1.0 - float(probability[:, 0].sum()) / total)


class Allowance:
    """
    Allows for an error of known size, also while the pose is improved.

    Parameters
    ----------
    variances : ErrorVariances
    x, e, J, weight, precision
        As in `error_variances`.
    noise : float, m
        Standard deviation of a point, for the case that there are too few to estimate it.

    Raises
    ------
    numpy.linalg.LinAlgError
        If there are too few points; from `error` also if they do not constrain the pose.

    """

    def __init__(self, variances: ErrorVariances, x: Array, e: Array, J: Array, weight: Array,
                 precision: Array, noise: float) -> None:
        cells = _group(x, e, J, weight, precision, *FINE) or _group(x, e, J, weight, precision,
                                                                    FINE[0], 1)
        if cells is None:
            raise np.linalg.LinAlgError
        self._variances, self._cells, self._weight = variances, cells, weight * precision**2
        self._noise = cells.noise if cells.points > 1.5 * len(cells.e) else noise
        self._U = np.eye(len(cells.e))
        self._stated = np.zeros_like(self._U)
        for length, *both in zip(LENGTHS, variances.local, variances.stated):
            S = np.zeros_like(self._U)
            add_matern(cells.distance, cells.root, length, 1.0, S)
            for V, variance in zip((self._U, self._stated), both):
                V += variance / self._noise**2 * S
        factor(self._U)

    def error(self, e: Array, J: Array) -> ModelError:
        """Return the error for residuals ``e`` (n,) and derivatives ``J`` (n, 6) at a pose."""
        cells, variances = self._cells, self._variances
        rows = np.concatenate([J.T, np.ones((1, len(e)))])      # of the pose and of the offset
        means = np.stack([np.bincount(cells.which, self._weight * row, len(cells.root))
                          for row in rows]) / cells.root
        # V^-1 J, where V = I + S is the covariance of the means; the expected error is S V^-1 e
        rest = means.copy()
        solve(self._U, rest)
        explained = (means - rest) / cells.root
        reduced = rows - explained[:, cells.which]
        A, b = (reduced * self._weight) @ rows.T, (reduced * self._weight) @ e
        C = _inverse(A[:6, :6])
        slope = C @ A[:6, 6]       # of the pose by the offset
        # the offset as if nothing was known of it, and its information: a Schur complement
        information = A[6, 6] - A[6, :6] @ slope
        offset, variance = _shrunk((b[6] - slope @ b[:6]) / information,
                                   self._noise**2 / information, variances.expected)
        return ModelError(
            math.sqrt(variances.local.sum()) if variances.found > FOUND else 0.0, offset,
            self._noise, reduced[:6].T, means[:6] @ (means - rest)[:6].T,
            rest[:6] @ self._stated @ rest[:6].T, slope * offset - C @ b[:6],
            variance * np.outer(slope, slope), e)


def _inverse(A: Array) -> Array:
    """Return the inverse of an information matrix (6, 6), in any unit; raise if it is singular."""
    scale = np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = A / np.outer(scale, scale)
    if not np.isfinite(A).all() or np.linalg.eigvalsh(0.5 * (scaled + scaled.T))[0] < MIN_RANK:
        raise np.linalg.LinAlgError
    return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale))


def _shrunk(value: float, variance: float, expected: float) -> tuple[float, float]:
    """
    Return an estimate of the offset, m, from a measured ``value`` of this variance.

    With it the mean square of its error, m^2, which is stated.
    """
    squares = (expected * SIZES)**2
    total = squares + variance
    exponent = -0.5 * value**2 / total
    likelihood = np.exp(exponent - exponent.max()) / np.sqrt(total)
    share = squares / total
    mean = float(PRIOR @ (likelihood * share) / (PRIOR @ likelihood))
    stated = STATED_PRIOR * likelihood / (STATED_PRIOR @ likelihood)
    return mean * value, float(stated @ (share * variance + (share - mean)**2 * value**2))


def _group(x: Array, e: Array, J: Array, weight: Array, precision: Array, max_cells: int,
           per_cell: int) -> _Cells | None:
    """Group points ``x`` (n, 3) in cells; return None if there are too few on the bone."""
    x = x - e[:, None] * J[:, 3:]       # on the surface
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
    root = np.sqrt(N)
    return _Cells(which, root, np.stack([total(column) for column in J.T], axis=1) / root[:, None],
                  sums / root, cdist(centroids, centroids), within, float(weight.sum()))


@kernel
def _restricted_likelihood(distance, root, rows, within, points, squares, lengths, log_likelihood):
    """
    Fill ``log_likelihood`` (lengths, sizes of the local error, sizes of the offset).

    distance, root, within, points : as in `_Cells`
    rows : (8, m) the columns of J, of any scale, the offset and e
    squares : (k,) variance of each size of either error over that of the noise
    """
    m, freedom = len(root), points - 6.0
    diagonal, beside = np.empty(m), np.empty(m)
    G = np.empty((8, 8))
    for i in range(len(lengths)):
        S = np.zeros((m, m))
        add_matern(distance, root, lengths[i], 1.0, S)
        turned = rows.copy()
        tridiagonalize(S, turned, diagonal, beside)
        for k in range(len(squares)):
            log_det = gram(diagonal, beside, squares[k], turned.copy(), G) + factor(G)
            # the pivots of the offset and of e are not of J: the information of the offset once
            # the pose is fitted, and the part of e that neither explains
            log_det -= 2.0 * (math.log(G[6, 6]) + math.log(G[7, 7]))
            for t in range(len(squares)):
                variance = 1.0 + squares[t] * G[6, 6]**2    # of G[6, 7], the measured offset
                squared = within + G[7, 7]**2 + G[6, 7]**2 / variance
                log_likelihood[i, k, t] = -0.5 * (log_det + math.log(variance)
                                                  + freedom * math.log(squared / freedom))
