# SPDX-License-Identifier: Apache-2.0
"""One trial: the condyles of a femur are touched, with and without the centre of the hip joint."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from benchmarks.execution.result_table import Row
from benchmarks.protocol.cases import Case, bone, region_patch
from benchmarks.protocol.trials import POINTS
from benchmarks.trust.trial import LENIENT
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.joint_centre import JointCentre, find_hip_centre
from gsdf_registration.registration.motions import moved
from gsdf_registration.registration.pipeline import register
from gsdf_registration.simulation.probe import Tracker, random_pose, simulate_scan
from gsdf_registration.simulation.surface_errors import displaced, smooth_error

REGION = 'condyles'
NOISE = 5e-4            # m, of a point per axis
ERROR_LENGTH = 0.015    # m, over which the error of the model is correlated
GUESS = (0.04, 0.002)   # rad, m, standard deviation per axis of the initial guess
# accept every pose, and search briefly: the question is how accurate the pose is
SETTINGS = {**LENIENT, 'search.rotations': 10, 'search.places': 5, 'search.parts': 0,
            'search.threads': 1}


@dataclass(frozen=True)
class HipTrial:
    """
    A femur, the errors of its model and of the hip centre, and a seed.

    model_error : m, standard deviation of the error of the model along the normal
    sigma : m, standard deviation of the hip centre along each axis
    mistake : m, by which the hip centre is off besides; 0: none
    """

    case: Case
    model_error: float
    sigma: float
    seed: int
    mistake: float = 0.0

    @property
    def scenario(self) -> str:
        """Return the errors in words."""
        wrong = f', {1e3 * self.mistake:g} mm mistake' if self.mistake else ''
        model = f'{1e3 * self.model_error:g} mm off' if self.model_error else 'exact'
        return f'model {model}, hip centre {1e3 * self.sigma:.3g} mm{wrong}'

    @property
    def name(self) -> str:
        """Return bone/scenario/seed."""
        return f'{self.case.name}/{self.scenario}/{self.seed}'


@lru_cache(maxsize=16)
def hip_centre(path: str) -> JointCentre:
    """Return the hip centre of a mesh, mm."""
    return find_hip_centre(bone(path))


def run_trial(trial: HipTrial, config: Config) -> Row:
    """Return the errors with and without the hip centre; SI units."""
    rng = np.random.default_rng([trial.seed, zlib.crc32(trial.case.name.encode())])
    field, patch = bone(trial.case.bone), region_patch(trial.case.bone, REGION)
    recording = simulate_scan(patch, int(rng.integers(*POINTS)), rng, tracker=Tracker(sigma=NOISE),
                              T_tracker_bone=random_pose(rng))
    shift = smooth_error(recording.tips, trial.model_error, ERROR_LENGTH, rng)
    recording = displaced(recording, shift[:, None] * field.sample(recording.tips)[1])
    T = recording.T_tracker_bone
    centre = hip_centre(trial.case.bone).centre
    off = rng.normal(size=3)
    touched = (rigid.transform(T, centre) + trial.sigma * rng.normal(size=3)
               + trial.mistake * off / np.linalg.norm(off))
    hip = Landmarks.of([centre], [touched], [trial.sigma], ['hip_centre'])
    middle = patch.centre
    guess = T @ moved(np.concatenate([GUESS[0] * rng.normal(size=3),
                                      GUESS[1] * rng.normal(size=3)]), middle)
    lenient = config.replaced(SETTINGS)
    alone, fused = (register(recording.positions, field, lenient, landmarks=landmarks,
                             T_tracker_bone=guess) for landmarks in (None, hip))
    surface = field.surface_points.astype(np.float64)
    fit = fused.landmarks[0]
    return {'case': trial.case.name, 'scenario': trial.scenario, 'seed': trial.seed,
            **_errors('alone', alone, T, surface), **_errors('fused', fused, T, surface),
            'deviations': fit.deviations, 'landmark_used': fit.used,
            'solve_s': alone.timing_s['solve'], 'fused_solve_s': fused.timing_s['solve']}


def _errors(which: str, result: RegistrationResult, T_true: Array, surface: Array) -> Row:
    """Return true and predicted TRE over the bone, and e^T C^-1 e of the pose, expected to be 6."""
    assert result.T_tracker_bone is not None and result.covariance is not None, result.message
    T = result.T_tracker_bone
    tre = rigid.displacement(T, T_true, surface)
    e = np.concatenate([T[:3, 3] - T_true[:3, 3],
                        rigid.rotation_log(T[:3, :3] @ T_true[:3, :3].T)])
    scale = np.sqrt(np.diag(result.covariance))
    nees = (e / scale) @ np.linalg.solve(result.covariance / np.outer(scale, scale), e / scale)
    return {f'{which}_tre_m': rigid.rms(tre), f'{which}_max_m': float(tre.max()),
            f'{which}_predicted_m': result.predicted_tre_m['rms'], f'{which}_nees': float(nees)}
