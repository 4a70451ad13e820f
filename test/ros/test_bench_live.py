# SPDX-License-Identifier: Apache-2.0
"""`gsdf bench live`: the real node hears every point, and its figures are of one piece."""

from __future__ import annotations

import subprocess
import sys

import pytest

from benchmarks.live_figures import COLUMNS

# on a clean clone the node compiles all its kernels first
pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]


def test_the_figures_are_of_one_piece() -> None:
    done = subprocess.run([sys.executable, '-m', 'gsdf_registration.cli.main', 'bench', 'live',
                           '--seconds', '12', '--rates', '80'], capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == '', done.stdout + done.stderr
    title, _, _, cells = done.stdout.strip().splitlines()
    assert title == 'hip/acetabulum, 12 s a run; latency in ms'
    found = dict(zip(COLUMNS, map(float, cells.split()), strict=True))
    assert 100 < found['sent'] <= 960 and found['lost'] == 0.0
    assert 0 <= found['refused'] < 10
    assert found['poses'] > 0 and 0.0 < found['first s'] < 13.0
    assert 0.0 < found['median'] <= found['p95'] <= found['p99'] <= found['max']
    assert 0.0 < found['CPU %'] <= 200.0 and found['TRE mm'] < 2.0
