# SPDX-License-Identifier: Apache-2.0
"""Compute latencies and losses from a measurement of the live pose; without ROS."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.protocol.cases import bone, region_patch
from gsdf_registration.common.rigid import Array, rms_displacement
from gsdf_registration.simulation.interference import Interference
from gsdf_registration.simulation.probe import (
    Hand,
    SimulatedRecording,
    Tracker,
    random_pose,
    simulate_scan,
)

SIGMA = 1.5e-4      # m, noise per axis of an optical tracker
IN_THE_AIR = 0.27   # share of the samples between strokes
TOLERANCE = 1e-6    # s, rounding error of a stamp
COLUMNS = ('rate Hz', 'sent', 'lost', 'rejected', 'unanswered', 'poses', 'median', 'p95', 'p99',
           'max', 'CPU %', 'first s', 'ready s', 'TRE mm')


@dataclass
class Measurement:
    """
    The messages of a run; times in seconds on the clock of the sender.

    sent : time of each point, which is also its stamp
    poses : arrival and stamp of each live pose
    pose : (4, 4), m, T_tracker_bone of the last live pose
    ready : time of the first status `ready`
    received, kept : points that the node counted
    cpu : processor time of the node, s
    """

    sent: list[float] = field(default_factory=list)
    poses: list[tuple[float, float]] = field(default_factory=list)
    pose: Array | None = None
    ready: float | None = None
    received: int = 0
    kept: int = 0
    cpu: float = 0.0


def latencies(measured: Measurement) -> tuple[Array, int]:
    """
    Return the latency of each answered point, s, and the number of unanswered points.

    A point is answered by the first pose with the same or a later stamp. Only points after the
    status `ready` count, or after the first pose if the status never was `ready`: before that, the
    node may withhold its pose.
    """
    sent = np.array(measured.sent)
    if not measured.poses:
        return np.zeros(0), len(sent)
    arrivals, stamps = np.array(measured.poses).T
    sent = sent[sent >= (arrivals[0] if measured.ready is None else measured.ready)]
    # a pose that arrives after a later one answers no point
    first = np.searchsorted(np.maximum.accumulate(stamps), sent - TOLERANCE)
    answered = first < len(stamps)
    return arrivals[first[answered]] - sent[answered], int((~answered).sum())


def line(measured: Measurement, rate: float, true_error: float | None) -> tuple[str, ...]:
    """Return the line of the table: latencies in ms, CPU in percent of one core."""
    found, unanswered = latencies(measured)
    duration = measured.sent[-1] - measured.sent[0]
    spread = [f'{1e3 * value:.1f}' for value in (
        *np.percentile(found, [50.0, 95.0, 99.0]), found.max())] if len(found) else ['-'] * 4
    return (f'{rate:g}', str(len(measured.sent)), str(len(measured.sent) - measured.received),
            str(measured.received - measured.kept), str(unanswered), str(len(measured.poses)),
            *spread,
            f'{100.0 * measured.cpu / duration:.0f}',
            _since(measured.poses[0][0] if measured.poses else None, measured.sent[0]),
            _since(measured.ready, measured.sent[0]),
            '-' if true_error is None else f'{1e3 * true_error:.2f}')


def _since(time: float | None, start: float) -> str:
    return '-' if time is None else f'{time - start:.1f}'


def simulated(path: str, region: str, rate: float, seconds: float, seed: int) -> SimulatedRecording:
    """
    Return a recording over an exposed region of a bone (mesh, mm), sampled without pauses.

    It consists of strokes with the tip in the air between them, at ``rate``, Hz, without jitter.
    """
    rng = np.random.default_rng(seed)
    points = round((1.0 - IN_THE_AIR) * rate * seconds)
    return simulate_scan(region_patch(path, region), points, rng,
                tracker=Tracker(rate=rate, sigma=SIGMA, jitter=0.0), hand=Hand(pause=(0.0, 0.0)),
                interference=Interference(lift_off=IN_THE_AIR), T_tracker_bone=random_pose(rng))


def true_error(pose: Array, truth: Array, path: str) -> float:
    """Return the true TRE of a T_tracker_bone, RMS over the bone, m."""
    return rms_displacement(truth, pose, bone(path).surface_points)


def processor_seconds(process: int) -> float:
    """Return the processor time, user and system, of all threads of a process, s (Linux)."""
    # after the name of the program, which may contain spaces and parentheses
    fields = Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
