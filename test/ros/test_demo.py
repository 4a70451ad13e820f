# SPDX-License-Identifier: Apache-2.0
"""``gsdf demo`` finds the pose of the bone and writes the report."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from ros_support import ROOT

# on a clean clone the node compiles all its kernels first
pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]


def test_demo_finds_the_bone(tmp_path: Path) -> None:
    page = tmp_path / 'new' / 'page.html'
    done = subprocess.run([sys.executable, '-m', 'gsdf_registration', 'demo', '--report',
                           str(page)], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    error = re.search(r'TRE over the bone ([\d.]+) mm RMS', done.stdout)
    assert error is not None, done.stdout
    assert float(error[1]) < 1.0
    assert '<b>Registered</b>' in page.read_text(encoding='utf-8')
    assert re.search(r'points +\d+ received; \d+ kept in \d+ strokes', done.stdout)
