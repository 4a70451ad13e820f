# SPDX-License-Identifier: Apache-2.0
"""
Simulate what a tracker reports in an operation: the poses of the probe and of the reference array.

The probe is turned in a divot, the leg is swung, landmarks are touched and strokes are made, while
the patient moves. The calls of the operator are known with their times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.simulation.ball_tip import BallContact
from gsdf_registration.simulation.distortion import Distortion
from gsdf_registration.simulation.interference import NONE, Interference
from gsdf_registration.simulation.losses import Losses, received
from gsdf_registration.simulation.moving import Sway
from gsdf_registration.simulation.pivoting import PIVOT_PLACE, PoseNoise, leg_swing, pivoting
from gsdf_registration.simulation.probe import (
    REAL_HAND,
    Hand,
    SimulatedRecording,
    Tracker,
    measured_poses,
    simulate_landmarks,
    simulate_scan,
)
from gsdf_registration.simulation.tool_motion import Tool, ToolMotion, carried
from gsdf_registration.simulation.touched_bone import TouchedBone

PAUSE = 2.0             # s, between two parts
REACTION = 0.8          # s after which a landmark is captured
EXACT = PoseNoise(position=0.0, orientation=0.0)
HIP_MOTION = 0.0015     # m per axis, standard deviation of the centre of the hip while a leg swings


@dataclass(frozen=True)
class Plan:
    """
    What is done and how it is recorded.

    points : samples on the bone in strokes
    pivoting, swinging : s; 0: not done
    tracker : its drop-outs are those of ``losses``
    orientation_noise : rad per axis, standard deviation
    losses : of the probe and of the array
    """

    points: int = 600
    pivoting: float = 0.0
    swinging: float = 0.0
    tracker: Tracker = Tracker()
    orientation_noise: float = np.radians(0.1)
    losses: Losses = Losses()
    hand: Hand = REAL_HAND
    interference: Interference = NONE
    tool: Tool = Tool()


class Call(NamedTuple):
    """A call of a service of the node: its time, s, its name, and its argument if it has one."""

    stamp: float
    service: str
    data: bool | None = None


class Poses(NamedTuple):
    """Poses of a body as reported: stamps (n,) s and T_tracker_body (n, 4, 4) m."""

    stamps: Array
    T_tracker_body: Array


@dataclass(frozen=True, eq=False)
class Operation:
    """
    A simulated operation with its ground truth.

    probe : poses of the tool in each part, by name: pivoting, landmarks, strokes
    array : poses of the reference array in each part: still, swinging
    calls : of the operator, in order
    T_array_bone : (4, 4), m
    landmarks : (k, 3) m, points that were touched, frame of the array
    pivot : (3,) m, tracker frame
    strokes : true positions of the tip in the strokes
    """

    probe: dict[str, Poses]
    array: dict[str, Poses]
    calls: tuple[Call, ...]
    T_array_bone: Array
    landmarks: Array
    pivot: Array
    strokes: SimulatedRecording


def simulate_operation(bone: TouchedBone, plan: Plan, sway: Sway, T_tracker_bone: Array,
                       landmarks: Array, rng: np.random.Generator,
                       hip_centre: Array | None = None) -> Operation:
    """
    Simulate an operation.

    Parameters
    ----------
    bone : TouchedBone
    plan : Plan
    sway : Sway
        The motion of the reference array, and of the bone with it.
    T_tracker_bone : (4, 4) m, when the array is at its mean pose
    landmarks : (k, 3) float, m, bone frame
    rng : numpy Generator; the same state gives the same operation
    hip_centre : (3,) float, m, bone frame; needed to swing the leg

    """
    tracker = plan.tracker
    if not isinstance(tracker.distortion, Distortion):
        tracker = replace(tracker, distortion=Distortion.random(tracker.distortion, rng))
    recorder = _Recorder(replace(plan, tracker=tracker), sway, rng)
    if plan.pivoting > 0.0:
        recorder.turn_in_divot()
    T_array_bone = inverse(sway.T_tracker_body) @ T_tracker_bone
    if plan.swinging > 0.0:
        if hip_centre is None:
            raise InputError('the centre of the hip is needed to swing the leg')
        recorder.swing_leg(T_array_bone, hip_centre)
    exact = replace(tracker, sigma=0.0, distortion=0.0, dropouts=0.0)
    touches = simulate_landmarks(landmarks, rng, tracker=exact, T_tracker_bone=T_tracker_bone)
    strokes = bone.touched(simulate_scan(
        bone.patch, plan.points, rng, tracker=exact, interference=plan.interference,
        hand=plan.hand, T_tracker_bone=T_tracker_bone), rng)
    distance = BallContact(bone.vertices, bone.faces).distance
    firsts = [int(np.argmax(touches.strokes == k)) for k in range(len(landmarks))]
    if firsts:
        recorder.call_at('capture_landmark', touches.stamps[firsts] + REACTION)
        recorder.record('landmarks', carried(touches, bone.patch, distance, tracker.rate, rng,
                                             plan.tool), T_array_bone)
    motion = carried(strokes, bone.patch, distance, tracker.rate, rng, plan.tool)
    recorder.call_around('collect', motion.stamps, (True, False))
    recorder.record('strokes', motion, T_array_bone)
    recorder.call_at('register', np.zeros(1))
    return Operation(recorder.probe, recorder.array, tuple(recorder.calls), T_array_bone,
                     transform(T_array_bone, touches.tips[firsts]), np.array(PIVOT_PLACE), strokes)


class _Recorder:
    """What the tracker reports of one part after another."""

    def __init__(self, plan: Plan, sway: Sway, rng: np.random.Generator) -> None:
        self._plan, self._sway, self._rng = plan, sway, rng
        self._start = PAUSE
        self.probe: dict[str, Poses] = {}
        self.array: dict[str, Poses] = {}
        self.calls: list[Call] = []

    def call_at(self, service: str, stamps: Array) -> None:
        """Add calls at times since the start of the part."""
        self.calls += [Call(round(self._start + float(stamp), 6), service) for stamp in stamps]

    def call_around(self, service: str, stamps: Array,
                    data: tuple[bool | None, bool | None] = (None, None)) -> None:
        """Add a call half a second before the first and after the last of ``stamps``."""
        for stamp, value in zip((float(stamps[0]) - 0.5, float(stamps[-1]) + 0.5), data):
            self.calls.append(Call(round(self._start + stamp, 6), service, value))

    def turn_in_divot(self) -> None:
        """Record poses of the probe alone: the divot is not near the patient."""
        plan = self._plan
        turned = pivoting(self._rng, plan.pivoting, plan.tracker.rate, noise=EXACT,
                          tip=plan.tool.tip)
        self.call_around('calibrate_tip', turned.stamps)
        self.probe['pivoting'], = self._reported(turned.stamps, turned.T_tracker_body)

    def swing_leg(self, T_array_bone: Array, hip_centre: Array) -> None:
        """Record poses of the array alone."""
        plan, T = self._plan, self._sway.T_tracker_body
        place = transform(T_array_bone, hip_centre)
        swing = leg_swing(self._rng, plan.swinging, plan.tracker.rate,
                          noise=replace(EXACT, wander=HIP_MOTION), hip_centre=place,
                          place=transform(T, place), mean=T[:3, :3])
        self.call_around('find_joint_centre', swing.stamps)
        self.array['swinging'], = self._reported(swing.stamps, swing.T_tracker_body)

    def record(self, name: str, motion: ToolMotion, T_array_bone: Array) -> None:
        """Record poses of the probe on the bone, and of the array."""
        frames = self._start + motion.stamps
        T_tracker_array = np.array([self._sway.pose(stamp) for stamp in frames])
        probe, array = self._reported(motion.stamps, T_tracker_array @ T_array_bone
                                      @ motion.T_bone_tool, T_tracker_array)
        self.probe[name] = probe
        before = self.array.get('still')
        self.array['still'] = array if before is None else Poses(
            *(np.concatenate(both) for both in zip(before, array)))

    def _reported(self, stamps: Array, *bodies: Array) -> list[Poses]:
        """Return the poses (n, 4, 4) of each body that are seen, with noise and distortion."""
        plan, frames = self._plan, self._start + stamps
        seen = received(frames, len(bodies), plan.tracker.rate, plan.losses, self._rng)
        self._start += float(stamps[-1]) + PAUSE
        return [Poses(frames[rows], measured_poses(T, plan.tracker, plan.orientation_noise,
                                                   self._rng)[rows])
                for T, rows in zip(bodies, seen)]
