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
from gsdf_registration.registration.confidence import motion_at, predicted_tre


class TargetErrors(NamedTuple):
    """
    Errors of a pose at the targets; metres.

    mean, rms : distances of the touched targets from their places on the model
    difference : RMS distance of the pose from the one that fits the targets best, at the targets
    of_targets, stated : RMS errors that are expected of this difference, of the two poses
    chi_square : of the difference; 6 degrees of freedom
    """

    mean: float
    rms: float
    difference: float
    of_targets: float
    stated: float
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
    distance = rigid.transform(rigid.inverse(T), touched) - model
    best = rigid.fit_points(model, touched)
    centre = model.mean(axis=0)
    B = motion_at(model - centre)
    residual = rigid.transform(best, touched) - model
    noise = (residual**2).sum() / (residual.size - 6)
    C_targets = noise * np.linalg.inv(np.einsum('kij,kil->jl', B, B))
    # from a small motion of the bone frame about the centre to the pose, see `pose_covariance`
    R, G = T[:3, :3], np.zeros((6, 6))
    G[:3, :3], G[:3, 3:], G[3:, :3] = -R @ rigid.skew(centre), -R, -R
    C_pose = np.linalg.solve(G, np.linalg.solve(G, covariance).T)
    motion = rigid.inverse(T) @ rigid.inverse(best)
    e = np.concatenate([rigid.rotation_log(motion[:3, :3]),
                        rigid.transform(motion, centre) - centre])
    return TargetErrors(
        float(np.linalg.norm(distance, axis=1).mean()), rigid.rms(np.linalg.norm(distance, axis=1)),
        rigid.rms(np.linalg.norm(B @ e, axis=1)),
        float(np.sqrt(np.einsum('kij,jl,kil->k', B, C_targets, B).mean())),
        rigid.rms(predicted_tre(T, covariance, model)),
        float(e @ np.linalg.solve(C_pose + C_targets, e)))
