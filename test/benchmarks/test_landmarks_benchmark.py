# SPDX-License-Identifier: Apache-2.0
"""The benchmark of joint centres: its trials and its table."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.commands.landmarks import COLUMNS, SCENARIOS, WIDTHS, femurs, select, summary
from benchmarks.options import table_row
from gsdf_registration.common.result import InputError


def test_every_scenario_has_the_same_trials_of_all_bones() -> None:
    cases = femurs([Path('a_femur_R.ply'), Path('hip.ply'), Path('b_femur_L.ply')])
    trials = select(cases, 3, seed=5)
    assert len(trials) == 3 * len(SCENARIOS) == len({trial.name for trial in trials})
    assert [(trial.case.bone, trial.seed) for trial in trials[:3]] == [
        ('a_femur_R.ply', 5), ('b_femur_L.ply', 6), ('a_femur_R.ply', 7)]


def test_a_folder_without_a_femur_is_refused() -> None:
    with pytest.raises(InputError, match='none of the bones is a femur'):
        femurs([Path('hip.ply')])


def test_the_table_compares_with_and_without_the_hip_centre() -> None:
    rows = [{'alone_tre_m': alone, 'fused_tre_m': fused, 'alone_predicted_m': 0.003,
             'fused_predicted_m': 0.001, 'alone_nees': 6.0, 'fused_nees': 3.0,
             'landmark_used': fused < alone}
            for alone, fused in ((0.003, 0.001), (0.004, 0.004))]
    cells = summary('model exact', rows)
    assert len(cells) == len(COLUMNS) == len(table_row(cells, WIDTHS).split()) - 1
    # trials, RMS without and with, ratio, medians, worst, predicted, NEES, left out
    assert cells[1:] == ('2', '3.54', '2.92', '0.82', '3.50', '2.50', '4.00', '4.00', '3.00',
                         '1.00', '1.00', '0.50', '1')
