# SPDX-License-Identifier: Apache-2.0
"""An archive of good and bad recordings: one table, whatever runs it; a run can be continued."""

from __future__ import annotations

import csv
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import archive_worker
import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_mesh, touched_points

from gsdf_registration.cli import archive_run
from gsdf_registration.cli.archive_row import CRASHED, TIMES
from gsdf_registration.cli.archive_table import read_csv
from gsdf_registration.cli.main import main
from gsdf_registration.common.rigid import exp, transform
from msg_adapters.bag_writer import BagWriter
from msg_adapters.files import sha256_of
from msg_adapters.truth import Truth, truth_path, write_truth

REASONS = {'good': 'converged', 'twice': 'converged', 'truncated': 'converged',
           'damaged': 'bad_input', 'empty.mcap': 'bad_input', 'foreign.mcap': 'bad_input',
           'other_topics': 'bad_input', 'few': 'too_few_points', 'zz_killer': CRASHED}
OPTIONS = ('--model', 'bone.ply', '--initial', 'start.json', '--config', 'settings.yaml')


def write_bag(path: Path, points: int, seed: int, sigma: float = 0.0001) -> None:
    """Write a recording of the bone, in chunks of some kB."""
    touched = transform(T_TRACKER_BONE, touched_points(points, seed, sigma))
    with BagWriter(path) as bag:
        for i, point in enumerate(touched):
            bag.write_point('/probe/tip', 1.7e9 + i, point, 'tracker')


@pytest.fixture(scope='module')
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a bone, settings, and an archive."""
    root = tmp_path_factory.mktemp('fleet')
    mesh = bone_mesh().copy()
    mesh.apply_scale(1e3)
    mesh.export(root / 'bone.ply')
    start = exp([0.02, -0.01, 0.01, 0.002, 0.001, -0.001]) @ T_TRACKER_BONE
    (root / 'start.json').write_text(json.dumps({'T_tracker_bone': start.tolist()}))
    (root / 'settings.yaml').write_text('model: {voxel_size: 0.002}\nlimits: {max_error: 0.01}\n')
    archive = root / 'archive'
    archive.mkdir()
    for seed, name in enumerate(('good', 'truncated', 'damaged', 'zz_killer')):
        write_bag(archive / name, 300, seed)
    shutil.copytree(archive / 'good', archive / 'twice')
    write_bag(archive / 'few', 10, 9)
    write_truth(truth_path(archive / 'good'), Truth('../bone.ply', 'mm', 'tracker',
                                                    T_TRACKER_BONE))
    file, = (archive / 'truncated').glob('*.mcap')
    os.truncate(file, file.stat().st_size * 3 // 4)
    file, = (archive / 'damaged').glob('*.mcap')
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 255       # in its only chunk
    file.write_bytes(content)
    (archive / 'empty.mcap').touch()
    (archive / 'foreign.mcap').write_text('no recording\n')
    with BagWriter(archive / 'other_topics') as bag:
        bag.write_pose('/bone_pose', 1.7e9, np.eye(4), 'tracker')
    return root


@pytest.fixture(scope='module')
def pool(root: Path) -> Iterator[Path]:
    """Return the results of two processes, one of which dies."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        patch.setenv('GSDF_CACHE_DIR', str(root / 'cache'))
        patch.setattr(archive_run, 'compute_row', archive_worker.compute_or_die)
        assert main(['replay', 'archive', *OPTIONS, '--jobs', '2', '--output', 'pool']) == 2
        yield root / 'pool'


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Compute rows in this process; return the list of their recordings."""
    bags: list[str] = []

    def here(work: object, jobs: Iterator[archive_run.Job], _: int) -> Iterator[object]:
        for number, job in enumerate(jobs):
            bags.append(job.bag)
            yield number, archive_worker.compute_row(job)
    monkeypatch.setattr(archive_run, 'run_processes', here)
    return bags


def rows(folder: Path, times: bool = False) -> list[dict[str, object]]:
    """Return the rows of a run, without the times."""
    return [{name: value for name, value in row.items() if times or name not in TIMES}
            for row in read_csv(folder / 'results.csv')]


def test_each_recording_has_a_row_with_its_reason(pool: Path) -> None:
    found = {str(row['bag']).removeprefix('archive/'): row for row in rows(pool, times=True)}
    assert {bag: row['reason'] for bag, row in found.items()} == REASONS
    assert list(found) == sorted(REASONS)
    for bag, row in found.items():
        assert row['bag_sha256'] == sha256_of(pool.parent / 'archive' / bag)
        if row['received'] is not None:     # every sample is counted once
            assert row['received'] == row['used'] + row['left_out'] + row['rejected']
    good = found['good']
    assert good['grade'] in ('A', 'B') and good['complete'] is True and good['total_s'] > 0.0
    assert good['true_rms_m'] < 0.0005 and good['true_required_m'] < good['required_p95_m']
    assert found['twice']['true_rms_m'] is None
    assert found['truncated']['complete'] is False and found['truncated']['notes']
    document = json.loads((pool / good['result']).read_text())
    assert document['inputs']['points_sha256'] == good['bag_sha256']
    assert document['bone_pose']['position'] == [good[name] for name in ('x_m', 'y_m', 'z_m')]
    assert 'archive/empty.mcap' in found['empty.mcap']['message']
    assert str(pool.parent) not in (pool / 'results.csv').read_text()


def test_parquet_and_csv_have_the_same_values(pool: Path) -> None:
    parquet = pytest.importorskip('pyarrow.parquet', reason='pyarrow is not installed')
    values = parquet.read_table(pool / 'results.parquet').to_pylist()
    assert [{name: value for name, value in row.items() if value not in (None, '')}
            for row in values] == [
        {name: value for name, value in row.items() if value not in (None, '')}
        for row in rows(pool, times=True)]


def test_the_page_needs_no_network_and_links_each_result(pool: Path) -> None:
    page = (pool / 'summary.html').read_text()
    assert '3 of 9 registered' in page and '1 too few points' in page and 'http' not in page
    for row in rows(pool):
        assert (f'href="{row["result"]}"' in page) == (row['reason'] != CRASHED)


def test_a_dask_cluster_gives_the_same_table(pool: Path) -> None:
    distributed = pytest.importorskip('distributed', reason='distributed is not installed')
    import dask
    with dask.config.set({'distributed.scheduler.allowed-failures': 0}), \
            distributed.LocalCluster(n_workers=2, threads_per_worker=1,
                                     dashboard_address=':0') as cluster:
        assert main(['replay', 'archive', *OPTIONS, '--scheduler', cluster.scheduler_address,
                     '--output', 'dask']) == 2
    assert rows(pool.parent / 'dask') == rows(pool)
    assert main(['compare', 'pool', 'dask']) == 0


def test_a_run_is_continued(pool: Path, computed: list[str],
                            capsys: pytest.CaptureFixture[str]) -> None:
    before = rows(pool, times=True)
    folder = shutil.copytree(pool, pool.parent / 'continued')
    shutil.move('archive/good', 'archive/moved')        # the same content elsewhere
    shutil.move('archive/good.yaml', 'archive/moved.yaml')
    try:
        with (folder / 'journal.jsonl').open('a') as file:
            file.write('{"key": "abc", "ba')    # as after a kill
        main(['replay', 'archive', *OPTIONS, '--output', 'continued'])
        assert computed == ['archive/zz_killer']        # a crash is tried again
        after = rows(folder, times=True)
        assert [row for row in after if row['reason'] == 'converged'][-1]['bag'] == computed[0]
        good = next(row for row in before if row['bag'] == 'archive/good')
        assert {**good, 'bag': 'archive/moved'} in after and before[0] in after
        assert '9 results, 8 of them from an earlier run: 4 registered' in capsys.readouterr().out
    finally:
        shutil.move('archive/moved', 'archive/good')
        shutil.move('archive/moved.yaml', 'archive/good.yaml')
    main(['replay', 'archive/few', *OPTIONS, '--tip-radius', '0.0001', '--output', 'continued'])
    assert computed[1:] == ['archive/few']              # with other settings


def test_settings_are_compared_over_cases(pool: Path, computed: list[str],
                                          capsys: pytest.CaptureFixture[str]) -> None:
    Path('cases.csv').write_text('bag,label,config\narchive/twice,left,\n'
                                 'archive/good,right,other.yaml\n')
    Path('other.yaml').write_text('limits: {max_error: 0.00001}\n')
    assert main(['replay', '--cases', 'cases.csv', *OPTIONS, '--sweep',
                 'solver.method=mixture,paper', '--output', 'sweep']) == 1
    found = rows(Path('sweep'))
    assert computed == ['archive/twice', 'archive/twice', 'archive/good', 'archive/good']
    assert [(row['label'], row['setting'], row['reason']) for row in found] == [
        (label, f'solver.method={method}', reason)
        for label, reason in (('left', 'converged'), ('right', 'under_constrained'))
        for method in ('mixture', 'paper')]
    assert len({row['settings_sha256'] for row in found}) == 4
    for row in found:
        assert json.loads(Path('sweep', row['result']).read_text())['config']['solver.method'] in (
            row['setting'])
    assert 'Settings compared' in Path('sweep/summary.html').read_text()
    assert capsys.readouterr().out.startswith('4 results: 2 registered, 2 under_constrained\n')


def test_each_row_links_to_its_report(pool: Path, computed: list[str]) -> None:
    pytest.importorskip('PIL', reason='Pillow is not installed')
    command = ['replay', 'archive/good', 'archive/empty.mcap', *OPTIONS, '--case', 'knee 7',
               '--report', '--output', 'reported']
    assert main(command) == 2
    good, empty = rows(Path('reported'))
    assert 'knee 7' in Path('reported', good['report']).read_text() and not empty['report']
    page = Path('reported/summary.html').read_text()
    assert f'href="{good["report"]}"' in page and f'href="{empty["result"]}"' in page
    Path('reported', good['report']).unlink()       # a file that is missing is written again
    assert main(command) == 2 and computed[2:] == ['archive/good']
    assert Path('reported', rows(Path('reported'))[0]['report']).is_file()


def test_changes_between_runs_are_listed(pool: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree('pool', 'other')
    table = Path('other/results.csv')
    changed = list(csv.DictReader(table.open()))
    good = next(row for row in changed if row['bag'] == 'archive/good')
    good['x_m'] = repr(float(good['x_m']) + 0.002)
    changed[-1] |= {'reason': 'ambiguous'}
    with table.open('w', newline='') as file:
        writer = csv.DictWriter(file, changed[0])
        writer.writeheader()
        writer.writerows(changed)
    assert main(['compare', 'pool', 'other', '--report', 'changes.html']) == 1
    text = capsys.readouterr().out
    assert 'archive/good: registered (A), 2.00 mm' in text
    assert 'archive/zz_killer: crashed -> ambiguous' in text
    page = Path('changes.html').read_text()
    assert '2 changed' in page and 'http' not in page and f'href="other/{good["result"]}"' in page
    assert main(['compare', 'pool', 'other', '--limit', '3']) == 1      # the verdict
    assert main(['compare', 'pool', 'pool', '--limit', '0']) == 0


@pytest.mark.parametrize('words, says', [
    (['a', '--model', 'm', '--sweep', 'solver.method=paper'], '--sweep needs --output DIR'),
    (['--output', 'o'], 'give recordings, or a table of them with --cases CSV'),
    (['archive/few', '--output', 'o'], 'give the bone with --model MODEL'),
    (['archive/few', *OPTIONS, '--output', 'o', '--sweep', 'solver.method=best'],
     'solver.method must be one of mixture, paper, not "best"'),
    (['archive/few', *OPTIONS, '--output', 'o', '--sweep', 'solver.methd=paper'],
     'did you mean solver.method?'),
    (['archive/few', *OPTIONS, '--output', 'o', '--sweep', 'solver.method'],
     'give a setting and its values'),
    (['archive/few', *OPTIONS, '--output', 'o', '--report', 'x.html'],
     'give --report without a name'),
    (['archive/few', *OPTIONS, '--output', 'bone.ply'], 'bone.ply cannot be written'),
    (['archive/few', *OPTIONS, '--output', 'o', '--jobs', '2', '--scheduler', 'tcp://x:1'],
     'give one of them')])
def test_wrong_usage_is_one_sentence(pool: Path, words: list[str], says: str,
                                     capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['replay', *words]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count('\n') == 1 and error.startswith('gsdf: error: ')
