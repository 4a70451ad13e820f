# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks live``: the node receives every point, and the figures are plausible."""

from __future__ import annotations

import subprocess
import sys

import pytest
from ros_support import ROOT

from benchmarks.live.figures import COLUMNS

# on a clean clone the node compiles all its kernels first
pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]


def test_figures_are_plausible() -> None:
    done = subprocess.run([sys.executable, '-m', 'benchmarks', 'live',
                           '--seconds', '12', '--rates', '80'], cwd=ROOT, capture_output=True,
                          text=True)
    assert done.returncode == 0 and done.stderr == '', done.stdout + done.stderr
    title, _, _, cells = done.stdout.strip().splitlines()
    assert title == 'hip/acetabulum, 12 s per run; latency in ms'
    found = dict(zip(COLUMNS, map(float, cells.split()), strict=True))
    assert 100 < found['sent'] <= 960 and found['lost'] == 0.0
    assert 0 <= found['rejected'] < 10
    assert found['poses'] > 0 and 0.0 < found['first s'] < 13.0
    assert 0.0 < found['median'] <= found['p95'] <= found['p99'] <= found['max']
    assert 0.0 < found['CPU %'] <= 200.0 and found['TRE mm'] < 2.0
