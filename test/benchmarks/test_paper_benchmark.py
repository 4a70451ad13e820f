# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks paper``: the trials of each method, their rows, and the tables."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.paper import experiment
from benchmarks.paper.experiment import METHODS, SAMPLED, TABLES, Job, run_trial, trials_of
from benchmarks.paper.tables import figures, markdown, tsv
from benchmarks.peers.peer_process import PeerError
from benchmarks.protocol import starts
from benchmarks.protocol.cases import Case, find_cases
from benchmarks.protocol.trials import SCENARIOS, Problem, Trial, make
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config

ALL = list(dict.fromkeys(name for names in TABLES.values() for name in names))


def trial(bone: Path, scenario: str = 'clean') -> Trial:
    return Trial(Case(str(bone), 'acetabulum'), SCENARIOS[scenario], 0, str(bone), experiment.ANGLE)


@pytest.fixture(scope='module')
def problem(hip_bone: Path) -> Problem:
    return make(trial(hip_bone))


def test_scenarios_of_the_tables_exist() -> None:
    assert set(ALL) | set(SAMPLED) <= set(SCENARIOS)


def test_slow_methods_solve_fewer_trials(bags: Path) -> None:
    found = find_cases(sorted(bags.glob('*.ply')))
    solved = {name: [trial for _, trial in trials_of([method], found, ALL, 3)]
             for name, method in METHODS.items()}
    everything = len(found) * len(ALL) * 3
    assert len(solved['gsdf']) == len(solved['MeshLib']) == everything
    assert len(solved['FilterReg']) == everything / 3
    assert {trial.scenario.name for trial in solved['JRMPC']} == set(SAMPLED)
    assert {trial.seed for trial in solved['JRMPC']} == {0}
    later = [trial.seed for _, trial in trials_of([METHODS['JRMPC']], found, ALL, 3, 1000)]
    assert len(later) == len(solved['JRMPC']) and set(later) == {1000}
    assert {trial.scenario.name for trial in solved['Go-ICP']} == {'clean'}
    assert {trial.scenario.name for trial in solved['paper@centroids']} == set(TABLES['regions'])


def test_start_from_landmarks_is_near_and_reproducible(problem: Problem) -> None:
    start = starts.from_landmarks(problem)
    np.testing.assert_array_equal(start, starts.from_landmarks(problem))
    off = start @ problem.recording.T_tracker_bone
    touched = problem.touched
    displacement = np.linalg.norm(rigid.transform(off, touched) - touched, axis=1)
    assert 1e-4 < displacement.mean() < 0.012


def test_start_from_centroids_has_no_rotation(problem: Problem) -> None:
    points = problem.recording.positions
    start = starts.from_centroids(problem, points)
    np.testing.assert_array_equal(start[:3, :3], np.eye(3))
    np.testing.assert_allclose(rigid.transform(start, points).mean(axis=0),
                               problem.field.surface_points.mean(axis=0), atol=1e-5)


def job(method: str, bone: Path, folder: Path) -> Job:
    config = Config().replaced({'search.threads': 1})
    return Job(METHODS[method], trial(bone), Path(sys.executable), folder, config)


def test_rows_of_our_own_methods(hip_bone: Path, tmp_path: Path) -> None:
    ours, published = (run_trial(job(name, hip_bone, tmp_path)) for name in ('gsdf', 'paper'))
    assert list(ours) == list(published)
    for row in (ours, published):
        assert row['status'] == 'answered' and row['success'] and row['tre_rms_m'] < 1e-3
    assert ours['wrong'] is False and published['wrong'] is None
    assert (ours['start'], published['start']) == ('', 'landmarks')


@pytest.mark.parametrize('timeout, status', [(True, 'timeout'), (False, 'failed')])
def test_row_of_a_peer_without_an_answer(hip_bone: Path, tmp_path: Path, timeout: bool,
                                         status: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def fails(*_: Any) -> None:
        tried.append(1)
        raise PeerError('no answer', timeout)
    monkeypatch.setattr(experiment, 'PeerProcess', fails)
    monkeypatch.setattr(experiment, '_failed', {})
    for _ in range(2):
        row = run_trial(job('MeshLib', hip_bone, tmp_path))
        assert (row['status'], row['note'], row['success']) == (status, 'no answer', False)
        assert row['tre_rms_m'] is None
    assert len(tried) == 1      # a peer that cannot be prepared is not tried again


def test_pose_of_a_peer_combines_start_and_motion(
        hip_bone: Path, problem: Problem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Perfect:
        """Returns the exact remaining motion."""

        alive = True

        def __init__(self, *_: Any) -> None:
            pass

        def __call__(self, points: np.ndarray, noise: float) -> tuple[np.ndarray, float]:
            assert noise == pytest.approx(5e-4)
            start = starts.from_landmarks(problem)
            assert np.abs(problem.field.sample(points)[0]).mean() < 0.01
            return rigid.inverse(start @ problem.recording.T_tracker_bone), 0.25

        def close(self) -> None:
            pass
    monkeypatch.setattr(experiment, 'PeerProcess', Perfect)
    monkeypatch.setattr(experiment, '_running', {})
    row = run_trial(job('MeshLib', hip_bone, tmp_path))
    assert row['status'] == 'answered' and row['success'] and row['seconds'] == 0.25
    assert row['tre_max_m'] < 1e-9


def rows() -> list[dict[str, Any]]:
    errors = dict.fromkeys(('t_origin_mae_m', 'tre_mean_m', 'tre_rms_m', 'tre_p95_m', 'tre_max_m',
                            'chamfer_m'), 1e-3)
    one = {'method': 'gsdf', 'start': '', 'region': 'acetabulum', 'scenario': 'clean',
           'status': 'answered', 'success': True, 'wrong': False, 'rotation_mae_deg': 0.2,
           't_centroid_mae_m': 1e-4, 'seconds': 0.5, **errors}
    none = dict.fromkeys(('rotation_mae_deg', 't_centroid_mae_m', 'seconds', *errors))
    return [one, {**one, 'success': False, 'wrong': True, 'rotation_mae_deg': 9.8},
            {**one, **none, 'status': 'refused', 'success': False, 'wrong': None},
            {**one, 'scenario': 'uniform_90', 'seconds': 2.0},
            {**one, **none, 'method': 'Go-ICP', 'status': 'timeout', 'success': False,
             'wrong': None}]


def test_means_are_over_poses_and_success_is_over_trials() -> None:
    f = figures(rows()[:3])
    assert (f.trials, f.poses, f.wrong) == (3, 2, 1.0)
    assert f.success == pytest.approx(1 / 3)
    assert f.rotation == pytest.approx(5.0) and f.good_rotation == pytest.approx(0.2)
    assert f.t_centroid == pytest.approx(0.1) and f.chamfer == pytest.approx(1.0)


def test_tables_show_ours_published_and_missing_methods() -> None:
    text = markdown(rows(), {'TEASER++': 'needs Python 3.10'}, '# Caption')
    lines = text.splitlines()
    assert lines[0] == '# Caption'
    assert '| gsdf | 5 / 0.1 / 1, 33 % |' in lines
    assert '| Go-ICP | timeout |' in lines
    assert '| the paper (published) | 0.204 / 0.202 / 0.706 |' in lines
    assert '| the paper (published) | 0.961 / 0.608 / 2.32 |' in lines
    assert '- TEASER++: needs Python 3.10' in lines
    assert all(line.count('|') == before.count('|') for before, line in zip(lines, lines[1:])
               if line.startswith('|') and before.startswith('|'))


def test_figures_as_tsv() -> None:
    head, *lines = (line.split('\t') for line in tsv(rows()).splitlines())
    assert {len(line) for line in lines} == {len(head)}
    by = {tuple(line[:4]): dict(zip(head, line)) for line in lines}
    assert by['gsdf', '', 'clean', 'all']['rotation'] == '5'
    assert by['gsdf', '', 'uniform_90', 'acetabulum']['seconds'] == '2'


def test_plots_contain_every_method_with_several_levels() -> None:
    pytest.importorskip('plotly')
    from benchmarks.paper.plots import page
    text = page(rows())
    assert 'the paper (published)' in text and '"name":"gsdf"' in text
    assert '"name":"Go-ICP"' not in text


@pytest.mark.parametrize('option, value', [('--methods', 'magic'), ('--tables', 'seven')])
def test_rejects_unknown_names(option: str, value: str, tmp_path: Path,
                               capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['paper', option, value, '--output', str(tmp_path / 'new')]) == 2
    assert f'"{value}" is unknown; choose one of' in capsys.readouterr().err


def test_writes_its_files_and_continues_a_run(
        tmp_path: Path, hip_bone: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('plotly')
    (tmp_path / 'bones').mkdir()
    (tmp_path / 'bones/hip.ply').symlink_to(hip_bone)
    out = tmp_path / 'out'
    command = ['paper', '--bones', str(tmp_path / 'bones'), '--methods', 'paper',
               '--tables', 'regions', '--trials', '1', '--output', str(out)]
    assert main(command) == 0
    assert capsys.readouterr().out == (out / 'tables.md').read_text() + '\n'
    trials = (out / 'trials.tsv').read_text()
    assert len(trials.splitlines()) == 2 + len(TABLES['regions'])
    (out / 'figures.tsv').unlink()
    assert main(command) == 0
    assert (out / 'trials.tsv').read_text() == trials
    assert (out / 'figures.tsv').exists() and (out / 'plots.html').exists()
