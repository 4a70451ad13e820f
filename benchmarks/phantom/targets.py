# SPDX-License-Identifier: Apache-2.0
"""
Compare a pose with the targets, and its stated error with the difference to their own fit.

The touch of a target has an error, too, so the pose that fits the targets best is not the true one:
the difference has the covariance of both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.confidence import Confidence, motion_at, predicted_tre


class TargetErrors(NamedTuple):
    """
    Errors of a pose at the targets; metres.

    mean, rms : distances of the touched targets from their places on the model
    difference : RMS distance of the pose from the one that fits the targets best, at the targets
    stated, of_targets : RMS errors that are expected of this difference, of the two poses
    chi_square : of the difference; 6 degrees of freedom
    """

    mean: float
    rms: float
    difference: float
    stated: float
    of_targets: float
    chi_square: float


def target_errors(result: RegistrationResult, targets: Array) -> TargetErrors:
    """
    Return the errors of an accepted pose.

    Parameters
    ----------
    result : RegistrationResult
    targets : (2, m, 3) float, metres
        On the model, and as touched, tracker frame; four or more.

    """
    T, covariance = result.T_tracker_bone, result.covariance
    assert T is not None and covariance is not None
    model, touched = targets
    distance = np.linalg.norm(rigid.transform(rigid.inverse(T), touched) - model, axis=1)
    best = rigid.fit_points(touched, model)
    residual = rigid.transform(best, model) - touched
    noise = (residual**2).sum() / (residual.size - 6)
    centre = model.mean(axis=0)
    B = motion_at(model - centre)
    fit = Confidence(noise * np.linalg.inv(np.einsum('kij,kil->jl', B, B)), centre,
                     float(np.sqrt(noise)), 1.0)
    e = np.concatenate([T[:3, 3] - best[:3, 3],
                        rigid.rotation_log(T[:3, :3] @ best[:3, :3].T)])    # as the covariance
    return TargetErrors(
        float(distance.mean()), rigid.rms(distance), rigid.rms_displacement(T, best, model),
        rigid.rms(predicted_tre(T, covariance, model)), rigid.rms(fit.predicted_tre(model)),
        float(e @ np.linalg.solve(covariance + fit.pose_covariance(T), e)))
