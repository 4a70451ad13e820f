# SPDX-License-Identifier: Apache-2.0
"""Simulate runs of strokes with guidance and at random, and register after each stroke."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.execution.result_table import Row
from benchmarks.protocol.cases import Case, bone, region_patch
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, rms
from gsdf_registration.registration.candidate import Candidate
from gsdf_registration.registration.guidance import best_touches, distinguishing_touch
from gsdf_registration.registration.pipeline import find_candidate
from gsdf_registration.registration.zone import NEARBY
from gsdf_registration.simulation.patch import Patch, stroke_over
from gsdf_registration.simulation.probe import Hand, Tracker, measure, random_pose

# strategy -> where it reduces the error
STRATEGIES = {'random': '', 'guided': 'near', 'guided_bone': 'bone'}
GOALS = {'near': 'on the bone within 100 mm of the incision', 'bone': 'over the whole bone'}
TRACKER = Tracker(sigma=5e-4)
STEP = Hand().speed / TRACKER.rate      # m, between samples
BEND = 20.0             # 1/m, standard deviation of the curvature of a stroke
FIRST_STROKES = 2       # at random, before the first registration
FIRST_POINTS = 60       # per first stroke
FIRST_DISTANCE = 0.02   # m, maximum distance of the first strokes from their middle
GUESS = (0.04, 0.002)   # rad, m, standard deviation per axis of the guess, as from landmarks
EXPOSED = 2000          # points that represent the exposed area for the guidance
GAP = 0.004             # m, maximum distance of an exposed patch from one of them


@dataclass(frozen=True)
class Run:
    """
    A run of strokes with one of `STRATEGIES` over an exposed area.

    Runs of the same case and seed have the same pose, guess and first strokes.

    strokes, points : number of strokes after the first ones, and points per stroke
    limit : m, of the predicted TRE; below it, the guidance resolves ambiguities
    """

    case: Case
    strategy: str
    seed: int
    strokes: int
    points: int
    limit: float

    @property
    def name(self) -> str:
        """Return bone/region/strategy/seed."""
        return f'{self.case.name}/{self.strategy}/{self.seed}'


def runs_of(cases: Sequence[Case], runs: int, seed: int, strokes: int, points: int,
            limit: float) -> Iterator[Run]:
    """Yield ``runs`` of each strategy, alternating the cases: few runs cover all cases."""
    for number in range(runs):
        case = cases[number % len(cases)]
        for strategy in STRATEGIES:
            yield Run(case, strategy, seed + number // len(cases), strokes, points, limit)


def simulate_run(run: Run, config: Config) -> Row:
    """
    Return the row of a run: the points, and the predicted and true TRE after each stroke.

    The lists begin after the first strokes. TRE are RMS, m; a predicted TRE is None if the points
    do not constrain the pose. ``ambiguous`` says whether an alternative pose fits about as well.
    """
    surgery = _Surgery(run)
    row: Row = {'case': run.case.name, 'strategy': run.strategy, 'seed': run.seed, 'points': [],
                'ambiguous': [],
                **{f'{kind}_{goal}_m': [] for goal in GOALS for kind in ('predicted', 'true')}}
    points = surgery.first_strokes()
    candidate = find_candidate(points, surgery.field, config, [surgery.guess])
    for number in range(run.strokes + 1):
        if number:
            place = surgery.next_place(candidate, config)
            points = np.concatenate([points, surgery.touch(place, run.points)])
            last = candidate.solution.T_bone_tracker
            candidate = find_candidate(points, surgery.field, config, [surgery.guess, last])
        selected, confidence = candidate.selected, candidate.confidence
        row['points'].append(len(points))
        row['ambiguous'].append(bool(selected.ambiguous(config.limits.min_gap)))
        for goal, where in surgery.targets.items():
            error = surgery.error(selected.solution.T_bone_tracker, where)
            row[f'true_{goal}_m'].append(rms(np.linalg.norm(error, axis=1)))
            row[f'predicted_{goal}_m'].append(
                None if confidence is None else rms(confidence.predicted_tre(where)))
    return row


class _Surgery:
    """An exposed area of a bone at a random pose, and the probe that touches it."""

    def __init__(self, run: Run) -> None:
        self.run, self.rng = run, np.random.default_rng(
            [zlib.crc32(run.case.name.encode()), run.seed])
        self.field = bone(run.case.bone)
        self.patch = region_patch(run.case.bone, run.case.region)
        self.exposed, self.targets = _exposed(self.patch), _targets(run.case)
        self.T_tracker_bone = random_pose(self.rng)
        R = rigid.rotation_exp(self.rng.normal(0.0, GUESS[0], 3))
        c = self.patch.centre
        error = rigid.from_rt(R, c - R @ c + self.rng.normal(0.0, GUESS[1], 3))
        self.guess = error @ rigid.inverse(self.T_tracker_bone)

    def touch(self, place: Array, points: int) -> Array:
        """Return the measured points (n, 3), m, of a stroke over a place (3,), m, bone frame."""
        tips = stroke_over(self.patch, place, points, STEP, BEND, self.rng)
        return measure(rigid.transform(self.T_tracker_bone, tips), TRACKER, self.rng)

    def first_strokes(self) -> Array:
        """Return the points of the first strokes, near one another at a random place."""
        middle = self.patch.random_points(1, self.rng)[0]
        near = self.exposed[np.linalg.norm(self.exposed - middle, axis=1) < FIRST_DISTANCE]
        places = near[self.rng.integers(len(near), size=FIRST_STROKES)]
        return np.concatenate([self.touch(place, FIRST_POINTS) for place in places])

    def next_place(self, candidate: Candidate, config: Config) -> Array:
        """Return the place of the next stroke, (3,), m, bone frame."""
        random_place = self.patch.random_points(1, self.rng)[0][0]
        proposed = self._proposed(candidate, config) if STRATEGIES[self.run.strategy] else None
        if proposed is None:
            return random_place
        # the surgeon navigates with the estimated pose
        T_estimated_true = candidate.solution.T_bone_tracker @ self.T_tracker_bone
        return rigid.transform(rigid.inverse(T_estimated_true), proposed[None])[0]

    def _proposed(self, candidate: Candidate, config: Config) -> Array | None:
        """
        Return the place that the guidance proposes, (3,), m, bone frame, or None.

        As in a rejected registration: first to constrain the pose, then to tell it from others.
        """
        confidence = candidate.confidence
        if confidence is None:
            return None
        targets = self.targets[STRATEGIES[self.run.strategy]]
        alternatives = candidate.selected.ambiguous(config.limits.min_gap)
        if alternatives and rms(confidence.predicted_tre(targets)) <= self.run.limit:
            poses = [candidate.solution.T_bone_tracker, *alternatives]
            return distinguishing_touch(poses, self.field, self.exposed, GAP).position
        return best_touches(confidence, self.field, self.exposed, targets, 1, GAP)[0].position

    def error(self, T_bone_tracker: Array, where: Array) -> Array:
        """Return the errors (n, 3), m, at places ``where`` (n, 3), m, bone frame, of a pose."""
        return np.asarray(rigid.transform(T_bone_tracker @ self.T_tracker_bone, where) - where)


@lru_cache(maxsize=64)
def _targets(case: Case) -> dict[str, Array]:
    """Return the points (n, 3), m, bone frame, at which the error counts, for each of `GOALS`."""
    surface = bone(case.bone).surface_points[::4].astype(np.float64)
    exposed = _exposed(region_patch(case.bone, case.region))
    gap = cKDTree(exposed).query(surface, distance_upper_bound=NEARBY)[0]
    return {'near': surface[gap < NEARBY], 'bone': surface}


@lru_cache(maxsize=64)
def _exposed(patch: Patch) -> Array:
    """Return random points (n, 3), m, bone frame, of the exposed area."""
    return patch.random_points(EXPOSED, np.random.default_rng(0))[0]
