# SPDX-License-Identifier: Apache-2.0
"""
The published experiments: which methods solve which trials, and their answers.

All methods get the same points. The other methods get them after the density filter that our
pipeline applies itself.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
import trimesh

from benchmarks.execution.result_table import Row
from benchmarks.peers.catalogue import PEERS
from benchmarks.peers.peer_process import PeerError, PeerProcess
from benchmarks.protocol import cases
from benchmarks.protocol.cases import Case
from benchmarks.protocol.scoring import PoseErrors, cramer_rao, pose_errors, verdict
from benchmarks.protocol.starts import from_centroids, from_landmarks, given_landmarks
from benchmarks.protocol.trials import SCENARIOS, Problem, Trial, make
from gsdf_registration.common.config import Config
from gsdf_registration.common.point_filters import filter_isolated
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.registration.pipeline import register
from gsdf_registration.solver import solve

FAR = 0.003             # m, RMS over the whole bone: a pose within it is a success
ANGLE = np.pi / 4       # maximum rotation about each of x, y and z, as published
DENSITY = 8e6           # model points per square metre for the peers: 0.35 mm apart
OURS, PUBLISHED = 'gsdf', 'paper'
TABLES = {
    'regions': ('clean', 'anisotropic'),
    'noise': ('clean', 'sigma_0.7', 'sigma_0.9', 'sigma_1.2'),
    'outliers': ('uniform_10', 'uniform_30', 'uniform_50', 'uniform_70', 'uniform_90'),
    'structured': ('soft_tissue_40', 'lift_off_40', 'other_object_40', 'resting_30', 'mixed_40'),
    'model': ('model_off',),
    'touches': ('touches_40', 'touches_40_soft_10', 'touches_40_soft_20')
}
SAMPLED = ('clean', 'anisotropic', 'uniform_50', 'mixed_40')    # scenarios for slow methods


@dataclass(frozen=True)
class Method:
    """
    A registration method.

    start : its initial guess: '' (none), 'landmarks' or 'centroids'
    peer : name of the other library, '' for our own methods
    cost : 0: all trials, 1: the first seed only, 2: also few cases, 3: also one scenario
    """

    name: str
    start: str
    peer: str = ''
    cost: int = 0

    def solves(self, trial: Trial, number: int, first: frozenset[Case]) -> bool:
        """Return whether it solves a trial of seed ``number``; ``first``: a case per region."""
        scenario = trial.scenario.name
        return (self.cost < 1 or number == 0) and (self.cost < 2 or trial.case in first) and (
            self.cost < 2 or scenario in SAMPLED[:1 if self.cost > 2 else None]) and (
                self.start != 'centroids' or scenario in TABLES['regions'])


METHODS = {method.name: method for method in (
    Method(OURS, ''), Method(PUBLISHED, 'landmarks'),
    Method(f'{PUBLISHED}@centroids', 'centroids'),
    *(Method(peer.name, 'landmarks' if peer.guided else '', peer.name, peer.cost)
      for peer in PEERS.values()),
    Method('Open3D@centroids', 'centroids', 'Open3D', 1))}


class Job(NamedTuple):
    """
    A trial for a method.

    python : of the environment of the peer; ours for our own methods
    models : folder with the bones in the format of the peers
    """

    method: Method
    trial: Trial
    python: Path
    models: Path
    config: Config


class Answer(NamedTuple):
    """An answer: its status (answered, refused, timeout, failed) and the reason; SI units."""

    status: str
    note: str = ''
    T_tracker_bone: Array | None = None
    seconds: float | None = None
    predicted_rms: float | None = None
    wrong: bool | None = None       # accepted and wrong; None without an acceptance of its own


def trials_of(methods: Sequence[Method], found: Sequence[Case], scenarios: Sequence[str],
              seeds: int, seed: int = 0) -> Iterator[tuple[Method, Trial]]:
    """Yield each method with its trials, sorted by bone, so that each bone is prepared once."""
    first = frozenset({case.region: case for case in reversed(found)}.values())
    for method in methods:
        for case in sorted(found, key=lambda case: case.bone):
            for scenario in scenarios:
                for number in range(seeds):
                    trial = Trial(case, SCENARIOS[scenario], seed + number, case.bone,
                                  ANGLE)
                    if method.solves(trial, number, first):
                        yield method, trial


def run_trial(job: Job) -> Row:
    """Return the row of a job: the method, the trial, the answer and its errors."""
    problem = make(job.trial)
    answer = _ours(job, problem) if job.method.name == OURS else _guided(job, problem)
    errors: dict[str, float | None] = dict.fromkeys(PoseErrors.__dataclass_fields__)
    if answer.T_tracker_bone is not None:
        errors |= asdict(pose_errors(answer.T_tracker_bone, problem, cramer_rao(problem)))
    tre = errors['tre_rms_m']
    return {
        'method': job.method.name, 'start': job.method.start, 'bone': Path(job.trial.model).stem,
        'region': job.trial.case.region, 'scenario': job.trial.scenario.name,
        'seed': job.trial.seed, 'status': answer.status, 'success': tre is not None and tre <= FAR,
        'wrong': answer.wrong, **errors,
        'predicted_rms_m': answer.predicted_rms, 'seconds': answer.seconds, 'note': answer.note
    }


def _ours(job: Job, problem: Problem) -> Answer:
    """Return the answer of the whole pipeline, given the points and the landmarks, if any."""
    result = register(problem.recording.positions, problem.field, job.config,
                      landmarks=given_landmarks(problem))
    return Answer('answered' if result.success else 'refused', str(result.reason),
                  result.T_tracker_bone, result.timing_s.get('total'),
                  result.predicted_tre_m.get('rms'),
                  verdict(problem, result, job.config) in ('wrong', 'understated'))


def _guided(job: Job, problem: Problem) -> Answer:
    """Return the answer of another method, given filtered points and a start if it needs one."""
    points = problem.recording.positions
    points = points[filter_isolated(points)]
    start = (from_landmarks(problem) if job.method.start == 'landmarks' else
             from_centroids(problem, points))
    if not job.method.peer:
        started = perf_counter()
        solution = solve(points, problem.field, start,
                         job.config.replaced({'solver.method': 'paper'}).solver)
        return Answer('answered', '', inverse(solution.T_bone_tracker), perf_counter() - started)
    noise = float(np.sqrt(np.mean(np.square(problem.trial.scenario.sigma))))
    try:
        motion, seconds = _process(job)(transform(start, points), noise)
    except PeerError as error:
        return Answer('timeout' if error.timeout else 'failed', str(error))
    return Answer('answered', '', inverse(motion @ start), seconds)


_running: dict[tuple[str, str], PeerProcess] = {}   # at most one, in this process
_failed: dict[tuple[str, str], PeerError] = {}      # could not be prepared; not tried again


def _process(job: Job) -> PeerProcess:
    """Return the process of the peer with the bone prepared; an earlier one is closed."""
    key = job.method.peer, job.trial.model
    if key in _failed:
        raise _failed[key]
    process = _running.get(key)
    if process is None or not process.alive:
        while _running:
            _running.popitem()[1].close()
        try:
            process = PeerProcess(job.python, PEERS[job.method.peer].worker,
                                  model_file(job.trial.model, job.models))
        except PeerError as error:
            _failed[key] = error
            raise
        _running[key] = process
    return process


@cache
def model_file(path: str, folder: Path) -> Path:
    """Return the file in ``folder`` with a mesh in the format of the peers; write it if needed."""
    file = folder / f'{Path(path).stem}.npz'
    if not file.exists():
        write_model(*cases.surface(path), file)
    return file


def write_model(vertices: Array, faces: np.ndarray, file: Path) -> None:
    """Write a mesh, m, in the format of the peers."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    points, face = trimesh.sample.sample_surface(mesh, int(DENSITY * mesh.area), seed=0)
    part = file.parent / f'{os.getpid()}.npz'
    np.savez(part, vertices=vertices, faces=faces.astype(np.int32), points=points,
             normals=mesh.face_normals[face])
    part.replace(file)
