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
from gsdf_registration.simulation.tool_motion import Tool, carried
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
    T_array_bone = inverse(sway.T_tracker_body) @ T_tracker_bone
    if plan.pivoting > 0.0:
        turned = pivoting(rng, plan.pivoting, tracker.rate, noise=EXACT, tip=plan.tool.tip)
        recorder.call_around('calibrate_tip', turned.stamps)
        recorder.record('pivoting', turned.stamps, turned.T_tracker_body)
    if plan.swinging > 0.0:
        assert hip_centre is not None
        swing = leg_swing(rng, plan.swinging, tracker.rate,
                          noise=replace(EXACT, wander=HIP_MOTION),
                          hip_centre=transform(T_array_bone, hip_centre),
                          place=transform(T_tracker_bone, hip_centre),
                          mean=sway.T_tracker_body[:3, :3])
        recorder.call_around('find_joint_centre', swing.stamps)
        recorder.record_swing(swing.stamps, swing.T_tracker_body)
    exact = replace(tracker, sigma=0.0, distortion=0.0, dropouts=0.0)
    distance = BallContact(bone.vertices, bone.faces).distance
    touches = simulate_landmarks(landmarks, rng, tracker=exact, T_tracker_bone=T_tracker_bone)
    strokes = bone.touched(simulate_scan(
        bone.patch, plan.points, rng, tracker=exact, interference=plan.interference,
        hand=plan.hand, T_tracker_bone=T_tracker_bone), rng)
    for name, recording in (('landmarks', touches), ('strokes', strokes)):
        if not len(recording.stamps):
            continue
        motion = carried(recording, bone.patch, distance, tracker.rate, rng, plan.tool)
        for k in range(len(landmarks) if name == 'landmarks' else 0):
            first = float(recording.stamps[recording.strokes == k][0])
            recorder.call('capture_landmark', first + REACTION)
        if name == 'strokes':
            recorder.call_around('collect', motion.stamps, (True, False))
        recorder.record(name, motion.stamps, motion.T_bone_tool, T_array_bone)
    recorder.call('register', 0.0)
    places = np.array([touches.tips[touches.strokes == k].mean(axis=0)
                       for k in range(len(landmarks))]).reshape(-1, 3)
    return Operation(recorder.probe, recorder.arrays(), tuple(recorder.calls), T_array_bone,
                     transform(T_array_bone, places), np.array(PIVOT_PLACE), strokes)


class _Recorder:
    """What the tracker reports of one part after another."""

    def __init__(self, plan: Plan, sway: Sway, rng: np.random.Generator) -> None:
        self._plan, self._sway, self._rng = plan, sway, rng
        self._start = PAUSE
        self.probe: dict[str, Poses] = {}
        self._still: list[Poses] = []
        self._swing: Poses | None = None
        self.calls: list[Call] = []

    def call(self, service: str, stamp: float, data: bool | None = None) -> None:
        """Add a call at a time since the start of the part."""
        self.calls.append(Call(round(self._start + stamp, 6), service, data))

    def call_around(self, service: str, stamps: Array,
                    data: tuple[bool | None, bool | None] = (None, None)) -> None:
        """Add a call half a second before the first and after the last of ``stamps``."""
        for stamp, value in zip((float(stamps[0]) - 0.5, float(stamps[-1]) + 0.5), data):
            self.call(service, stamp, value)

    def record(self, name: str, stamps: Array, T: Array, T_array_bone: Array | None = None) -> None:
        """Record poses of the probe in the frame of the tracker, or of the bone, and the array."""
        frames = self._start + stamps
        T_tracker_array = np.array([self._sway.pose(stamp) for stamp in frames])
        if T_array_bone is not None:
            T = T_tracker_array @ T_array_bone @ T
        probe_seen, array_seen = received(frames, 2, self._plan.tracker.rate, self._plan.losses,
                                          self._rng)
        self.probe[name] = self._measured(frames, T, probe_seen)
        self._still.append(self._measured(frames, T_tracker_array, array_seen))
        self._start += float(stamps[-1]) + PAUSE

    def record_swing(self, stamps: Array, T: Array) -> None:
        """Record poses of the array that swings with the leg."""
        seen, = received(stamps, 1, self._plan.tracker.rate, self._plan.losses, self._rng)
        self._swing = self._measured(self._start + stamps, T, seen)
        self._start += float(stamps[-1]) + PAUSE

    def arrays(self) -> dict[str, Poses]:
        """Return the poses of the array in each part."""
        still = Poses(*(np.concatenate([poses[i] for poses in self._still]) for i in range(2)))
        return {'still': still, **({} if self._swing is None else {'swinging': self._swing})}

    def _measured(self, stamps: Array, T: Array, seen: Array) -> Poses:
        """Return the poses with noise and distortion, as far as they are seen."""
        return Poses(stamps[seen], measured_poses(T, self._plan.tracker,
                                                  self._plan.orientation_noise, self._rng)[seen])
