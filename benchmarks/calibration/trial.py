# SPDX-License-Identifier: Apache-2.0
"""
One trial: the error of a pose and the one that is stated for it.

The solver starts near the true pose, because only the stated error is tested, and not the search.
"""

from __future__ import annotations

import numpy as np

from benchmarks.execution.result_table import Row
from benchmarks.protocol.scoring import (
    attainable,
    cramer_rao,
    evidence,
    share_of_limits,
    well_posed,
)
from benchmarks.protocol.trials import Problem, Trial, make
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.confidence import Confidence, assess_at
from gsdf_registration.registration.local_solutions import solve_all
from gsdf_registration.registration.point_selection import select_points
from gsdf_registration.registration.pose_selection import select_pose

START_OFF = (np.radians(1.5), 0.001)    # rad, m, of the initial pose, about the touched area
PLACES = 400            # of the surface at which errors are compared
LOST = 0.005            # m, RMS over the exposed area: the pose is in another minimum


def run_trial(trial: Trial, config: Config) -> Row:
    """Return the row of a trial; SI units."""
    problem, config = make(trial), config.replaced(trial.scenario.settings)
    selection = select_points(problem.recording.positions, config.collect.mode)
    points, field = selection.positions, problem.field
    solutions = solve_all(points, field, [start_pose(problem)], config, touches=selection.touches)
    solution = select_pose(solutions, points, field, config).solution
    confidence = assess_at(solution, points, field, config.probe.tip_error)
    motion = solution.T_bone_tracker @ problem.recording.T_tracker_bone
    return {'case': trial.case.name, 'scenario': trial.scenario.name, 'seed': trial.seed,
            **compared(confidence, motion, problem),
            'model_sd_m': None if confidence is None else confidence.model_sd,
            **dict(zip(('evidence', 'evidence_exact'), evidence(problem) or (None, None))),
            'well_posed': well_posed(problem, attainable(problem), config),
            'share_of_limits': (None if confidence is None
                                else share_of_limits(problem, confidence, config))}


def start_pose(problem: Problem) -> Array:
    """Return a pose near the true one, T_bone_tracker."""
    rng = np.random.default_rng([problem.trial.seed, 1])
    turn, shift = rng.normal(size=(2, 3))
    true = rigid.inverse(problem.recording.T_tracker_bone)
    R = rigid.rotation_exp(START_OFF[0] * turn / np.linalg.norm(turn))
    centre = problem.patch.centre
    t = centre + START_OFF[1] * shift / np.linalg.norm(shift) - R @ centre
    return np.asarray(rigid.from_rt(R, t) @ true)


def compared(confidence: Confidence | None, motion: Array, problem: Problem) -> Row:
    """
    Return the comparison of the true with the stated error of a pose.

    Parameters
    ----------
    confidence : in the pose; None: the points do not constrain it
    motion : (4, 4) float, m, of the bone frame from the true to the found pose
    problem : Problem

    Returns
    -------
    Row
        chi_square : of the pose with the stated covariance; 6 degrees of freedom
        nees : of the pose with the Cramer-Rao bound
        near_m, far_m : true error, RMS over the exposed area and over the bone
        near_stated_m, far_stated_m : stated
        near_bound_m, far_bound_m : of the bound
        near_within, far_within : share of the places whose error is within its stated 95 % bound

    """
    places = {'near': problem.patch.corners.mean(axis=1),
              'far': (problem.bone or problem.field).surface_points.astype(np.float64)}
    bound, row = cramer_rao(problem), Row()
    row |= dict.fromkeys(('chi_square', 'nees'))
    if confidence is not None:
        row['chi_square'] = _chi_square(motion, confidence)
        row['nees'] = _chi_square(motion, bound)
    for name, all_of_them in places.items():
        some = all_of_them[::-(-len(all_of_them) // PLACES)]
        true = rigid.displacement(motion, np.eye(4), some)
        row[f'{name}_m'] = rigid.rms(true)
        row[f'{name}_bound_m'] = rigid.rms(bound.predicted_tre(some))
        row[f'{name}_stated_m'] = row[f'{name}_within'] = None
        if confidence is not None:
            row[f'{name}_stated_m'] = rigid.rms(confidence.predicted_tre(some))
            row[f'{name}_within'] = float((true < confidence.p95(some)).mean())
    return row


def _chi_square(motion: Array, confidence: Confidence) -> float:
    """Return e^T C^-1 e of the error e of a pose."""
    m = confidence.centroid
    e = np.concatenate([rigid.rotation_log(motion[:3, :3]), rigid.transform(motion, m) - m])
    return float(e @ np.linalg.solve(confidence.total_covariance, e))
