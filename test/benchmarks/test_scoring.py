# SPDX-License-Identifier: Apache-2.0
"""Errors of known poses, the Cramer-Rao bound, the verdict, and the criterion for well-posed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.protocol.cases import Case
from benchmarks.protocol.scoring import (
    attainable,
    cramer_rao,
    evidence,
    pose_errors,
    share_of_limits,
    verdict,
    well_posed,
)
from benchmarks.protocol.trials import SCENARIOS, Problem, Trial, make
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.solver import solve

GENEROUS = Config().replaced({'limits.max_error': 0.02})


def problem(bone: Path, scenario: str, seed: int = 0, region: str = 'condyles') -> Problem:
    case = Case(str(bone), region)
    return make(Trial(case, SCENARIOS[scenario], seed, case.bone))


@pytest.fixture(scope='module')
def clean(femur_bone: Path) -> Problem:
    return problem(femur_bone, 'clean')


def test_true_pose_has_no_error(clean: Problem) -> None:
    errors = pose_errors(clean.recording.T_tracker_bone, clean, cramer_rao(clean))
    assert errors.tre_max_m < 1e-12 and errors.rotation_mae_deg < 1e-9 and errors.nees < 1e-9
    # the rest is noise along the normal: mean of |N(0, 0.5 mm)|
    assert errors.chamfer_m == pytest.approx(5e-4 * np.sqrt(2.0 / np.pi), rel=0.1)


def test_errors_of_a_shift(clean: Problem) -> None:
    T = clean.recording.T_tracker_bone @ rigid.from_rt(np.eye(3), [0.003, 0.0, 0.0])
    errors = pose_errors(T, clean, cramer_rao(clean))
    assert errors.rotation_mae_deg < 1e-9
    for length in (errors.tre_mean_m, errors.tre_rms_m, errors.tre_p95_m, errors.tre_max_m,
                   errors.tre_region_m):
        assert length == pytest.approx(0.003)
    assert errors.t_centroid_mae_m == pytest.approx(0.001)
    assert errors.t_origin_mae_m == pytest.approx(0.001)


def test_errors_of_a_rotation_about_the_centroid(clean: Problem) -> None:
    c, angle = clean.touched.mean(axis=0), np.radians(0.3)
    R = rigid.rotation_exp([0.0, angle, 0.0])
    turn = rigid.from_rt(R, c - R @ c)
    errors = pose_errors(clean.recording.T_tracker_bone @ turn, clean, cramer_rao(clean))
    assert errors.rotation_mae_deg == pytest.approx(0.1, rel=1e-3)
    assert errors.t_centroid_mae_m < 1e-9
    far = np.linalg.norm((clean.field.surface_points - c)[:, [0, 2]], axis=1)
    assert errors.tre_max_m == pytest.approx(angle * far.max(), rel=1e-3)
    assert errors.tre_rms_m == pytest.approx(angle * np.sqrt(np.mean(far**2)), rel=1e-3)
    assert errors.tre_region_m < 0.3 * errors.tre_rms_m


@pytest.mark.parametrize('scenario', ['clean', 'anisotropic', 'sigma_1.2'])
def test_weighted_least_squares_reaches_the_bound(femur_bone: Path, scenario: str) -> None:
    """Monte Carlo: new noise, and the linear problem solved with the true weights."""
    made = problem(femur_bone, scenario)
    bound, rng = cramer_rao(made), np.random.default_rng(1)
    x = made.touched
    _, n = made.field.sample(x)
    J = np.hstack([np.cross(x - bound.centroid, n), n])
    R = made.recording.T_tracker_bone[:3, :3].T
    noise = (rng.normal(size=(4000, len(x), 3)) * made.trial.scenario.sigma) @ R.T
    e = (noise * n).sum(axis=2)
    weight = 1.0 / e.var(axis=0)
    found = e @ (np.linalg.inv((J.T * weight) @ J) @ (J.T * weight)).T
    L = np.linalg.cholesky(bound.motion_covariance)
    np.testing.assert_allclose(np.cov(np.linalg.solve(L, found.T)), np.eye(6), atol=0.12)


def test_solver_is_near_the_bound(femur_bone: Path) -> None:
    nees = []
    for seed in range(25):
        made = problem(femur_bone, 'clean', seed)
        start = rigid.inverse(made.recording.T_tracker_bone)
        found = solve(made.recording.positions, made.field, start, Config().solver).T_bone_tracker
        nees.append(pose_errors(rigid.inverse(found), made, cramer_rao(made)).nees)
    assert 0.85 < np.sqrt(np.mean(nees) / 6.0) < 1.25


def test_bound_is_independent_of_the_frame(clean: Problem) -> None:
    here = cramer_rao(clean)
    assert here.predicted_tre(clean.touched).mean() < 3e-4
    far = cramer_rao(problem(Path(clean.trial.case.bone), 'uniform_90'))
    assert 0.5 < far.predicted_tre(far.centroid[None])[0] / here.predicted_tre(
        here.centroid[None])[0] < 2.0


def answer(made: Problem, shift: float, sd: float = 1e-4) -> RegistrationResult:
    """Return an accepted pose that is off by ``shift``, m, and states an error of ``sd``, m."""
    T = made.recording.T_tracker_bone @ rigid.from_rt(np.eye(3), [0.0, 0.0, shift])
    covariance = np.diag([sd**2] * 3 + [1e-16] * 3)
    return RegistrationResult(Reason.CONVERGED, '', T, covariance)


def test_the_verdict_on_an_accepted_pose(clean: Problem) -> None:
    stated = 2.795e-4       # 95 % of the length of a vector of 0.1 mm along each axis
    allowed = 2.0 * stated + 5e-4
    for shift, expected in [(0.0, 'right'), (0.99 * allowed, 'right'),
                            (1.01 * allowed, 'understated'), (0.0049, 'understated'),
                            (0.0051, 'wrong')]:
        assert verdict(clean, answer(clean, shift), Config()) == expected
    assert verdict(clean, answer(clean, 0.0049, 2e-3), Config()) == 'right'
    assert verdict(clean, RegistrationResult.refused(Reason.AMBIGUOUS, ''), Config()) == 'refused'


def test_an_error_is_understated_only_where_accuracy_is_required(clean: Problem) -> None:
    c = clean.touched.mean(axis=0)
    R = rigid.rotation_exp([0.0, 0.008, 0.0])
    turned = answer(clean, 0.0, 4e-4)
    T = clean.recording.T_tracker_bone @ rigid.from_rt(R, c - R @ c)
    turned = replace(turned, T_tracker_bone=T)
    assert verdict(clean, turned, Config()) == 'right'
    assert verdict(clean, turned, Config.from_flat({'limits.require': 'bone'})) == 'understated'


def test_every_pose_of_a_wrong_bone_is_wrong(femur_bone: Path) -> None:
    mirrored = problem(femur_bone, 'mirrored')
    assert verdict(mirrored, answer(mirrored, 0.0, 1.0), Config()) == 'wrong'
    shaft = problem(femur_bone, 'shaft_only', region='proximal_femur')
    assert verdict(shaft, answer(shaft, 0.0), Config()) == 'right'


def test_the_deviation_of_a_model_is_in_the_attainable_error(clean: Problem,
                                                            femur_bone: Path) -> None:
    np.testing.assert_allclose(attainable(clean).motion_covariance,
                               cramer_rao(clean).motion_covariance, rtol=1e-6)
    inexact = problem(femur_bone, 'smooth_0.5_15')
    surface = inexact.field.surface_points.astype(np.float64)
    assert (attainable(inexact).p95(surface) > 1.5 * cramer_rao(inexact).p95(surface)).all()


def test_evidence_of_a_deviation(clean: Problem, femur_bone: Path) -> None:
    assert evidence(clean) is None
    deviating, exact = evidence(problem(femur_bone, 'smooth_0.5_8_optical'))
    assert deviating > 50.0 and exact < -10.0
    # of points on an exact model both are the same, and a motion of the bone is no evidence
    bare = clean.recording
    exact_model = replace(problem(femur_bone, 'smooth_0.5_8'), recording=bare)
    seen = evidence(exact_model)
    assert seen[0] < -10.0 and seen[0] == pytest.approx(seen[1], abs=1.0)
    moved = replace(bare, T_tracker_bone=bare.T_tracker_bone @ rigid.from_rt(
        rigid.rotation_exp([0.0, 0.001, 0.0]), [1e-4, 2e-4, 0.0]))
    assert evidence(replace(exact_model, recording=moved))[0] == pytest.approx(seen[0], abs=1.0)


def test_well_posed(clean: Problem, femur_bone: Path) -> None:
    bound = cramer_rao(clean)
    assert well_posed(clean, bound, GENEROUS)
    everywhere = float(bound.p95(clean.field.surface_points).max())
    required = {'limits.require': 'bone'}
    strict = GENEROUS.replaced({'limits.max_error': 1.4 * everywhere, **required})
    assert not well_posed(clean, bound, strict)
    assert share_of_limits(clean, bound, strict) == pytest.approx(1.0 / 1.4)
    assert well_posed(clean, bound, GENEROUS.replaced({'limits.max_error': 1.6 * everywhere,
                                                       **required}))
    shaft = problem(femur_bone, 'shaft_only', region='proximal_femur')
    assert not well_posed(shaft, cramer_rao(shaft), GENEROUS)
    assert not well_posed(problem(femur_bone, 'mirrored'), None, GENEROUS)
