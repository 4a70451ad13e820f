# SPDX-License-Identifier: Apache-2.0
"""Jobs run in other processes, once each, also after failures and interruptions."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import jobs
import pytest

from benchmarks.execution.runner import run_all
from gsdf_registration.common.result import InputError

STOPPED = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
import jobs
from benchmarks.execution.runner import run_all
if __name__ == '__main__':
    run_all({str(k): k for k in range(3)}, jobs.first_only, output=Path(sys.argv[1]), workers=2)
"""


def test_returns_rows_in_the_order_of_the_jobs() -> None:
    rows = run_all({f'job {k}': k for k in range(6)}, jobs.squared, workers=2)
    assert [row['job'] for row in rows] == [f'job {k}' for k in range(6)]
    assert [row['square'] for row in rows] == [0, 1, 4, 9, 16, 25]
    assert os.getpid() not in {row['process'] for row in rows}


def test_each_job_has_one_thread_and_the_environment_is_restored() -> None:
    before = os.environ.get('OMP_NUM_THREADS')
    assert run_all({'a': 'OMP_NUM_THREADS'}, jobs.environment)[0]['value'] == '1'
    assert os.environ.get('OMP_NUM_THREADS') == before


def test_continues_a_table(tmp_path: Path) -> None:
    table, calls = tmp_path / 'table.tsv', tmp_path / 'calls'
    calls.mkdir()
    work = {str(k): (calls, k) for k in range(4)}
    run_all({name: work[name] for name in '02'}, jobs.noted, output=table, about={'seed': 1})
    assert len(list(calls.iterdir())) == 2
    rows = run_all(work, jobs.noted, output=table, about={'seed': 1})
    assert [row['number'] for row in rows] == [0, 1, 2, 3]
    assert len(list(calls.iterdir())) == 4
    assert len(table.read_text().splitlines()) == 2 + 4


def test_keeps_the_rows_before_a_failure(tmp_path: Path) -> None:
    table = tmp_path / 'table.tsv'
    work = {str(k): k for k in range(5)}
    with pytest.raises(InputError, match='three is not allowed'):
        run_all(work, jobs.fails_at_three, output=table, workers=1)
    assert len(table.read_text().splitlines()) == 2 + 3


def test_reports_a_process_that_dies(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='a process died'):
        run_all({str(k): k for k in range(5)}, jobs.dies_at_three, output=tmp_path / 'table.tsv',
                workers=1)


@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGKILL])
def test_interruption_keeps_rows_and_leaves_no_process(tmp_path: Path, how: signal.Signals) -> None:
    script, table = tmp_path / 'script.py', tmp_path / 'table.tsv'
    script.write_text(STOPPED)
    run = subprocess.Popen([sys.executable, str(script), str(table), str(Path(__file__).parent)],
                           env={**os.environ, 'PYTHONPATH': str(Path(__file__).parents[2])},
                           stderr=subprocess.PIPE, start_new_session=True,
                           # a shell ignores it for jobs in the background, and so would this one
                           preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL))
    wait_until(lambda: table.exists() and table.read_text().count('\n') == 3)
    run.send_signal(how)
    assert run.wait(20) != 0
    # a remaining process would keep the pipe open, and this would block
    assert b'KeyboardInterrupt' in run.stderr.read() or how == signal.SIGKILL
    assert table.read_text().count('\n') == 3


def wait_until(condition: object, patience: float = 60.0) -> None:
    end = time.monotonic() + patience
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end
        time.sleep(0.05)
