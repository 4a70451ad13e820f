# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks trust``: rows, counts and tables of trials."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.protocol.cases import Case
from benchmarks.protocol.trials import SCENARIOS, Problem, Trial, make
from benchmarks.trust.tables import (
    COLUMNS,
    faults,
    faulty_refusals,
    not_found,
    table,
)
from benchmarks.trust.trial import trial_row
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, RegistrationResult


def problem(bone: Path, scenario: str) -> Problem:
    case = Case(str(bone), 'condyles')
    return make(Trial(case, SCENARIOS[scenario], 0, case.bone))


def answer(T: np.ndarray, stated: float = 5e-4) -> RegistrationResult:
    covariance = np.diag([stated**2] * 3 + [1e-16] * 3)
    return RegistrationResult(Reason.CONVERGED, 'yes', T, covariance)


def test_rows_of_right_wrong_and_refused_poses(femur_bone: Path) -> None:
    asked = problem(femur_bone, 'clean')
    T = asked.recording.T_tracker_bone
    lenient = Config().replaced({'limits.max_error': 0.02})
    right = trial_row(asked, answer(T), lenient)
    assert right['verdict'] == 'right' and right['well_posed'] and right['tre_rms_m'] < 1e-9
    off = T @ rigid.from_rt(np.eye(3), [0.0, 0.0, 0.0026])
    understated = trial_row(asked, answer(off, 3e-4), Config())
    assert understated['verdict'] == 'understated'
    assert understated['tre_rms_m'] == pytest.approx(0.0026)
    assert trial_row(asked, answer(off, 6e-4), Config())['verdict'] == 'right'
    refused = trial_row(asked, RegistrationResult.refused(Reason.AMBIGUOUS, 'no'), Config())
    assert refused['verdict'] == 'refused' and refused['tre_rms_m'] is None
    assert list(refused) == list(right)
    # the refused pose counts as found, and so does a pose with a small error
    assert right['found'] and understated['found'] and refused['found']
    displaced = T @ rigid.from_rt(np.eye(3), [0.0, 0.0, 0.006])
    assert not trial_row(asked, answer(displaced), Config())['found']
    mirrored = trial_row(problem(femur_bone, 'mirrored'), answer(T), Config())
    assert mirrored['verdict'] == 'wrong' and not mirrored['well_posed']
    assert list(mirrored) == list(right)


def rows() -> list[dict[str, Any]]:
    one = {'scenario': 'clean', 'verdict': 'right', 'reason': 'converged', 'well_posed': True,
           'found': True, 'nees': 6.0, 'tre_rms_m': 3e-4,
           'predicted_rms_m': 5e-4, 'search_s': 0.5, 'solve_s': 0.1}
    return [{**one, 'scenario': 'mirrored', 'verdict': 'wrong', 'well_posed': False,
             'found': None, 'nees': None, 'tre_rms_m': None},
            one, {**one, 'nees': 24.0, 'tre_rms_m': 4e-4},
            {**one, 'verdict': 'refused', 'reason': 'ambiguous', 'search_s': None},
            {**one, 'verdict': 'refused', 'reason': 'ambiguous', 'well_posed': False,
             'found': False}]


def test_table_counts() -> None:
    clean, mirrored, all_ = (dict(zip(COLUMNS, cells)) for cells in table(rows()))
    assert (clean['scenario'], mirrored['scenario'], all_['scenario']) == ('clean', 'mirrored',
                                                                          'all')
    assert [clean[key] for key in ('trials', 'right', 'refused', 'wrong')] == ['4', '2', '2', '0']
    assert clean['found'] == '75.0%' and mirrored['found'] == '-'
    assert clean['efficiency'] == '1.58' and clean['median'] == '1.50'
    assert clean['TRE'] == '0.35' and clean['search'] == '500'
    assert clean['refused for'] == '2 ambiguous'
    assert mirrored['wrong'] == '1' and mirrored['TRE'] == '-'
    assert all_['trials'] == '5' and all_['wrong'] == '1'


def test_lists_failures() -> None:
    assert [row['scenario'] for row in faults(rows(), 'wrong')] == ['mirrored']
    refused, well = faulty_refusals(rows())
    assert len(refused) == 1 and well == 3
    missed, count = not_found(rows())
    assert len(missed) == 1 and count == 4


def trust(*options: str) -> int:
    try:
        return main(['trust', *options])
    except SystemExit as end:
        return int(end.code or 0)


@pytest.fixture
def shipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('GSDF_BONES_DIR', raising=False)


@pytest.mark.usefixtures('shipped')
def test_prints_and_continues_a_run(tmp_path: Path,
                                    capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / 'trust.tsv'
    options = ['--scenarios', 'clean,noise*', '-o', str(output)]
    assert trust('--trials', '2', *options) == 0
    first = capsys.readouterr()
    assert first.err == '' and 'of 2 accepted and wrong' in first.out
    begun = output.read_text()
    assert trust('--trials', '4', *options) == 0
    shown = capsys.readouterr().out
    assert 'of 4 accepted and wrong' in shown and 'noise_only' in shown
    assert output.read_text().startswith(begun) and len(output.read_text().splitlines()) == 6
    settings = tmp_path / 'settings.yaml'
    settings.write_text('search: {parts: 1}')
    assert trust('--trials', '4', *options, '--config', str(settings)) == 2
    assert 'results with other config' in capsys.readouterr().err


@pytest.mark.usefixtures('shipped')
def test_prints_one_trial(capsys: pytest.CaptureFixture[str]) -> None:
    assert trust('--only', 'femur/condyles/clean/5') == 0
    printed = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert printed['trial'] == 'femur/condyles/clean/5' and printed['verdict'] == 'right'
    assert float(printed['tre_rms_m']) < 2e-3


@pytest.mark.usefixtures('shipped')
@pytest.mark.parametrize('options, sentence', [
    (['--scenarios', 'gremlins'], '"gremlins" is unknown'),
    (['--scenarios', 'other_person'], 'none of these scenarios is possible'),
    (['--trials', '0'], 'argument --trials: must be 1 or more'),
    (['--regions', 'skull'], '"skull" is unknown'),
    (['--only', 'femur/condyles/clean'], 'give BONE/REGION/SCENARIO/SEED'),
    (['--only', 'femur/skull/clean/1'], 'give BONE/REGION/SCENARIO/SEED'),
    (['--only', 'femur/condyles/cup_only/1'], 'not possible with this bone'),
    (['--only', 'femur/condyles/*/1'], 'give BONE/REGION/SCENARIO/SEED'),
    (['--only', 'femur/condyles/clean/-1'], 'give BONE/REGION/SCENARIO/SEED'),
    (['--bones', 'nowhere'], 'nowhere')])
def test_reports_errors_in_one_line(capsys: pytest.CaptureFixture[str], options: list[str],
                                    sentence: str) -> None:
    assert trust(*options) == 2
    error = capsys.readouterr().err
    assert sentence in error and len(error.splitlines()) == 1
