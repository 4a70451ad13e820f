# SPDX-License-Identifier: Apache-2.0
"""
Searches for a fixed point that an operator starts and ends: tip of the probe, centre of a joint.

The poses are used as they are received, in the frame of the tracker.  While a search runs, the tip
is not on the bone, and its samples are not collected.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import MAX_COORDINATE, Array, quaternion_from_rotation
from gsdf_registration.common.samples import Rejection, Sample
from gsdf_registration.common.tool_pose import is_valid, normalized
from gsdf_registration.session.landmark_capture import Answer, CapturedLandmark
from gsdf_registration.session.pose_recorder import PoseRecorder
from gsdf_registration.tracking.pivot import (
    JOINT,
    FixedPoint,
    PivotReason,
    calibrate_pivot,
    find_joint_centre,
)
from gsdf_registration.tracking.pivot_poses import rigid_rows

# m, standard deviation of a joint centre on the model: picked, or the centre of a fitted sphere
PLACE = 0.002
FARTHEST = 20.0     # m; the volumes of trackers end before


class CalibrationKind(Enum):
    """What is searched for; the value is the name of the service."""

    TIP = 'calibrate_tip'
    JOINT_CENTRE = 'find_joint_centre'

    @property
    def sentence(self) -> str:
        """What runs, and what the operator does."""
        if self is CalibrationKind.TIP:
            return 'calibrating the tip: keep it in a divot and tilt the tool to all sides'
        return 'searching for the joint centre: hold the other bone still and swing the limb'


class CalibrationProgress(NamedTuple):
    """A search that runs: what it searches for, how many poses it has, how far they turn."""

    kind: CalibrationKind
    poses: int
    angle: float        # rad

    @property
    def sentence(self) -> str:
        """What runs, how much was received, and how it ends."""
        return (f'{self.kind.sentence}, then call ~/{self.kind.value} again; {self.poses} poses so '
                f'far, turned by {math.degrees(self.angle):.0f} deg; no points are collected '
                'meanwhile')


class Calibration:
    """The poses received since the start of a search; not thread-safe."""

    def __init__(self, kind: CalibrationKind) -> None:
        self.kind = kind
        self.array = PoseRecorder()                     # of the reference array
        self._tools: dict[str, PoseRecorder] = {}       # by topic and frame

    def take(self, sample: Sample) -> Rejection | None:
        """Use a sample; return under which cause it is counted, or None if it is not used."""
        if self.kind is CalibrationKind.JOINT_CENTRE:
            return Rejection.CALIBRATING
        if sample.tool is None:
            return None
        if not all(abs(value) < MAX_COORDINATE for value in sample.position):
            return Rejection.NOT_FINITE
        if not is_valid(sample.tool):
            return Rejection.BAD_QUATERNION
        recorder = self._tools.setdefault(f'{sample.topic} {sample.frame_id}', PoseRecorder())
        recorder.add(sample.stamp, normalized(sample.tool))
        return Rejection.CALIBRATING

    def add_reference_pose(self, stamp: float, T: Array) -> None:
        """Use a pose (4, 4), m, of the reference array, if it is one."""
        if math.isfinite(stamp) and rigid_rows(T[None])[0]:
            x, y, z = T[:3, 3].tolist()
            qx, qy, qz, qw = quaternion_from_rotation(T[:3, :3]).tolist()
            self.array.add(stamp, (x, y, z, qx, qy, qz, qw))

    @property
    def turned(self) -> PoseRecorder:
        """The poses of the body that is turned; of several tools, the one that turned most."""
        if self.kind is CalibrationKind.JOINT_CENTRE:
            return self.array
        return max(self._tools.values(), key=lambda each: each.angle, default=PoseRecorder())

    @property
    def progress(self) -> CalibrationProgress:
        """How much was received."""
        turned = self.turned
        return CalibrationProgress(self.kind, len(turned), turned.angle)

    def solve(self, max_gap: float) -> FixedPoint:
        """
        Return the fixed point.

        A divot may be on the reference array, which moves: if no point of the tool stays still in
        the frame of the tracker, the poses are used in the frame of the array.  ``max_gap``, s: see
        `PoseRecorder.seen_from`.
        """
        turned = self.turned
        if not len(turned):
            what = ('no pose of a tool has arrived: set probe.topics to topics with poses of the '
                    'tool' if self.kind is CalibrationKind.TIP else
                    'no pose of the reference array has arrived: is it in view?')
            return FixedPoint(PivotReason.TOO_FEW_POSES, what)
        T = turned.matrices()
        farthest = float(np.abs(T[:, :3, 3]).max())
        if farthest > FARTHEST:
            return FixedPoint(PivotReason.WRONG_UNIT, f'the poses are up to {farthest:.0f} m from '
                              'the origin of the tracker: their driver must publish metres, not mm')
        if self.kind is CalibrationKind.JOINT_CENTRE:
            return find_joint_centre(T, turned.stamps)
        found = calibrate_pivot(T, turned.stamps)
        if not found.success and len(self.array):
            stamps, T = turned.seen_from(self.array, max_gap)
            on_array = calibrate_pivot(T, stamps)
            return on_array if on_array.success else found
        return found


def answer_of(found: FixedPoint, where: str) -> Answer:
    """Return the answer on a fixed point; its detail is the point. ``where``: whose frame."""
    if found.point is None or found.covariance is None or found.residual_rms is None:
        return Answer(False, f'{found.reason}: {found.message}')
    deviations = np.sqrt(np.diag(found.covariance[:3, :3]))
    return Answer(True, f'{found.message}; at {_millimetres(found.point, 2)} mm in the frame of '
                  f'{where}, standard deviation {_millimetres(deviations, 3)} mm, residual '
                  f'{1e3 * found.residual_rms:.2f} mm RMS', found)


def joint_landmark(found: FixedPoint, stamp: float, config: Config) -> CapturedLandmark:
    """
    Return a joint centre as a landmark; ``stamp``, s: of the last pose.

    Its standard deviation combines that of the data, the effect of an error that varies with the
    orientation (`Task.systematic`, taken as two standard deviations), and that of its place on the
    model: the entry in ``landmarks.sigmas``, or `PLACE` if that list is empty.  With an entry of 0
    the joint centre is only part of the initial guess.
    """
    assert found.point is not None and found.covariance is not None
    name = config.landmarks.joint_centre
    row = 3 * config.landmarks.names.index(name)
    place = config.landmarks.sigma_of(name) if config.landmarks.sigmas else PLACE
    variance = place**2 + float(np.trace(found.covariance[:3, :3])) / 3.0
    variance += (0.5 * JOINT.systematic)**2 / max(found.constraint or 0.0, 1e-12)
    return CapturedLandmark(name, np.array(config.landmarks.positions[row:row + 3]), found.point,
                            found.residual_rms or 0.0, stamp,
                            sigma_m=math.sqrt(variance) if place > 0.0 else 0.0)


def _millimetres(vector: Array, digits: int) -> str:
    return '[' + ', '.join(f'{1e3 * value:.{digits}f}' for value in vector) + ']'
