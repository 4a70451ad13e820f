# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks calibration``: true errors compared with stated ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.calibration.tables import COLUMNS, COST_COLUMNS, cost_table, table
from benchmarks.calibration.trial import compared
from benchmarks.protocol.cases import Case
from benchmarks.protocol.real_models import OFFSETS, REAL_MODELS
from benchmarks.protocol.scoring import cramer_rao
from benchmarks.protocol.trials import SCENARIOS, Trial, make
from gsdf_registration.common import rigid


def trial(bone: Path, scenario: str) -> Trial:
    case = Case(str(bone), 'condyles')
    return Trial(case, SCENARIOS[scenario], 0, case.bone)


def test_errors_drawn_from_the_stated_covariance_are_true(femur_bone: Path) -> None:
    problem = make(trial(femur_bone, 'clean'))
    stated = cramer_rao(problem)
    factor, rng = np.linalg.cholesky(stated.motion_covariance), np.random.default_rng(0)
    rows = []
    for _ in range(200):
        error = factor @ rng.normal(size=6)
        R, m = rigid.rotation_exp(error[:3]), stated.centroid
        motion = rigid.from_rt(R, m + error[3:] - R @ m)
        rows.append({'case': 'a/condyles', 'scenario': 'clean', 'seed': 0,
                     **compared(stated, motion, problem)})
    assert np.mean([row['chi_square'] < 12.592 for row in rows]) == pytest.approx(0.95, abs=0.04)
    for place in ('near', 'far'):
        assert np.mean([row[f'{place}_within'] for row in rows]) == pytest.approx(0.95, abs=0.04)
        true = rigid.rms(np.array([row[f'{place}_m'] for row in rows]))
        assert true == pytest.approx(rows[0][f'{place}_stated_m'], rel=0.15)
    lines = dict(zip(COLUMNS, list(table(rows))[-1]))
    assert lines['trials'] == '200' and lines['lost'] == '0'
    assert float(lines['efficiency']) == pytest.approx(1.0, abs=0.06)


def test_lost_poses_are_counted_and_left_out(femur_bone: Path) -> None:
    problem = make(trial(femur_bone, 'clean'))
    far_off = rigid.from_rt(np.eye(3), [0.0, 0.0, 0.02])
    rows = [{'case': 'a/condyles', 'scenario': 'clean', 'seed': 0, **compared(*pair, problem)}
            for pair in ((cramer_rao(problem), far_off), (None, np.eye(4)))]
    assert list(table(rows))[0][:3] == ('clean', '2', '2')


def test_cost_of_another_stated_covariance() -> None:
    rows = [{'scenario': scenario, 'near_m': 0.001, 'model_sd_m': found, 'chi_square': squared,
             'share_of_limits': share, 'well_posed': True} for scenario, found, squared, share in (
                 ('clean', 0.0, 5.0, 0.4), ('clean', 0.0, 5.0, 0.6),
                 ('cartilage', 0.0, 50.0, 0.9), ('cartilage', 3e-4, 20.0, 0.9))]
    lines = {cells[:2]: cells[2:] for cells in cost_table(rows)}
    assert all(len(cells) == len(COST_COLUMNS) - 2 for cells in lines.values())
    assert lines['not found', 'x 1'] == ('100.00%', '0 of 2', '0.00%', '100.00%', '0 of 1')
    assert lines['not found', 'x 2'] == ('100.00%', '0 of 2', '0.00%', '0.00%', '1 of 1')
    assert lines['not found', 'x 4'] == ('100.00%', '1 of 2', '100.00%', '0.00%', '1 of 1')
    assert lines['found', 'x 2'] == ('-', '-', '100.00%', '0.00%', '1 of 1')
    assert lines['all', 'x 1'] == ('100.00%', '0 of 2', '0.00%', '50.00%', '0 of 2')


def test_deviations_that_the_best_test_misses(femur_bone: Path) -> None:
    problem = make(trial(femur_bone, 'clean'))
    row = {'case': 'a/condyles', 'scenario': 'smooth_0.3_30', 'seed': 0,
           **compared(cramer_rao(problem), np.eye(4), problem)}
    rows = [{**row, 'evidence': seen, 'evidence_exact': -1.0} for seen in (-2.0, 1.0, 2.0, 3.0)]
    missed = dict(zip(COLUMNS, list(table(rows))[0]))['not seen']
    assert missed == '25.0%'


@pytest.mark.parametrize('word', [word for word in REAL_MODELS if word not in (
    'ct', 'ct_thick_slices', 'mri', 'decimated')])
def test_the_touched_surface_deviates_from_the_model(femur_bone: Path, word: str) -> None:
    problem = make(trial(femur_bone, f'{word}_optical'))
    distance = problem.field.sample(problem.touched)[0]
    if word in OFFSETS:
        assert distance == pytest.approx(OFFSETS[word], abs=1e-4)
    assert 1e-4 < rigid.rms(distance) < 1e-3


def test_the_command_prints_the_table(femur_bone: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['calibration', '--bones', str(femur_bone.parent), '--trials', '2',
                 '--scenarios', 'sigma_0.15']) == 0
    text = capsys.readouterr().out
    assert 'sigma_0.15' in text and 'efficiency' in text and 'not found' in text
