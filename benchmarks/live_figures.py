# SPDX-License-Identifier: Apache-2.0
"""What was heard of a node while points were sent to it, in figures; knows no ROS."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.cases import bone, region_patch
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.acceptance import moved
from gsdf_registration.simulation.interference import Interference
from gsdf_registration.simulation.probe import Drag, Hand, Tracker, drag, random_pose

SIGMA = 1.5e-4      # m, noise per axis of an optical tracker
IN_THE_AIR = 0.27   # share of the samples that it takes to get from stroke to stroke
SAME = 1e-6         # s: stamps as near as this are one, whoever rounds them
COLUMNS = ('rate Hz', 'sent', 'lost', 'refused', 'unheard', 'poses', 'median', 'p95', 'p99', 'max',
           'CPU %', 'first s', 'ready s', 'TRE mm')


@dataclass
class Heard:
    """
    A run as its sender saw it; times in seconds on the sender's clock.

    sent : when each point was sent, which is also its stamp
    poses : arrival of each live pose, and its stamp
    pose : (4, 4), T_tracker_bone of the last of them
    ready : when the status first said so
    received, kept : points the node counted
    cpu : seconds of processor time that it took
    """

    sent: list[float] = field(default_factory=list)
    poses: list[tuple[float, float]] = field(default_factory=list)
    pose: Array | None = None
    ready: float | None = None
    received: int = 0
    kept: int = 0
    cpu: float = 0.0


def latencies(heard: Heard) -> tuple[Array, int]:
    """
    Return how long each point took to bear on a live pose, s, and how many never did.

    That is until the first pose whose stamp is no older. Counted are points sent once the status
    said ready, or if it never did, once there was a pose: before, the node may withhold it.
    """
    sent = np.array(heard.sent)
    if not heard.poses:
        return np.zeros(0), len(sent)
    arrivals, stamps = np.array(heard.poses).T
    sent = sent[sent >= (arrivals[0] if heard.ready is None else heard.ready)]
    # a pose that is overtaken by another says nothing new
    first = np.searchsorted(np.maximum.accumulate(stamps), sent - SAME)
    answered = first < len(stamps)
    return arrivals[first[answered]] - sent[answered], int((~answered).sum())


def line(heard: Heard, rate: float, true_error: float | None) -> tuple[str, ...]:
    """Return the line of the table: latencies in ms, CPU in per cent of one core."""
    found, unheard = latencies(heard)
    took = heard.sent[-1] - heard.sent[0]
    spread = [f'{1e3 * value:.1f}' for value in (
        *np.percentile(found, [50.0, 95.0, 99.0]), found.max())] if len(found) else ['-'] * 4
    return (f'{rate:g}', str(len(heard.sent)), str(len(heard.sent) - heard.received),
            str(heard.received - heard.kept), str(unheard), str(len(heard.poses)), *spread,
            f'{100.0 * heard.cpu / took:.0f}',
            _since(heard.poses[0][0] if heard.poses else None, heard.sent[0]),
            _since(heard.ready, heard.sent[0]),
            '-' if true_error is None else f'{1e3 * true_error:.2f}')


def _since(time: float | None, start: float) -> str:
    return '-' if time is None else f'{time - start:.1f}'


def simulated(path: str, region: str, rate: float, seconds: float, seed: int) -> Drag:
    """
    Return a run over what a wound exposes of a bone (mesh, mm), sampled all the time.

    In strokes, with the tip in the air between them; evenly, ``rate`` times a second.
    """
    rng = np.random.default_rng(seed)
    points = round((1.0 - IN_THE_AIR) * rate * seconds)
    return drag(region_patch(path, region), points, rng,
                tracker=Tracker(rate=rate, sigma=SIGMA, jitter=0.0), hand=Hand(pause=(0.0, 0.0)),
                interference=Interference(lift_off=IN_THE_AIR), T_tracker_bone=random_pose(rng))


def true_error(pose: Array, truth: Array, path: str) -> float:
    """Return the true TRE of a T_tracker_bone, RMS over the bone, m."""
    return moved(truth, pose, bone(path))


def processor_seconds(process: int) -> float:
    """Return the processor time, user and system, that all threads of a process have taken, s."""
    # behind the name of the program, in which there may be anything
    fields = Path(f'/proc/{process}/stat').read_text().rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
