# SPDX-License-Identifier: Apache-2.0
"""
How well a fixed point is known, from the residuals of its poses.

Independent noise is allowed to have any covariance in the body frame, where noise of the
orientation acts across the lever arm.  Slow motion of the point shows as correlation of successive
residuals; it is taken as equal in all directions.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from gsdf_registration.common.rigid import Array

PARAMETERS = 6


def covariance_of(R: Array, residuals: Array, turn_noise: float = 0.0) -> Array:
    """
    Return the covariance (6, 6), m^2, of the point (body frame) and its place (tracker frame).

    It is the sandwich ``H^-1 (sum_ij A_i' C(i - j) A_j) H^-1`` with ``A_i = [R_i, -I]``.  In
    simulations the 95 % region of the point contains it in 94 to 97 % of recordings.  That of both
    contains them in 91 % if the point wanders: the residuals do not show its mean displacement.

    Parameters
    ----------
    R : (n, 3, 3) float
        Rotations in the order of time.
    residuals : (n, 3) float, m, tracker frame
    turn_noise : float, rad^2 per axis
        Variance of the orientations, for which the solution was corrected.

    """
    n = len(R)
    A = np.concatenate([R, np.broadcast_to(-np.eye(3), (n, 3, 3))], axis=2)
    H = np.einsum('nij,nik->jk', A, A)
    H[:3, 3:] /= 1.0 - turn_noise
    H[3:, :3] /= 1.0 - turn_noise
    inverse = np.linalg.pinv(H, rcond=1e-12, hermitian=True)
    in_body = np.einsum('nij,ni->nj', R, residuals)
    S = in_body.T @ in_body / (n - PARAMETERS / 3.0)
    A_in_body = np.swapaxes(R, 1, 2) @ A
    independent = np.einsum('nji,jk,nkl->il', A_in_body, S, A_in_body, optimize=True)
    meat = independent + _correlated(A, autocovariance(residuals))
    covariance = inverse @ meat @ inverse
    return np.asarray(0.5 * (covariance + covariance.T))


def autocovariance(residuals: Array) -> Array:
    """
    Return the autocovariance (n,), m^2 per axis, up to where it first falls to zero.

    It is corrected for the degrees of freedom of the fit: correlated residuals count as the number
    of independent ones with the same information.
    """
    n = len(residuals)
    spectrum = np.abs(np.fft.rfft(residuals, 2 * n, axis=0)) ** 2
    covariance = np.fft.irfft(spectrum.sum(axis=1), 2 * n)[:n] / (3 * n)
    negative = np.flatnonzero(covariance <= 0.0)
    covariance[negative[0] if len(negative) else n:] = 0.0
    if not covariance[0] > 0.0:
        return covariance
    independent = 3.0 * n * covariance[0] / (covariance[0] + 2.0 * covariance[1:].sum())
    freedom = max(independent - PARAMETERS, 3.0)
    # the second factor is the variance of Student's t
    return np.asarray(covariance * (independent / freedom) * (freedom / (freedom - 2.0)))


def error_within(covariance: Array, probability: float = 0.95) -> float:
    """
    Return the length, m, that an error with this covariance (3, 3) exceeds rarely.

    The squared length is taken as a scaled chi-squared variable of the same mean and variance
    (Satterthwaite 1946).
    """
    trace, square = float(np.trace(covariance)), float((covariance**2).sum())
    if not square > 0.0:
        return 0.0
    # the quantile of chi-squared with trace^2 / square degrees of freedom
    quantile = 2.0 * float(gammaincinv(0.5 * trace**2 / square, probability))
    return float(np.sqrt(square / trace * quantile))


def _correlated(A: Array, autocovariance: Array) -> Array:
    """Return ``sum over i != j of A_i' c(i - j) A_j`` (6, 6), by Fourier transform."""
    n = len(A)
    lags = np.zeros(2 * n)
    lags[1:n] = autocovariance[1:]
    lags[n + 1:] = autocovariance[:0:-1]
    weights = np.fft.rfft(lags).real
    F = np.fft.rfft(A.reshape(n, 18), 2 * n, axis=0).reshape(-1, 3, 6)
    twice = np.full(len(F), 2.0)
    twice[[0, -1]] = 1.0
    summed = np.einsum('f,fki,fkj->ij', twice * weights, F.conj(), F, optimize=True)
    return np.asarray(summed.real / (2 * n))
