# SPDX-License-Identifier: Apache-2.0
"""One registration of few points without and with the places where the probe was in the air."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from time import process_time

import numpy as np

from benchmarks.air.path import AirPath, measured_path
from benchmarks.execution.result_table import Row
from benchmarks.protocol import hard_cases
from benchmarks.protocol.cases import Case, bone, region_patch, surface
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config, GateConfig
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points, Rejection, Sample
from gsdf_registration.field import Field
from gsdf_registration.registration.pipeline import register
from gsdf_registration.session.air import Air, positions
from gsdf_registration.simulation.patch import Patch, exposed_patch
from gsdf_registration.simulation.probe import (
    Hand,
    SimulatedRecording,
    Tracker,
    random_pose,
    simulate_scan,
)

# minimum and maximum number of points: so few that several poses fit them
SCENARIOS = {'region': (100, 300), 'window': (100, 300), 'cup_only': (100, 400),
             'shaft_only': (200, 800)}
WINDOW = (0.022, 0.032)     # m, radius of a window
SIGMA = 5e-4                # m, noise per axis
HAND = Hand(stroke=0.02, speed=0.08)    # short strokes with few points
NEAR_TRUTH = 0.005          # m, maximum error at the touched points of a right pose (RMS)
# faults of a badly calibrated and badly tracked probe
TIP_ERROR, SHAFT_ERROR = 0.001, np.radians(3.0)     # m and rad, of the whole recording
GLITCHES, GLITCH = 0.01, 0.1    # share of the poses in the air, and m, by which they are off
SHAFT = [0.0, 0.0, 1.0]     # in the frame of the tool
RATE = 80.0                 # Hz
EVIDENCE = ('none', 'tip', 'shaft', 'faulty')


@dataclass(frozen=True)
class AirTrial:
    """A bone and region, a scenario of `SCENARIOS`, and a seed."""

    case: Case
    scenario: str
    seed: int

    @property
    def name(self) -> str:
        """Return bone/region/scenario/seed."""
        return f'{self.case.name}/{self.scenario}/{self.seed}'


def suits(scenario: str, region: str) -> bool:
    """Return whether the scenario is possible in a region; a shaft counts for one region only."""
    return region in {'cup_only': ('acetabulum',),
                      'shaft_only': ('proximal_femur', 'proximal_tibia')}.get(scenario, (region,))


def run_trial(trial: AirTrial, config: Config) -> Row:
    """Return the row of a trial: for each kind of evidence the verdict and the time, s of CPU."""
    words = (zlib.crc32(word.encode()) for word in (trial.case.name, trial.scenario))
    rng = np.random.default_rng(np.random.SeedSequence([trial.seed, *words]))
    field, patch = bone(trial.case.bone), _patch(trial, rng)
    tracker, T = Tracker(sigma=SIGMA), random_pose(rng)
    count = int(rng.integers(*SCENARIOS[trial.scenario]))
    recording = simulate_scan(patch, count, rng, tracker=tracker, hand=HAND, T_tracker_bone=T)
    path = measured_path(recording, patch, field, rng, tracker)
    faulty = _with_faults(path, recording, rng)
    air = {'tip': _recorded(path, recording, []),
           'shaft': _recorded(path, recording, SHAFT),
           'faulty': _recorded(faulty, recording, SHAFT)}
    row: Row = {'scenario': trial.scenario, 'points': len(recording.positions)}
    without = found = _verdict(recording, field, config, None)
    for kind in EVIDENCE:
        if kind != 'none' and without['reason'] == 'ambiguous':     # else the air is not used
            found = _verdict(recording, field, config, air[kind])
        row |= {f'{kind}_{key}': value for key, value in found.items()}
    return row


def _patch(trial: AirTrial, rng: np.random.Generator) -> Patch:
    """Return the exposed area of a trial."""
    path, region = trial.case.bone, region_patch(trial.case.bone, trial.case.region)
    if trial.scenario == 'cup_only':
        return hard_cases.cup(*surface(path), region, rng)
    if trial.scenario == 'shaft_only':
        return hard_cases.shaft(*surface(path), rng)
    if trial.scenario == 'region':
        return region
    middles = region.corners.mean(axis=1)
    while True:     # until the window is not on a spike with hardly any triangles
        try:
            return exposed_patch(*surface(path), middles[rng.integers(len(middles))],
                                 rng.uniform(*WINDOW), region.approach)
        except InputError:
            pass


def _recorded(path: AirPath, recording: SimulatedRecording, shaft: list[float]) -> Array:
    """Return the positions in the air that a session records, with the direction of the shaft."""
    touching = recording.strokes
    order = np.argsort(np.concatenate([touching, path.strokes]), kind='stable')
    tools = np.concatenate([_tools(recording.positions, path.touching_shafts),
                            _tools(path.tips, path.shafts)])
    on_bone = np.arange(len(tools)) < len(touching)
    air = Air()
    for tick, row in enumerate(order.tolist()):
        x, y, z, qx, qy, qz, qw = tools[row].tolist()
        sample = Sample(tick / RATE, (x, y, z), '', '', tool=(x, y, z, qx, qy, qz, qw))
        rejection = None if on_bone[row] else Rejection.NOT_COLLECTING
        air.add(sample, 0, rejection, GateConfig())
    count = len(touching)
    points = Points(recording.positions, recording.stamps, touching, np.zeros(count, np.int32),
                    tools[:count])
    return positions(air.rows, points, [], shaft)


def _tools(tips: Array, shafts: Array) -> Array:
    """Return poses (n, 7) of a tool with its tip at the origin and its shaft along z."""
    x, y, z = shafts.T
    quaternions = np.column_stack([-y, x, np.zeros(len(x)), 1.0 + z])
    return np.column_stack([tips, quaternions / np.linalg.norm(quaternions, axis=1)[:, None]])


def _with_faults(path: AirPath, recording: SimulatedRecording,
                 rng: np.random.Generator) -> AirPath:
    """Return the path of a probe whose tip and shaft are off, with wrong readings."""
    off = TIP_ERROR * _directions(1, rng)
    tilt = SHAFT_ERROR * rng.normal(size=3) / np.sqrt(3.0)
    wrong = rng.random(len(path.tips)) < GLITCHES
    jumps = wrong[:, None] * GLITCH * _directions(len(path.tips), rng)
    shafts = np.where(wrong[:, None], _directions(len(path.tips), rng), path.shafts)
    R = rigid.rotation_exp(tilt)
    return replace(path, tips=path.tips + off + jumps, shafts=shafts @ R.T,
                   touching_shafts=path.touching_shafts @ R.T)


def _directions(count: int, rng: np.random.Generator) -> Array:
    """Return random unit vectors (count, 3)."""
    vectors = rng.normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def _verdict(recording: SimulatedRecording, field: Field, config: Config,
             air: Array | None) -> Row:
    """Register, and return the verdict, the reason and the time."""
    started = process_time()    # of this process: the machine may be busy
    result = register(recording.positions, field, config, air=air)
    seconds = process_time() - started
    verdict = 'refused'
    if result.T_bone_tracker is not None:
        touched = recording.tips[recording.on_bone]
        motion = result.T_bone_tracker @ recording.T_tracker_bone
        error = rigid.rms_displacement(motion, np.eye(4), touched)
        verdict = 'right' if error < NEAR_TRUTH else 'wrong'
    return {'verdict': verdict, 'reason': str(result.reason),
            'seconds': seconds}
