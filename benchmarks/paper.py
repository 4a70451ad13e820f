# SPDX-License-Identifier: Apache-2.0
"""
The published experiments anew: which methods are asked which questions, and what they answer.

All get the same points, after the same density filter but for our pipeline, which has its own.
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

from benchmarks import cases
from benchmarks.cases import Case
from benchmarks.journal import Row
from benchmarks.peers.caller import Caller, PeerError
from benchmarks.peers.catalogue import PEERS
from benchmarks.protocol import SCENARIOS, Problem, Trial, make
from benchmarks.scoring import (
    FAR,
    PoseErrors,
    cramer_rao,
    is_wrong,
    pose_errors,
)
from benchmarks.starts import from_centroids, from_landmarks
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.registration.pipeline import register
from gsdf_registration.search.point_filters import filter_isolated
from gsdf_registration.solver import solve

ANGLE = np.pi / 4       # rotations of up to this much about x, y and z, as published
PER_AREA = 8e6          # model points a square metre for the peers: 0.35 mm apart
OURS, PUBLISHED = 'gsdf', 'paper'
TABLES = {
    'regions': ('clean', 'anisotropic'),
    'noise': ('clean', 'sigma_0.7', 'sigma_0.9', 'sigma_1.2'),
    'outliers': ('uniform_10', 'uniform_30', 'uniform_50', 'uniform_70', 'uniform_90'),
    'structured': ('soft_tissue_40', 'lift_off_40', 'other_object_40', 'resting_30', 'mixed_40'),
    'model': ('model_off',)
}
SAMPLED = ('clean', 'anisotropic', 'uniform_50', 'mixed_40')    # of them, for a dear method


@dataclass(frozen=True)
class Method:
    """
    A way to a pose.

    start : what it is given: '', 'landmarks' or 'centroids'
    peer : name of the other library, '' for our own
    cost : 0 all trials, 1 the first round only, 2 and of few cases, 3 and one scenario
    """

    name: str
    start: str
    peer: str = ''
    cost: int = 0

    def tries(self, trial: Trial, number: int, first: frozenset[Case]) -> bool:
        """Tell whether it is asked in a round; ``first`` holds a case of each region."""
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
    A question to a method.

    python : of the peer's environment; ours for our own methods
    models : folder in which what peers read of the bones is kept
    """

    method: Method
    trial: Trial
    python: Path
    models: Path
    config: Config


class Answer(NamedTuple):
    """What came of it: status answered, refused, timeout or failed, and why; SI units."""

    status: str
    note: str = ''
    T_tracker_bone: Array | None = None
    seconds: float | None = None
    predicted_rms: float | None = None


def questions(methods: Sequence[Method], found: Sequence[Case], scenarios: Sequence[str],
              seeds: int, seed: int = 0) -> Iterator[tuple[Method, Trial]]:
    """Yield each method with its trials, one bone after another so that it is prepared once."""
    first = frozenset({case.region: case for case in reversed(found)}.values())
    for method in methods:
        for case in sorted(found, key=lambda case: case.bone):
            for scenario in scenarios:
                for number in range(seeds):
                    trial = Trial(case, SCENARIOS[scenario], seed + number, case.bone,
                                  ANGLE)
                    if method.tries(trial, number, first):
                        yield method, trial


def attempt(job: Job) -> Row:
    """Return the row of a job: who was asked what, and how good the answer is."""
    problem = make(job.trial)
    answer = _ours(job, problem) if job.method.name == OURS else _guided(job, problem)
    errors: dict[str, float | None] = dict.fromkeys(PoseErrors.__dataclass_fields__)
    if answer.T_tracker_bone is not None:
        errors |= asdict(pose_errors(answer.T_tracker_bone, problem, cramer_rao(problem)))
    tre = errors['tre_rms_m']
    claims = job.method.name == OURS and answer.status == 'answered'
    return {
        'method': job.method.name, 'start': job.method.start, 'bone': Path(job.trial.model).stem,
        'region': job.trial.case.region, 'scenario': job.trial.scenario.name,
        'seed': job.trial.seed, 'status': answer.status, 'success': tre is not None and tre <= FAR,
        'wrong': is_wrong(problem, tre, answer.predicted_rms) if claims else None, **errors,
        'predicted_rms_m': answer.predicted_rms, 'seconds': answer.seconds, 'note': answer.note
    }


def _ours(job: Job, problem: Problem) -> Answer:
    """Return what the whole pipeline answers, with nothing but the points."""
    result = register(problem.drag.positions, problem.field, job.config)
    return Answer('answered' if result.success else 'refused', str(result.reason),
                  result.T_tracker_bone, result.timing_s.get('total'),
                  result.predicted_tre_m.get('rms'))


def _guided(job: Job, problem: Problem) -> Answer:
    """Return what a method answers that gets filtered points, and a start if it needs one."""
    points, search = problem.drag.positions, job.config.search
    points = points[filter_isolated(points, search.radius)]
    start = (from_landmarks(problem) if job.method.start == 'landmarks' else
             from_centroids(problem, points))
    if not job.method.peer:
        began = perf_counter()
        solution = solve(points, problem.field, start,
                         job.config.replaced({'solver.method': 'paper'}).solver)
        return Answer('answered', '', inverse(solution.T_bone_tracker), perf_counter() - began)
    noise = float(np.sqrt(np.mean(np.square(problem.trial.scenario.sigma))))
    try:
        motion, seconds = _caller(job)(transform(start, points), noise)
    except PeerError as error:
        return Answer('timeout' if error.timeout else 'failed', str(error))
    return Answer('answered', '', inverse(motion @ start), seconds)


_at_work: dict[tuple[str, str], Caller] = {}
_unfit: dict[tuple[str, str], PeerError] = {}      # did not get ready; it is not tried again


def _caller(job: Job) -> Caller:
    """Return the peer with the bone prepared; one at a time in this process."""
    key = job.method.peer, job.trial.model
    if key in _unfit:
        raise _unfit[key]
    caller = _at_work.get(key)
    if caller is None or not caller.alive:
        while _at_work:
            _at_work.popitem()[1].close()
        try:
            caller = Caller(job.python, PEERS[job.method.peer].worker,
                            model_file(job.trial.model, job.models))
        except PeerError as error:
            _unfit[key] = error
            raise
        _at_work[key] = caller
    return caller


@cache
def model_file(path: str, folder: Path) -> Path:
    """Return the file in ``folder`` with what peers read of a mesh; it is made if need be."""
    file = folder / f'{Path(path).stem}.npz'
    if not file.exists():
        vertices, faces = cases.surface(path)
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        points, face = trimesh.sample.sample_surface(mesh, int(PER_AREA * mesh.area), seed=0)
        part = folder / f'{os.getpid()}.npz'
        np.savez(part, vertices=vertices, faces=faces.astype(np.int32), points=points,
                 normals=mesh.face_normals[face])
        part.replace(file)
    return file
