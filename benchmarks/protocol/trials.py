# SPDX-License-Identifier: Apache-2.0
"""
A trial: a bone, the exposed region, a scenario of interference and noise, and a seed.

Names are stable: the same bone/region/scenario/seed gives the same points on any machine.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from benchmarks.protocol import hard_cases, touching
from benchmarks.protocol.cases import KIND, Case, between_scans, bone, region_patch, surface
from benchmarks.protocol.real_models import REAL_MODELS, SETTINGS, model_of, with_deviation
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.simulation.ball_tip import with_ball_tip
from gsdf_registration.simulation.interference import NONE, Interference
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.probe import (
    SimulatedRecording,
    Tracker,
    random_pose,
    simulate_scan,
)

POINTS = (600, 1000)    # minimum and maximum number of samples on the bone
SIGMA = 5e-4            # m, noise of a point per axis
OPTICAL = 1.5e-4        # m, that of an optical tracker
# hard cases: the pose can be found or not; the points are not of the model, so every pose is wrong
POSSIBLE = ('cup_only', 'shaft_only', 'model_off', 'other_scan')
IMPOSSIBLE = ('mirrored', 'contralateral', 'other_bone', 'other_person', 'object_only',
              'noise_only')


@dataclass(frozen=True)
class Scenario:
    """
    Interference and noise of a trial.

    sigma : noise per axis of the tracker, m
    hard : the hard case, a word of `POSSIBLE` or `IMPOSSIBLE`; empty: none
    tip_radius : of a ball tip, m, which rolls along the strokes of `clean`; 0: a sharp tip
    touches : number of single touches instead of strokes, of which the share of soft tissue is off
        the bone; 0: strokes
    landmarks : whether three landmarks, touched 3 mm off, are given
    rest : m, smallest and largest distance from the bone at which the tip also rests; None: nowhere
    real_model : what is inexact, of `REAL_MODELS`; empty: nothing
    """

    name: str
    interference: Interference = NONE
    sigma: float | tuple[float, float, float] = SIGMA
    hard: str = ''
    tip_radius: float = 0.0
    touches: int = 0
    landmarks: bool = False
    rest: tuple[float, float] | None = None
    real_model: str = ''

    @property
    def wrong(self) -> bool:
        """Whether the points are not of the model, so that every pose is wrong."""
        return self.hard in IMPOSSIBLE

    @property
    def settings(self) -> dict[str, float]:
        """What the user of such a probe and model sets."""
        return {'probe.tip_radius': self.tip_radius, 'probe.tip_error': 0.0,
                **SETTINGS.get(self.real_model, {})}

    def suits(self, region: str) -> bool:
        """Return whether the scenario is possible in a region; shafts count for one region only."""
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
    *(Scenario(f'ball_{radius:g}', tip_radius=radius * 1e-3) for radius in (0.5, 1.0, 1.5)),
    *(Scenario(f'touches_{count}' + f'_soft_{soft}' * (soft > 0), Interference(
        soft_tissue=soft / 100), 3e-4, touches=count, landmarks=count < 60)
      for count in (40, 60) for soft in (0, 10, 20)),
    *(Scenario(name, sigma=1.5e-4, rest=off) for name, off in (
        ('rest_on', (0.0, 0.0)), ('rest_beside', (0.001, 0.01)), ('rest_far', (0.05, 0.3)))),
    *(Scenario(word + optical, sigma=sigma, real_model=word) for word in REAL_MODELS
      for optical, sigma in (('', SIGMA), ('_optical', OPTICAL))),
    *(Scenario(word, hard=word) for word in POSSIBLE + IMPOSSIBLE),
    *(Scenario(f'{word}_optical', sigma=OPTICAL, hard=word) for word in IMPOSSIBLE[:-1]))}


@dataclass(frozen=True)
class Trial:
    """
    One registration problem.

    model : the mesh to be registered; not `case.bone` in scenarios with another bone
    angle : rad, maximum rotation about each of x, y and z; None: any rotation
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
        """Return the random generator of the trial, the same on any machine."""
        scenario = 'clean' if self.scenario.tip_radius else self.scenario.name
        words = (zlib.crc32(word.encode()) for word in (self.case.name, scenario))
        return np.random.default_rng(np.random.SeedSequence([self.seed, *words]))


@dataclass(frozen=True, eq=False)
class Problem:
    """
    The data of a trial.

    field : of the model to be registered, for the tip of the scenario
    recording : the points, ``recording.positions`` (n, 3) m, tracker frame, and their ground truth
    patch : the exposed area
    bone : field of the bone that is touched, if its model is another one
    """

    trial: Trial
    field: Field
    recording: SimulatedRecording
    patch: Patch
    bone: Field | None = None

    @property
    def touched(self) -> Array:
        """Return the true positions of the samples on the bone (k, 3), m, bone frame."""
        return self.recording.tips[self.recording.on_bone]


def trials(cases: Sequence[Case], scenarios: Sequence[Scenario], seed: int = 0,
           angle: float | None = None) -> Iterator[Trial]:
    """
    Yield trials forever, one seed after another over all cases and scenarios.

    The order within a seed is random, so that any number of trials is a fair sample. A larger
    number of trials contains the smaller one.
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
        recording = hard_cases.only_noise(patch.bounds, points, tracker, T, rng)
        return Problem(trial, field, recording, patch)
    if word == 'cup_only':
        patch = hard_cases.cup(*surface(trial.case.bone), patch, rng)
    elif word == 'shaft_only':
        patch = hard_cases.shaft(*surface(trial.case.bone), rng)
    elif word == 'object_only':
        patch = hard_cases.other_object(rng)
    elif word == 'other_scan':      # into the frame of the model, which is of another scan
        patch = hard_cases.moved(patch, between_scans(trial.case.bone, trial.model))
    interference = trial.scenario.interference
    if trial.scenario.touches:
        return Problem(trial, field, touching.single_touches(
            patch, trial.scenario.touches, interference.soft_tissue, tracker, T, rng), patch)
    recording = simulate_scan(patch, points, rng, tracker=tracker, interference=interference,
                              T_tracker_bone=T)
    if trial.scenario.rest:
        recording = touching.with_rest(recording, patch, trial.scenario.rest, tracker, rng)
    if trial.scenario.real_model:
        recording = with_deviation(recording, trial.scenario.real_model, field, patch, rng)
        model = model_of(trial.model, trial.scenario.real_model, trial.seed)
        return Problem(trial, model, recording, patch, field)
    if word == 'model_off':
        recording = hard_cases.with_model_error(recording, field, rng)
    radius = trial.scenario.tip_radius
    if radius > 0.0:
        recording = with_ball_tip(recording, *surface(trial.case.bone), patch.approach, radius)
    return Problem(trial, field.for_tip(radius), recording, patch)


def _models(case: Case, scenario: Scenario, cases: Sequence[Case]) -> list[str]:
    """Return the meshes from which the model is chosen, in order; none: the trial is impossible."""
    if scenario.hard == 'other_bone':
        return sorted({c.bone for c in cases if c.kind != case.kind})
    same = [c for c in cases if c.kind == case.kind and c.bone != case.bone]
    if scenario.hard == 'other_person':
        return sorted({c.bone for c in same if c.person != case.person})
    if scenario.hard == 'other_scan':
        return sorted({c.bone for c in same if (c.person, c.side) == (case.person, case.side)})
    return [case.bone]
