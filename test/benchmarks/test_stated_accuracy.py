# SPDX-License-Identifier: Apache-2.0
"""The accuracy that peers state: the closed forms, and the table of all peers."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import benchmarks.peers.workers
from benchmarks.calibration.peers import run_peer
from benchmarks.calibration.tables import COLUMNS, peer_table
from benchmarks.calibration.trial import compared
from benchmarks.peers.catalogue import STATING
from benchmarks.protocol.cases import Case
from benchmarks.protocol.scoring import cramer_rao
from benchmarks.protocol.trials import SCENARIOS, Trial, make
from gsdf_registration.common import rigid
from gsdf_registration.common.result import InputError

NOISE = 1e-3


def test_the_closed_form_of_point_to_point_icp_is_the_spread_of_paired_points(
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, 'path', [*sys.path, *benchmarks.peers.workers.__path__])
    from benchmarks.peers.workers.accuracy import _prakhya
    rng = np.random.default_rng(0)
    places, errors = rng.uniform(-0.03, 0.03, (40, 3)), []
    for _ in range(1000):
        y, q = (places + NOISE * rng.normal(size=places.shape) for _ in range(2))
        U, _, Vt = np.linalg.svd((q - q.mean(axis=0)).T @ (y - y.mean(axis=0)))
        R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        errors.append(np.concatenate([rigid.rotation_log(R), q.mean(axis=0) - R @ y.mean(axis=0)]))
    stated = _prakhya(places, places, NOISE)
    assert np.cov(np.array(errors).T).diagonal() == pytest.approx(stated.diagonal(), rel=0.2)


def test_the_table_has_a_line_for_each_scenario_of_each_peer(femur_bone: Path) -> None:
    case = Case(str(femur_bone), 'condyles')
    problem = make(Trial(case, SCENARIOS['clean'], 0, case.bone))
    bound = cramer_rao(problem)
    row = {'case': 'a/condyles', 'scenario': 'clean', 'seed': 0}
    stating = {**row, 'peer': 'A', **compared(bound, np.eye(4), problem)}
    only_rms = {**row, 'peer': 'B', **compared(None, np.eye(4), problem), 'near_stated_m': 1e-3,
                'far_stated_m': 2e-3}
    failed = {**row, 'peer': 'B', **compared(None, rigid.from_rt(np.eye(3), np.full(3, np.inf)),
                                             problem)}
    lines = [dict(zip(COLUMNS, cells)) for cells in peer_table([stating, only_rms, failed])]
    assert [line['scenario'] for line in lines] == ['  clean', 'A', '  clean', 'B']
    assert lines[1]['95 % region'] == '100.00%' and lines[1]['lost'] == '0'
    assert lines[3]['95 % region'] == '-' and lines[3]['lost'] == '1'
    assert lines[3]['near true/stated'] == '0.00 / 1.00'


def test_a_peer_that_cannot_be_started_is_named(femur_bone: Path, tmp_path: Path,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    missing = replace(STATING['ICP, Censi'], worker=('accuracy', 'missing'))
    monkeypatch.setitem(STATING, 'ICP, Censi', missing)
    case = Case(str(femur_bone), 'condyles')
    with pytest.raises(InputError, match='^ICP, Censi cannot be started: .*Error: '):
        run_peer(('ICP, Censi', Trial(case, SCENARIOS['clean'], 0, case.bone)), sys.executable,
                 tmp_path)
