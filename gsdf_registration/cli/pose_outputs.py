# SPDX-License-Identifier: Apache-2.0
"""Write the pose and the points for other programs: 3D Slicer, tf2, CRTK."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from gsdf_registration.cli.landmark_files import Axes
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.landmarks import Landmarks
    from gsdf_registration.common.result import RegistrationResult
    from gsdf_registration.common.rigid import Array
    from msg_adapters.slicer import PointList

OPTIONS = ('slicer', 'markups', 'tf2', 'crtk')
TRACKER = 'tracker'     # frame of points whose frame is not known


def check_pose_outputs(args: argparse.Namespace, several: bool = False) -> None:
    """
    Raise `InputError`, before any work is done, if a file cannot be written as it is asked for.

    ``several``: whether more than one recording is registered.
    """
    from msg_adapters.slicer import check_point_list_path
    from msg_adapters.slicer_transform import check_transform_path
    given = next((name for name in OPTIONS if getattr(args, name)), None)
    if several and given:
        raise InputError(f'--{given} is for one recording; give one BAG or leave out --{given}')
    if args.slicer:
        check_transform_path(args.slicer)
    if args.markups:
        check_point_list_path(args.markups)


@dataclass(frozen=True)
class PoseOutputs:
    """The files of one registration, None for those that were not asked for, and their axes."""

    axes: Axes
    slicer: str | None = None
    markups: str | None = None
    tf2: str | None = None
    crtk: str | None = None

    @classmethod
    def of(cls, args: argparse.Namespace, axes: Axes) -> PoseOutputs:
        """Return the files of the options; ``axes`` of model and tracker."""
        return cls(axes, **{name: getattr(args, name) for name in OPTIONS})

    def write(self, result: RegistrationResult, config: Config, frame_id: str, points: Array,
              landmarks: Landmarks | None) -> None:
        """
        Write the files; without a pose, only the points.

        Parameters
        ----------
        result : of the registration
        config : with the frame of the bone
        frame_id : of the points; empty: not known
        points : (n, 3) m, those that were registered
        landmarks : that were touched; None: there are none

        """
        from msg_adapters.pose_file import write_pose, write_static_transform
        from msg_adapters.slicer import write_point_lists
        from msg_adapters.slicer_transform import write_transform
        T, frame = result.T_tracker_bone, frame_id or TRACKER
        if self.markups:
            write_point_lists(self.markups, _point_lists(points, landmarks), self.axes.tracker)
        if self.slicer and T is not None:
            write_transform(self.slicer, T, self.axes.model, self.axes.tracker)
        if self.tf2 and T is not None:
            write_static_transform(self.tf2, T, frame, config.bone_frame)
        if self.crtk and T is not None:
            write_pose(self.crtk, T, frame)


def _point_lists(points: Array, landmarks: Landmarks | None) -> list[PointList]:
    """Return the registered points, and the touched landmarks if there are any."""
    from msg_adapters.slicer import PointList
    lists = [PointList('points', [f'P-{i + 1}' for i in range(len(points))], points)]
    if landmarks is not None:
        lists.insert(0, PointList('landmarks', list(landmarks.names), landmarks.touched))
    return lists
