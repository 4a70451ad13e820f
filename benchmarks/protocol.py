# SPDX-License-Identifier: Apache-2.0
"""
What is asked: a bone, the region touched, how the touching is disturbed, and a seed.

Names are stable: the same bone/region/scenario/seed gives the same points on any machine.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from benchmarks import hard
from benchmarks.cases import (
    KIND,
    Case,
    between_scans,
    bone,
    region_patch,
    surface,
)
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.simulation.interference import NONE, Interference
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import Drag, Tracker, drag, random_pose

POINTS = (600, 1000)    # samples on the bone, fewest and most
SIGMA = 5e-4            # m, noise of a point per axis
# a pose may be had, or hardly
POSSIBLE = ('cup_only', 'shaft_only', 'model_off', 'other_scan')
IMPOSSIBLE = ('mirrored', 'contralateral', 'other_bone', 'other_person', 'object_only',
              'noise_only')                             # what is touched is not the model


@dataclass(frozen=True)
class Scenario:
    """
    How a bone is touched.

    sigma : noise per axis of the tracker, m
    hard : what is wrong with the data, a word of `POSSIBLE` or `IMPOSSIBLE`; empty: nothing is
    """

    name: str
    interference: Interference = NONE
    sigma: float | tuple[float, float, float] = SIGMA
    hard: str = ''

    @property
    def wrong(self) -> bool:
        """Whether what is touched is not the model, so that every pose is wrong."""
        return self.hard in IMPOSSIBLE

    def suits(self, region: str) -> bool:
        """Tell whether a region can be touched so; of a long bone's shaft, one region speaks."""
        return region in {'cup_only': ('acetabulum',),
                          'shaft_only': ('proximal_femur', 'proximal_tibia')}.get(self.hard, KIND)


SCENARIOS = {scenario.name: scenario for scenario in (
    Scenario('clean'),
    *(Scenario(f'uniform_{share}', Interference(uniform=share / 100))
      for share in (10, 30, 50, 70, 90)),
    *(Scenario(f'soft_tissue_{share}', Interference(soft_tissue=share / 100))
      for share in (10, 20, 40)),
    *(Scenario(f'lift_off_{share}', Interference(lift_off=share / 100)) for share in (20, 40)),
    *(Scenario(f'other_object_{share}', Interference(other_object=share / 100))
      for share in (20, 40)),
    Scenario('resting_30', Interference(resting=0.3)),
    Scenario('mixed_40', Interference(uniform=0.1, soft_tissue=0.1, lift_off=0.1,
                                      other_object=0.1)),
    Scenario('anisotropic', sigma=(3e-4, 5e-4, 7e-4)),
    *(Scenario(f'sigma_{sigma:g}', sigma=sigma * 1e-3) for sigma in (0.15, 0.7, 0.9, 1.2)),
    *(Scenario(word, hard=word) for word in POSSIBLE + IMPOSSIBLE))}


@dataclass(frozen=True)
class Trial:
    """
    One question.

    model : the mesh to be found under the points; not `case.bone` where another is given
    angle : rad, the rotation is of up to this much about x, y and z; None: any rotation
    """

    case: Case
    scenario: Scenario
    seed: int
    model: str
    angle: float | None = None

    @property
    def name(self) -> str:
        """Return bone/region/scenario/seed."""
        return f'{self.case.name}/{self.scenario.name}/{self.seed}'

    def random(self) -> np.random.Generator:
        """Return the source of all that is random in it, the same on any machine."""
        words = (zlib.crc32(word.encode()) for word in (self.case.name, self.scenario.name))
        return np.random.default_rng(np.random.SeedSequence([self.seed, *words]))


@dataclass(frozen=True, eq=False)
class Problem:
    """
    A trial's data.

    field : of the model to be found
    drag : the points, ``drag.positions`` (n, 3) m, tracker frame, and what is true of them
    patch : what was exposed
    """

    trial: Trial
    field: Field
    drag: Drag
    patch: Patch

    @property
    def touched(self) -> Array:
        """Return where the bone was truly touched (k, 3), m, bone frame."""
        return self.drag.tips[self.drag.on_bone]


def trials(cases: Sequence[Case], scenarios: Sequence[Scenario], seed: int = 0,
           angle: float | None = None) -> Iterator[Trial]:
    """
    Yield trials without end, each round of seeds once over all cases and scenarios.

    Within a round the order is mixed, so any number of trials is a fair sample; more trials only
    add to fewer.
    """
    pairs = [(case, scenario) for scenario in scenarios for case in cases
             if scenario.suits(case.region) and _models(case, scenario, cases)]
    for number in count(seed) if pairs else ():
        for k in np.random.default_rng(number).permutation(len(pairs)):
            case, scenario = pairs[k]
            models = _models(case, scenario, cases)
            yield Trial(case, scenario, number, models[number % len(models)], angle)


def make(trial: Trial) -> Problem:
    """
    Return the data of a trial.

    Raises
    ------
    InputError
        If a mesh cannot be read or has no such region.

    """
    rng, word = trial.random(), trial.scenario.hard
    points = int(rng.integers(POINTS[0], POINTS[1] + 1))
    T = random_pose(rng, angle=trial.angle)
    tracker = Tracker(sigma=trial.scenario.sigma)
    field = bone(trial.model, word == 'mirrored')
    patch = region_patch(trial.case.bone, trial.case.region, word == 'contralateral')
    if word == 'noise_only':
        return Problem(trial, field, hard.scattered(patch.bounds, points, tracker, T, rng), patch)
    if word == 'cup_only':
        patch = hard.cup(*surface(trial.case.bone), patch, rng)
    elif word == 'shaft_only':
        patch = hard.shaft(*surface(trial.case.bone), rng)
    elif word == 'object_only':
        patch = hard.other_object(rng)
    elif word == 'other_scan':      # as if the model had been touched, whose surface is elsewhere
        patch = hard.moved(patch, between_scans(trial.case.bone, trial.model))
    run = drag(patch, points, rng, tracker=tracker, interference=trial.scenario.interference,
               T_tracker_bone=T)
    if word == 'model_off':
        run = hard.off_the_model(run, field, rng)
    return Problem(trial, field, run, patch)


def _models(case: Case, scenario: Scenario, cases: Sequence[Case]) -> list[str]:
    """Return the meshes among which a trial's model is taken, in order; none: it cannot be had."""
    if scenario.hard == 'other_bone':
        return sorted({c.bone for c in cases if c.kind != case.kind})
    same = [c for c in cases if c.kind == case.kind and c.bone != case.bone]
    if scenario.hard == 'other_person':
        return sorted({c.bone for c in same if c.person != case.person})
    if scenario.hard == 'other_scan':
        return sorted({c.bone for c in same if (c.person, c.side) == (case.person, case.side)})
    return [case.bone]
