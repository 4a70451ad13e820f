# SPDX-License-Identifier: Apache-2.0
"""The example client of the README with a real node."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest
from ros_support import ROOT, Tracker

pytestmark = pytest.mark.ros


def test_waits_until_ready_and_prints_the_pose(tracker: Tracker) -> None:
    client = tracker.client
    operator = subprocess.Popen([sys.executable, ROOT / 'examples/operator_client.py'],
                                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        tracker.drag(np.eye(4))
        client.spin_until(lambda: operator.poll() is not None, 'the example does not end')
        assert operator.stdout is not None
        output = operator.stdout.read()
    finally:
        operator.kill()
        operator.wait()
    assert operator.returncode == 0, output
    assert 'enough points: register now' in output
    x, y, z = (float(value) for value in re.findall(r'[xyz]=([-\d.e]+)', output)[:3])
    place = tracker.truth.T_tracker_bone[:3, 3]
    assert np.linalg.norm([x, y, z] - place) < 2e-3, output
