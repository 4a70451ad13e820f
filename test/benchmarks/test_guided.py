# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks guided``: the strokes, the number of points needed, the tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.__main__ import main
from benchmarks.guided.runs import (
    STRATEGIES,
    Run,
    runs_of,
    simulate_run,
)
from benchmarks.guided.tables import needed, page, table
from benchmarks.protocol.cases import Case
from gsdf_registration.common.config import Config


def run(bone_file: Path, strategy: str) -> dict[str, Any]:
    return simulate_run(Run(Case(str(bone_file), 'condyles'), strategy, 1, 3, 30, 1e-3),
                        Config().replaced({'search.threads': 1}))


def test_guidance_reduces_the_error_faster(femur_bone: Path) -> None:
    random, guided = run(femur_bone, 'random'), run(femur_bone, 'guided_bone')
    assert list(random) == list(guided)
    assert random['points'] == guided['points'] == [120, 150, 180, 210]
    for key in ('predicted_near_m', 'true_near_m', 'predicted_bone_m', 'true_bone_m'):
        assert len(random[key]) == 4 and random[key][0] == guided[key][0]
    assert guided['predicted_bone_m'][-1] < 0.8 * random['predicted_bone_m'][-1]
    assert 0.0 < guided['true_near_m'][-1] < 0.002


def test_runs_alternate_between_cases(femur_bone: Path) -> None:
    cases = [Case(str(femur_bone), region) for region in ('condyles', 'proximal_femur')]
    runs = list(runs_of(cases, 3, 7, 5, 30, 1e-3))
    assert [run.name for run in runs[:4]] == [
        *(f'femur/condyles/{strategy}/7' for strategy in STRATEGIES),
        'femur/proximal_femur/random/7']
    assert len({run.name for run in runs}) == 3 * len(STRATEGIES) and runs[-1].seed == 8


def rows() -> list[dict[str, Any]]:
    def row(strategy: str, seed: int, predicted: list[float | None],
            true: list[float]) -> dict[str, Any]:
        return {'case': 'femur/condyles', 'strategy': strategy, 'seed': seed,
                'points': [100, 130, 160], 'ambiguous': [False, strategy == 'guided', False],
                **{f'predicted_{goal}_m': predicted for goal in ('near', 'bone')},
                **{f'true_{goal}_m': true for goal in ('near', 'bone')}}
    return [row('random', 0, [0.003, 0.002, 0.0009], [0.004, 0.002, 0.0005]),
            row('guided', 0, [0.003, 0.0008, 0.0007], [0.004, 0.0005, 0.0005]),
            row('random', 1, [None, 0.002, 0.0015], [0.004, 0.002, 0.0005]),
            row('guided', 1, [None, 0.002, 0.0008], [0.004, 0.0005, 0.0005]),
            row('guided', 2, [0.0001] * 3, [0.1] * 3)]     # without a random run to compare with


def test_counts_the_points_needed() -> None:
    found = needed(rows(), 'near', 0.001)
    assert found.runs == 2
    assert found.predicted == (160.0, 145.0) and found.paired == (1, 1, 0)
    assert found.unambiguous == (160.0, 160.0) and found.never == (1, 0)
    assert found.error == pytest.approx((0.0005, 0.0005))
    # logarithmic: 1 mm is halfway from 2 mm to 0.5 mm, and at two thirds from 4 mm to 0.5 mm
    assert found.true == pytest.approx((145.0, 120.0))
    assert needed(rows(), 'near', 1e-5).true == (None, None)
    one, everything = table(rows(), 'near', 0.001)
    assert one[0] == 'femur/condyles' and everything[0] == 'all' and one[1:] == everything[1:]
    assert one[1:6] == ('2', '160', '145', '9 %', '1/1/0') and one[-1] == '17 %'


def test_draws_the_plots() -> None:
    both = [*rows(), *({**row, 'strategy': 'guided_bone'} for row in rows()
                       if row['strategy'] == 'guided')]
    drawn = page(both, 0.001)
    assert drawn.count('guided, true (RMS over runs)') == 2
    assert 'over the whole bone' in drawn and '<!DOCTYPE html>' in drawn


def test_prints_and_continues_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                   capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv('GSDF_BONES_DIR', raising=False)
    output, plot = tmp_path / 'guided.tsv', tmp_path / 'guided.html'
    options = ['guided', '--strokes', '2', '-o', str(output)]
    assert main([*options, '--runs', '1']) == 0
    shown = capsys.readouterr()
    assert shown.err == '' and 'femur/proximal_femur' in shown.out and '\nall  ' in shown.out
    kept = output.read_text()
    assert len(kept.splitlines()) == 2 + len(STRATEGIES)
    assert main([*options, '--runs', '1', '--plot', str(plot)]) == 0
    assert output.read_text() == kept and capsys.readouterr().out == shown.out
    assert 'python -m benchmarks guided' in plot.read_text()
    assert main([*options, '--runs', '1', '--points', '20']) == 2
    assert 'results with other points' in capsys.readouterr().err
    assert main([*options, '--limit', '0']) == 2
    assert '--limit must be more than 0' in capsys.readouterr().err
