# SPDX-License-Identifier: Apache-2.0
"""The stated accuracy of the peers in the same trials."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.calibration.trial import PLACES, compared, start_pose
from benchmarks.execution.result_table import Row
from benchmarks.paper.experiment import write_model
from benchmarks.peers.catalogue import STATING
from benchmarks.peers.peer_process import PeerError, PeerProcess
from benchmarks.protocol.trials import Problem, Trial, make
from gsdf_registration.common import rigid
from gsdf_registration.common.downsampling import farthest_point_sample
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence
from gsdf_registration.registration.motions import motion_between
from gsdf_registration.registration.point_selection import select_points

LANDMARK_NOISE = 1e-3   # m, per axis, of a landmark that is touched
LANDMARKS = 4

_running: dict[tuple[str, str], PeerProcess] = {}


def run_peer(job: tuple[str, Trial], python: str, models: Path) -> Row:
    """
    Return the row of a peer and a trial; a failure is a row of a lost pose.

    Raises
    ------
    InputError
        If the peer cannot be started, which says nothing about its poses.

    """
    name, trial = job
    problem = make(trial)
    try:
        process = _process(name, problem, python, models)
    except PeerError as error:
        raise InputError(f'{name} cannot be started: {error}') from None
    answer = _from_landmarks if name == 'scikit-surgerycore' else _from_points
    try:
        row = answer(problem, process)
    except PeerError:
        row = compared(None, rigid.from_rt(np.eye(3), np.full(3, np.inf)), problem)
    return {'case': trial.case.name, 'scenario': trial.scenario.name, 'seed': trial.seed,
            'peer': name, **row}


def _from_points(problem: Problem, process: PeerProcess) -> Row:
    """Return the comparison for a peer that registers the points from a pose near the true one."""
    points = select_points(problem.recording.positions).positions
    start = start_pose(problem)
    placed = rigid.transform(start, points)
    noise = float(np.sqrt(np.mean(np.square(problem.trial.scenario.sigma))))
    motion = process(placed, noise)[0]
    m = rigid.transform(motion, placed).mean(axis=0)
    G = motion_between(m, np.zeros(3))
    confidence = Confidence(G @ process.stated @ G.T, m, noise, 1.0)
    return compared(confidence, motion @ start @ problem.recording.T_tracker_bone, problem)


def _from_landmarks(problem: Problem, process: PeerProcess) -> Row:
    """Return the comparison for a predictor of the TRE from landmarks on the exposed area."""
    rng, T = np.random.default_rng([problem.trial.seed, 2]), problem.recording.T_tracker_bone
    on_bone = np.flatnonzero(problem.recording.on_bone)
    chosen = on_bone[farthest_point_sample(problem.recording.tips[on_bone], LANDMARKS)]
    distance, normal = problem.field.sample(problem.recording.tips[chosen])
    known = problem.recording.tips[chosen] - distance[:, None] * normal
    touched = rigid.transform(rigid.inverse(T), problem.recording.positions[chosen])
    touched = touched + LANDMARK_NOISE * rng.normal(size=touched.shape)
    places = [_some(problem.patch.corners.mean(axis=1)),
              _some((problem.bone or problem.field).surface_points.astype(np.float64))]
    motion = process(np.concatenate([known, touched, *places]),
                     float(np.hypot(LANDMARK_NOISE, np.mean(problem.trial.scenario.sigma))))[0]
    row = compared(None, motion, problem)
    row['near_stated_m'] = float(np.sqrt(process.stated[:len(places[0])].mean()))
    row['far_stated_m'] = float(np.sqrt(process.stated[len(places[0]):].mean()))
    return row


def _some(places: Array) -> Array:
    return places[::-(-len(places) // PLACES)]


def _process(name: str, problem: Problem, python: str, models: Path) -> PeerProcess:
    """Return the process of a peer with the model of a problem; an earlier one is closed."""
    file = model_file(problem.field, models)
    process = _running.get((name, file.name))
    if process is None or not process.alive:
        while _running:
            _running.popitem()[1].close()
        process = _running[name, file.name] = PeerProcess(Path(python), STATING[name].worker, file)
    return process


@cache
def model_file(field: Field, folder: Path) -> Path:
    """Return the file in ``folder`` with a model in the format of the peers; write it if needed."""
    file = folder / f'{field.bone_sha256[:32]}.npz'
    if not file.exists():
        write_model(field.vertices.astype(np.float64), field.faces.astype(np.int64), file)
    return file
