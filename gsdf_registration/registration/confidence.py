# SPDX-License-Identifier: Apache-2.0
"""
The confidence in a pose: its covariance and the predicted TRE.

Both follow from the 6 x 6 covariance of a small motion [xi, phi] of the bone frame: a rotation xi
about the centroid m of the points and a translation phi. A target q moves by B_q [xi, phi] with
B_q = [-(q - m)^, I].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from dataclasses import field as item

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.motions import inverse, motion_between
from gsdf_registration.solver import PARAMETERS, Solution, before, nearest_neighbours

# The residuals show the part of the error of the model that no motion explains. The other part is
# larger: an error that varies slowly looks like a motion. From `benchmarks calibration`.
MODEL_FACTOR = 1.6
# 95 % quantile of chi-square for 1 to 3 degrees of freedom
FREEDOM = np.linspace(1.0, 3.0, 65)
CHI_SQUARE_95 = 2.0 * gammaincinv(0.5 * FREEDOM, 0.95)


@dataclass(frozen=True)
class Confidence:
    """
    How well the points constrain the pose.

    motion_covariance : (6, 6) float, of [rotation about ``centroid`` (rad), translation (m)], bone
        axes, without the error of the tip
    centroid : (3,) float, m, bone frame, of the points
    sigma : float, m, noise of a point along the surface normal
    residual_correlation : float, variance of the mean residual of neighbouring points over that of
        white noise, less an offset that all points share; 1 for the correct bone and an accurate
        tracker
    model_sd : float, m, standard deviation of the error of the model; 0 if none was found
    model_covariance : (6, 6) float, the part of ``motion_covariance`` due to this error
    landmark_information : (6, 6) float, of the landmarks, which ``motion_covariance`` includes
    tip_error : float, m, RMS distance by which the tip is wrong, at all points and landmarks alike
    """

    motion_covariance: Array
    centroid: Array
    sigma: float
    residual_correlation: float
    model_sd: float = 0.0
    model_covariance: Array = item(default_factory=lambda: np.zeros((6, 6)))
    landmark_information: Array = item(default_factory=lambda: np.zeros((6, 6)))
    tip_error: float = 0.0

    @property
    def total_covariance(self) -> Array:
        """
        Covariance (6, 6) as ``motion_covariance``, with the error of the tip.

        A tool that is held about the same way shifts all points by this error, and so the bone: no
        further touch shows or reduces it. In which direction is not known.
        """
        C = self.motion_covariance.copy()
        C[[3, 4, 5], [3, 4, 5]] += self.tip_error**2 / 3.0
        return C

    def predicted_tre(self, targets: Array) -> Array:
        """Return the predicted TRE (n,) (RMS, m) at ``targets`` (n, 3), m, bone frame."""
        C = self.total_covariance
        return _expected_length(C[3:, 3:], C[3:, :3], C[:3, :3], targets - self.centroid)

    def p95(self, targets: Array) -> Array:
        """Return the 95 % bound of the error (n,), m, at ``targets`` (n, 3), m, bone frame."""
        return _bound_at(self.total_covariance, targets - self.centroid)

    def pose_covariance(self, T_tracker_bone: Array) -> Array:
        """
        Return the (6, 6) pose covariance in REP-103 order: x y z rx ry rz, fixed axes, m and rad.

        A motion D of the bone frame changes ``T_tracker_bone`` into T D^-1: the origin moves by
        R (xi x m - phi) and the orientation by -R xi.
        """
        R = T_tracker_bone[:3, :3]
        G = np.zeros((6, 6))
        G[:3, :3], G[:3, 3:], G[3:, :3] = -R @ rigid.skew(self.centroid), -R, -R
        C = G @ self.total_covariance @ G.T
        return np.asarray(0.5 * (C + C.T))


def predicted_tre(T_tracker_bone: Array, covariance: Array, points: Array) -> Array:
    """
    Return the predicted TRE (n,) (RMS, m) of a pose.

    Parameters
    ----------
    T_tracker_bone : (4, 4) float, metres
    covariance : (6, 6) float
        As from `Confidence.pose_covariance`.
    points : (n, 3) float, m, bone frame

    """
    return _expected_length(covariance[:3, :3], covariance[:3, 3:], covariance[3:, 3:],
                            points @ T_tracker_bone[:3, :3].T)


def error_bound(T_tracker_bone: Array, covariance: Array, points: Array) -> Array:
    """Return the 95 % bound of the error (n,), m, of a pose; parameters as `predicted_tre`."""
    order = [3, 4, 5, 0, 1, 2]      # rotation first, as in `motion_at`
    return _bound_at(covariance[np.ix_(order, order)], points @ T_tracker_bone[:3, :3].T)


def _expected_length(C_tt: Array, C_tr: Array, C_rr: Array, arms: Array) -> Array:
    """
    Return the expected length (n,) (RMS) of t + r x a, for small r and t of these covariances.

    The mean square is a quadratic form in the ``arms`` a (n, 3), which is fast for a whole surface.
    """
    t_cross_r = np.array([C_tr[1, 2] - C_tr[2, 1], C_tr[2, 0] - C_tr[0, 2],
                          C_tr[0, 1] - C_tr[1, 0]])
    spread = np.trace(C_rr) * np.eye(3) - C_rr
    squared = ((arms @ spread + 2.0 * t_cross_r) * arms).sum(axis=1)
    return np.asarray(np.sqrt(np.trace(C_tt) + squared))


def _bound_at(covariance: Array, arms: Array) -> Array:
    """
    Return the 95 % quantile (n,) of the length of B [xi, phi], m, with B as in `motion_at`.

    B is linear in the ``arms`` (n, 3), so each entry of B C B^T is a quadratic polynomial in them:
    one product for all places instead of two for each.
    """
    origin = motion_at(np.zeros((1, 3)))
    basis = np.concatenate([origin, motion_at(np.eye(3)) - origin])
    coefficients = np.einsum('uij,jk,vlk->uvil', basis, covariance, basis).reshape(16, 9)
    linear = np.column_stack([np.ones(len(arms)), arms])
    quadratic = (linear[:, :, None] * linear[:, None, :]).reshape(-1, 16)
    return _quantile_of_length((quadratic @ coefficients).T)


def _quantile_of_length(C: Array) -> Array:
    """
    Return the 95 % quantile (n,) of the length of Gaussian vectors.

    The squared length is a weighted sum of chi-squares. It is replaced by a shifted and scaled
    chi-square of the same mean, variance and skewness (Pearson 1959; Imhof 1961, section 4): exact
    for equal or single eigenvalues, within 0.7 % between.

    Parameters
    ----------
    C : (9, n) float
        Covariance of each vector, row by row.

    """
    total = np.maximum(C[0] + C[4] + C[8], 1e-300)      # sum of the eigenvalues
    xx, xy, xz, _, yy, yz, _, _, zz = C / total
    xy2, xz2, yz2 = xy**2, xz**2, yz**2
    second = xx**2 + yy**2 + zz**2 + 2.0 * (xy2 + xz2 + yz2)    # tr C^2
    third = (xx * (xx**2 + 3.0 * (xy2 + xz2)) + yy * (yy**2 + 3.0 * (xy2 + yz2))
             + zz * (zz**2 + 3.0 * (xz2 + yz2)) + 6.0 * xy * xz * yz)      # tr C^3
    third = np.where(third > 0.0, third, 1.0)       # zero without uncertainty
    freedom = second**3 / third**2
    above = (np.interp(freedom, FREEDOM, CHI_SQUARE_95) - freedom) * third / np.maximum(second, 0.3)
    return np.asarray(np.sqrt(total * (1.0 + above)))


def motion_at(arms: Array) -> Array:
    """Return B = [-(q - m)^, I], (n, 3, 6), for ``arms`` q - m (n, 3)."""
    B = np.zeros((len(arms), 3, 6))
    x, y, z = arms.T
    B[:, 0, 1], B[:, 0, 2] = z, -y
    B[:, 1, 0], B[:, 1, 2] = -z, x
    B[:, 2, 0], B[:, 2, 1] = y, -x
    B[:, :, 3:] = np.eye(3)
    return B


def assess(solution: Solution, points: Array, neighbours: NDArray[np.int64],
           tip_error: float) -> Confidence | None:
    """
    Return the confidence in a solution, or None if its points do not constrain the pose.

    The covariance is that of an M-estimate (Huber 1981, section 6.3), H^-1 S H^-1 with
    H = sum psi' J J^T, psi = w e, and S = sigma^2 sum w^2 J J^T the covariance of sum psi J. For
    plain least squares it is the Cramer-Rao bound sigma^2 (J^T J)^-1. Each row of J and its
    residual are divided by the relative noise along its normal. If the solution allows for an error
    of the model, the part that this error may explain is subtracted from H and J and added to S,
    and what that adds to the covariance is multiplied by `MODEL_FACTOR`.

    Parameters
    ----------
    solution : Solution
    points : (n, 3) float, metres, tracker frame
        The points of the solution.
    neighbours : (s, k) int
        The points nearest to each point on a stroke, over which residuals are averaged.
    tip_error : float, m
        ``probe.tip_error``

    """
    noise, error = _noise_covariance(solution), solution.model_error
    if noise is None:
        return None
    if error is None:
        correlation = _residual_correlation(solution.weights, solution.residuals, neighbours)
        return _confidence(solution, points, noise, correlation, 0.0, np.zeros((6, 6)), tip_error)
    total = _covariance(solution, error.jacobian, _variance(solution), error.information_loss,
                        error.score_covariance)
    if total is None:
        return None
    # an offset that is the same everywhere is no sign of another bone, even if the mixture takes
    # some of its points for interference
    correlation = min(_residual_correlation(solution.weights, residuals, neighbours)
                      for residuals in (error.residuals, solution.residuals - error.offset))
    return _confidence(solution, points, noise, correlation, error.sd,
                       MODEL_FACTOR * _excess(total, noise) + error.offset_covariance, tip_error)


def assess_at(solution: Solution, points: Array, field: Field,
              tip_error: float) -> Confidence | None:
    """Return `assess` with the nearest neighbours of each point on the bone."""
    on_strokes = before(solution.touches, points)
    neighbours = nearest_neighbours(on_strokes, field, solution.T_bone_tracker)
    return assess(solution, points, neighbours, tip_error)


def reassess(previous: Confidence, solution: Solution, points: Array) -> Confidence | None:
    """
    Return the confidence in a solution with a few more points than a ``previous`` one.

    The residual correlation and the error of the model are copied from there: they take most of the
    time and hardly change.
    """
    noise = _noise_covariance(solution)
    if noise is None:
        return None
    found = _confidence(solution, points, noise, previous.residual_correlation, previous.model_sd,
                        previous.model_covariance, previous.tip_error)
    if not previous.landmark_information.any():
        return found
    G = motion_between(previous.centroid, found.centroid)
    return with_landmarks(found, G.T @ previous.landmark_information @ G)


def noise_of(solution: Solution) -> float:
    """Return the noise of a point along the surface normal, m."""
    w, e = solution.weights, np.nan_to_num(solution.residuals)
    return float(np.sqrt((w * e**2).sum() / w.sum()))


def with_landmarks(confidence: Confidence, information: Array) -> Confidence:
    """Return the confidence with the ``information`` (6, 6) of landmarks about its centroid."""
    C = inverse(inverse(confidence.motion_covariance) + information)
    return replace(confidence, motion_covariance=C, landmark_information=information)


def about(confidence: Confidence, centroid: Array) -> Confidence:
    """Return the confidence of points alone with motions about another ``centroid`` (3,), m."""
    G = motion_between(centroid, confidence.centroid)
    return replace(confidence, motion_covariance=G @ confidence.motion_covariance @ G.T,
                   centroid=centroid, model_covariance=G @ confidence.model_covariance @ G.T)


def _confidence(solution: Solution, points: Array, noise: Array, correlation: float,
                model_sd: float, model_covariance: Array, tip_error: float) -> Confidence:
    """Return the confidence with the covariances due to ``noise`` and to an error of the model."""
    centroid = rigid.transform(solution.T_bone_tracker, points.mean(axis=0))
    return Confidence(noise + model_covariance, centroid, noise_of(solution), correlation, model_sd,
                      model_covariance, tip_error=tip_error)


def _noise_covariance(solution: Solution) -> Array | None:
    """Return the covariance of `assess` without an error of the model."""
    return _covariance(solution, solution.jacobian, _variance(solution))


def _variance(solution: Solution) -> float:
    """Return the variance of the noise of a point of precision 1, m^2."""
    w, e, p = solution.weights, np.nan_to_num(solution.residuals), solution.precision
    if 2 * len(solution.touches) > len(e):
        # the pose fits a part of the noise of a few touches, and an estimate from few is uncertain:
        # the variance of Student's t, n / (n - 2) for n degrees of freedom
        return float((w * (p * e) ** 2).sum() / max(w.sum() - PARAMETERS - 2.0, 1.0))
    if solution.model_error is not None:
        return solution.model_error.noise**2
    return float(((w * p * e) ** 2).sum() / max((w**2).sum(), 1e-300))


def _covariance(solution: Solution, jacobian: Array, variance: float,
                information_loss: Array | float = 0.0,
                score_covariance: Array | float = 0.0) -> Array | None:
    """
    Return the covariance of `assess`, or None if the points do not constrain the pose.

    Parameters
    ----------
    solution : Solution
    jacobian : (n, 6) float
        J without the part that an error of the model may explain.
    variance : float, m^2
        Of the noise of a point.
    information_loss, score_covariance : (6, 6) float
        Due to this error: subtracted from H, and added to S / sigma^2.

    """
    used = solution.weights > 0.0
    w, precision = solution.weights[used], solution.precision[used, None]
    if w.sum() < 6.0:
        return None
    J = precision * solution.jacobian[used]
    H = (J.T * w) @ J - information_loss
    J = precision * jacobian[used]
    # A point that may be on the bone or not adds no information. Its negative psi' would subtract
    # some, and as H enters twice, the stated error would be too large (`benchmarks calibration`).
    H = H - (J.T * (w - np.clip(solution.curvature[used], 0.0, None))) @ J
    if not _has_full_rank(H):
        return None
    scale = np.sqrt(np.diag(H))
    H_inverse = np.linalg.inv(H / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(variance * H_inverse @ ((J.T * w**2) @ J + score_covariance) @ H_inverse)


def _excess(total: Array, noise: Array) -> Array:
    """
    Return the part of a covariance ``total`` (6, 6) above ``noise``, without negative variances.

    Doubtful points may constrain a motion better once an error of the model is allowed for.
    """
    scale = np.sqrt(np.diag(noise))
    values, vectors = np.linalg.eigh((total - noise) / np.outer(scale, scale))
    vectors = scale[:, None] * vectors
    return np.asarray((vectors * np.clip(values, 0.0, None)) @ vectors.T)


def _has_full_rank(H: Array) -> bool:
    """Return whether an information matrix (6, 6) constrains all motions, in any unit."""
    if not np.all(np.diag(H) > 0.0):
        return False
    scale = np.sqrt(np.diag(H))
    eigenvalues = np.linalg.eigvalsh(H / np.outer(scale, scale))
    return bool(eigenvalues[0] >= 1e-10 * eigenvalues[-1])


def _residual_correlation(w: Array, residuals: Array, neighbours: NDArray[np.int64]) -> float:
    """Return the mean of (sum w) m^2 / s^2, m the mean residual of neighbours; 1 for noise."""
    w, e = w[:len(neighbours)], np.nan_to_num(residuals[:len(neighbours)])
    around = w[neighbours]
    count = np.maximum(around.sum(axis=1), 1e-9)
    mean = (around * e[neighbours]).sum(axis=1) / count
    return float((w * count * mean**2).sum() / max((w * e**2).sum(), 1e-300))
