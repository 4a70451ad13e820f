# SPDX-License-Identifier: Apache-2.0
"""One trial of the whole pipeline without an initial guess, and its errors."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np

from benchmarks.execution.result_table import Row
from benchmarks.protocol.scoring import (
    PoseErrors,
    attainable,
    cramer_rao,
    pose_errors,
    share_of_limits,
    verdict,
    well_posed,
)
from benchmarks.protocol.starts import given_landmarks
from benchmarks.protocol.trials import Problem, Trial, make
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import rms
from gsdf_registration.registration.confidence import Confidence
from gsdf_registration.registration.pipeline import register

NEAR_TRUTH = 0.005  # m, maximum mean error over the exposed area of a pose that was found
# settings that accept every pose
LENIENT = {'limits.max_error': 1.0, 'limits.min_gap': 0.0, 'limits.min_inliers': 0.0,
           'limits.max_pattern': 1000.0, 'limits.max_model_error': 1000.0,
           'limits.min_extent': 0.0}


def run_trial(trial: Trial, config: Config) -> Row:
    """Return the row of a trial: the problem, the answer and its errors; SI units."""
    problem = make(trial)
    config = config.replaced(trial.scenario.settings)
    result = register(problem.recording.positions, problem.field, config,
                      landmarks=given_landmarks(problem))
    return trial_row(problem, result, config)


def trial_row(problem: Problem, result: RegistrationResult, config: Config) -> Row:
    """Return the row of a problem and its answer."""
    trial = problem.trial
    bound = None if trial.scenario.wrong else cramer_rao(problem)
    limit = None if bound is None else attainable(problem)
    errors: dict[str, float | None] = dict.fromkeys(PoseErrors.__dataclass_fields__)
    if bound is not None and result.T_tracker_bone is not None:
        errors |= asdict(pose_errors(result.T_tracker_bone, problem, bound))
    return {
        'case': trial.case.name, 'scenario': trial.scenario.name, 'seed': trial.seed,
        'model': trial.model, 'verdict': verdict(problem, result, config),
        'reason': str(result.reason),
        'found': None if bound is None else is_found(problem, bound, result, config),
        'well_posed': well_posed(problem, limit, config), **errors,
        'bound_rms_m': None if bound is None else rms(
            bound.predicted_tre(problem.field.surface_points.astype(np.float64))),
        'share_of_limits': None if limit is None else share_of_limits(problem, limit, config),
        'predicted_rms_m': result.predicted_tre_m.get('rms'), 'grade': result.grade,
        'runner_up_ratio': result.runner_up_ratio,
        'received': result.received, 'used': result.used, 'inliers': result.inliers,
        'sigma_m': result.sigma_m, 'search_s': result.timing_s.get('search'),
        'solve_s': result.timing_s.get('solve'), 'message': result.message
    }


def is_found(problem: Problem, bound: Confidence, result: RegistrationResult,
             config: Config) -> bool:
    """
    Return whether the pose is near the truth; if it was refused, the pose that was refused.

    Parameters
    ----------
    problem : its model is the bone that was touched
    bound : its `cramer_rao`
    result : of its points with these settings

    """
    if result.T_tracker_bone is None:
        result = register(problem.recording.positions, problem.field, config.replaced(LENIENT),
                          landmarks=given_landmarks(problem))
    return (result.T_tracker_bone is not None
            and pose_errors(result.T_tracker_bone, problem, bound).tre_region_m < NEAR_TRUTH)
