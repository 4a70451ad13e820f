# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks live``: latencies and losses from the messages of a run."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.commands.live import read_rates
from benchmarks.live.figures import (
    COLUMNS,
    Measurement,
    latencies,
    line,
    processor_seconds,
    simulated,
    true_error,
)
from gsdf_registration.common import rigid
from gsdf_registration.common.result import InputError


def measurement(ready: float | None = 0.15) -> Measurement:
    # the pose for 0.2 arrives after the one for 0.3
    return Measurement(sent=[0.0, 0.1, 0.2, 0.3, 0.4, 0.5],
                 poses=[(0.08, 0.0), (0.11, 0.1), (0.304, 0.3), (0.31, 0.2), (0.402, 0.4 - 2e-7)],
                 received=5, kept=4, cpu=0.1, ready=ready)


def test_latency_ends_at_the_first_pose_with_a_later_stamp() -> None:
    found, unanswered = latencies(measurement())
    np.testing.assert_allclose(found, [0.104, 0.004, 0.002], atol=1e-9)
    assert unanswered == 1
    found, unanswered = latencies(measurement(ready=None))
    np.testing.assert_allclose(found, [0.01, 0.104, 0.004, 0.002], atol=1e-9)
    nothing, unanswered = latencies(Measurement(sent=[0.0, 0.1]))
    assert len(nothing) == 0 and unanswered == 2


def test_line_of_the_table() -> None:
    cells = dict(zip(COLUMNS, line(measurement(), 10.0, 0.00042), strict=True))
    assert cells == {
        'rate Hz': '10', 'sent': '6', 'lost': '1', 'rejected': '1', 'unanswered': '1', 'poses': '5',
        'median': '4.0', 'p95': '94.0', 'p99': '102.0', 'max': '104.0', 'CPU %': '20',
        'first s': '0.1', 'ready s': '0.1', 'TRE mm': '0.42'}
    silent = dict(zip(COLUMNS, line(Measurement(sent=[0.0, 1.0], received=2), 1.0, None)))
    assert silent['p99'] == silent['first s'] == silent['TRE mm'] == '-' and silent['lost'] == '0'


def test_simulated_recording_has_no_pauses(femur_bone: Path) -> None:
    run = simulated(str(femur_bone), 'condyles', 80.0, 20.0, 0)
    assert len(run.positions) == pytest.approx(1600, abs=2)
    np.testing.assert_allclose(np.diff(run.stamps), 1.0 / 80.0, atol=1e-9)
    speed = np.linalg.norm(np.diff(run.tips, axis=0), axis=1) * 80.0
    assert (speed > 0.5).sum() <= 3
    assert 0.6 < run.on_bone.mean() < 0.8 and len(np.unique(run.kinds)) == 2


def test_true_error_is_over_the_bone(femur_bone: Path) -> None:
    T = rigid.exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])
    assert true_error(T, T, str(femur_bone)) < 1e-9
    off = rigid.from_rt(np.eye(3), [0.0, 0.002, 0.0]) @ T
    assert true_error(off, T, str(femur_bone)) == pytest.approx(0.002)


def test_processor_time_of_a_process() -> None:
    before = processor_seconds(os.getpid())
    end = time.process_time() + 0.2
    while time.process_time() < end:
        pass
    assert processor_seconds(os.getpid()) - before >= 0.15


@pytest.mark.parametrize('text', ['', 'fast', '80,', '0', '1e9', 'nan'])
def test_rejects_bad_rates(text: str) -> None:
    with pytest.raises(InputError, match='from 1 to 5000'):
        read_rates(text)
    assert read_rates('80,1000') == [80.0, 1000.0]
