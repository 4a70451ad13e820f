# SPDX-License-Identifier: Apache-2.0
"""Collection that follows guidance beside collection at random: how many points each needs."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from benchmarks.cases import Case, bone, region_patch
from benchmarks.journal import Row
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.acceptance import NEAR, rms
from gsdf_registration.registration.confidence import Confidence, assess_at
from gsdf_registration.registration.guidance import where_they_differ, where_to_touch
from gsdf_registration.registration.pose_selection import SelectedPose, choose, solve_all
from gsdf_registration.search.global_search import find_start_poses
from gsdf_registration.simulation.patch import Patch, walk
from gsdf_registration.simulation.probe import Hand, Tracker, measured, random_pose

Known = tuple[SelectedPose, Confidence | None]

# -> where it wants the error to be small
WAYS = {'random': '', 'guided': 'near', 'guided_bone': 'bone'}
GOALS = {'near': 'on the bone within 100 mm of the wound', 'bone': 'over the whole bone'}
TRACKER = Tracker(sigma=5e-4)
STEP = Hand().speed / TRACKER.rate      # m, from sample to sample
BEND = 20.0             # 1/m, standard deviation of a stroke's curvature
FIRST = 2               # strokes, before anything is known
FIRST_POINTS = 60       # of each
FIRST_WITHIN = 0.02     # m: so near they lie to one another
GUESS = (0.04, 0.002)   # rad, m, standard deviation by axis of the guess, as from landmarks
EXPOSED = 2000          # points that tell guidance what is exposed
GAP = 0.004             # m: a patch so near to one of them is exposed


@dataclass(frozen=True)
class Collection:
    """
    A run of strokes, one of `WAYS`, over what a wound exposes.

    Runs of a case and seed have their pose, guess and first strokes in common.

    strokes, points : after the first, and of each
    limit : m, of the predicted TRE: where it is met, guidance sees to what is ambiguous
    """

    case: Case
    way: str
    seed: int
    strokes: int
    points: int
    limit: float

    @property
    def name(self) -> str:
        """Return bone/region/way/seed."""
        return f'{self.case.name}/{self.way}/{self.seed}'


def collections(cases: Sequence[Case], runs: int, seed: int, strokes: int, points: int,
                limit: float) -> Iterator[Collection]:
    """Yield ``runs`` of each way, case by case, so that a bench cut short has some of all."""
    for number in range(runs):
        case = cases[number % len(cases)]
        for way in WAYS:
            yield Collection(case, way, seed + number // len(cases), strokes, points,
                             limit)


def attempt(run: Collection, config: Config) -> Row:
    """
    Return the row of a run: after each stroke, the points held and the TRE predicted and true.

    Lists begin with what the first strokes gave; RMS, m; a predicted TRE is None where the points
    do not hold the pose; ambiguous says whether another pose fits about as well.
    """
    wound = _Wound(run)
    row: Row = {'case': run.case.name, 'way': run.way, 'seed': run.seed, 'points': [],
                'ambiguous': [],
                **{f'{kind}_{goal}_m': [] for goal in GOALS for kind in ('predicted', 'true')}}
    points = wound.first_strokes()
    known = _solved(points, wound.field, [wound.guess], config)
    for number in range(run.strokes + 1):
        if number:
            place = wound.next_place(known, config)
            points = np.concatenate([points, wound.touch(place, run.points)])
            last = known[0].solution.T_bone_tracker
            known = _solved(points, wound.field, [wound.guess, last], config)
        choice, confidence = known
        row['points'].append(len(points))
        row['ambiguous'].append(bool(choice.as_likely(config.limits.min_gap)))
        for goal, where in wound.targets.items():
            off = wound.error(choice.solution.T_bone_tracker, where)
            row[f'true_{goal}_m'].append(rms(np.linalg.norm(off, axis=1)))
            row[f'predicted_{goal}_m'].append(
                None if confidence is None else rms(confidence.predicted_tre(where)))
    return row


class _Wound:
    """What is exposed of a bone, somewhere in the tracker's sight, and the hand that touches it."""

    def __init__(self, run: Collection) -> None:
        self.run, self.rng = run, np.random.default_rng(
            [zlib.crc32(run.case.name.encode()), run.seed])
        self.field = bone(run.case.bone)
        self.patch = region_patch(run.case.bone, run.case.region)
        self.exposed, self.targets = _exposed(self.patch), _targets(run.case)
        self.T_tracker_bone = random_pose(self.rng)
        R = rigid.rotation_exp(self.rng.normal(0.0, GUESS[0], 3))
        c = self.patch.centre
        off = rigid.from_rt(R, c - R @ c + self.rng.normal(0.0, GUESS[1], 3))
        self.guess = off @ rigid.inverse(self.T_tracker_bone)

    def touch(self, place: Array, points: int) -> Array:
        """Return what is measured, (n, 3), m, of a stroke over a place (3,), m, bone frame."""
        tips = stroke(self.patch, place, points, self.rng)
        return measured(rigid.transform(self.T_tracker_bone, tips), TRACKER, self.rng)

    def first_strokes(self) -> Array:
        """Return the points of strokes near one another, somewhere."""
        middle = self.patch.random_points(1, self.rng)[0]
        near = self.exposed[np.linalg.norm(self.exposed - middle, axis=1) < FIRST_WITHIN]
        places = near[self.rng.integers(len(near), size=FIRST)]
        return np.concatenate([self.touch(place, FIRST_POINTS) for place in places])

    def next_place(self, known: Known, config: Config) -> Array:
        """Return where the next stroke goes, (3,), m, bone frame."""
        anywhere = self.patch.random_points(1, self.rng)[0][0]
        advised = self._advised(*known, config) if WAYS[self.run.way] else None
        if advised is None:
            return anywhere
        # the hand goes by the pose that was found
        T_found_true = known[0].solution.T_bone_tracker @ self.T_tracker_bone
        return rigid.transform(rigid.inverse(T_found_true), advised[None])[0]

    def _advised(self, choice: SelectedPose, confidence: Confidence | None,
                 config: Config) -> Array | None:
        """
        Return where guidance sends the hand to, (3,), m, bone frame; None if nowhere.

        As the first rejection_reason to a registration does: to hold the pose, then to tell it from
        others.
        """
        if confidence is None:
            return None
        targets = self.targets[WAYS[self.run.way]]
        rivals = choice.as_likely(config.limits.min_gap)
        if rivals and rms(confidence.predicted_tre(targets)) <= self.run.limit:
            poses = [choice.solution.T_bone_tracker, *rivals]
            return where_they_differ(poses, self.field, self.exposed, GAP).position
        return where_to_touch(confidence, self.field, self.exposed, targets, 1, GAP)[0].position

    def error(self, T_bone_tracker: Array, where: Array) -> Array:
        """Return how far off places ``where`` (n, 3), m, bone frame, are at a pose."""
        return np.asarray(rigid.transform(T_bone_tracker @ self.T_tracker_bone, where) - where)


def stroke(patch: Patch, place: Array, points: int, rng: np.random.Generator) -> Array:
    """Return tips (n, 3), m, of a stroke along an arc over ``place`` (3,), m, bone frame."""
    face = int(np.argmin(np.linalg.norm(patch.corners.mean(axis=1) - place, axis=1)))
    # out from the place by half of it, and back all the way
    turns = np.full(points // 2 + points, rng.normal(0.0, BEND) * STEP)
    turns[points // 2], turns[points // 2 + 1:] = np.pi, -turns[points // 2 + 1:]
    tips, _ = walk(patch, patch.corners[face].mean(axis=0)[None], np.array([face]),
                   rng.uniform(0.0, 2.0 * np.pi, 1), np.zeros(len(turns), dtype=np.int64),
                   np.full(len(turns), STEP), turns)
    return tips[points // 2:]


def _solved(points: Array, field: Field, starts: Sequence[Array],
            config: Config) -> Known:
    """Return the solution round the first of ``starts`` or from another, and how good it is."""
    basins = find_start_poses(points, field, config.search, starts[0])[:config.search.solutions]
    choice = choose(solve_all(points, field, [*starts, *basins], config), points, field,
                    config.solver)
    return choice, assess_at(choice.solution, points, field, config.solver)


@lru_cache(maxsize=64)
def _targets(case: Case) -> dict[str, Array]:
    """Return where the error is looked at, (n, 3), m, bone frame, for each of `GOALS`."""
    surface = bone(case.bone).surface_points[::4].astype(np.float64)
    exposed = _exposed(region_patch(case.bone, case.region))
    gap = cKDTree(exposed).query(surface, distance_upper_bound=NEAR)[0]
    return {'near': surface[gap < NEAR], 'bone': surface}


@lru_cache(maxsize=64)
def _exposed(patch: Patch) -> Array:
    """Return points (n, 3), m, bone frame, spread over what is exposed."""
    return patch.random_points(EXPOSED, np.random.default_rng(0))[0]
