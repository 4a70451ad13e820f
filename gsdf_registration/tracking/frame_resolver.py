# SPDX-License-Identifier: Apache-2.0
"""
The motion of a point into the session frame at the time it was measured.

The frames of /tf lead to the tracker frame. If the bone has a reference array, the pose of the
array leads from there into the array frame.
"""

from __future__ import annotations

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, inverse
from gsdf_registration.common.samples import Rejection
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.pose_buffer import LookupStatus, PoseBuffer


class FrameResolver:
    """
    Looks up the poses of the reference array and the frames of /tf; not thread-safe.

    ``frames`` is None if /tf is not available.
    """

    def __init__(self, frames: Frames | None) -> None:
        self.frames = frames
        self._array = PoseBuffer()
        self._array_frame = ''      # frame of the array poses
        self._rejected_poses = 0
        self._pose_problem = ''     # why the last array pose was rejected

    @property
    def pose_rejected(self) -> bool:
        """Whether the last pose of the array was rejected."""
        return bool(self._pose_problem)

    def add_pose(self, stamp: float, T: Array, frame_id: str, config: Config) -> None:
        """Add a pose ``T`` (4, 4), m, of the reference array in ``frame_id``."""
        expected = self._tracker_frame(config) or frame_id
        self._pose_problem = (f'is in frame "{frame_id}" and not in "{expected}"'
                              if frame_id != expected else self._array.add(stamp, T))
        if self._pose_problem:
            self._rejected_poses += 1
        else:
            self._array_frame = expected

    def rewind(self, stamp: float) -> None:
        """Drop poses later than ``stamp``, s, to which the clock went back."""
        self._array.rewind(stamp)
        if self.frames is not None:
            self.frames.rewind(stamp)

    def motion(self, frame_id: str, stamp: float, config: Config) -> Array | LookupStatus | None:
        """Return the motion (4, 4), m, to the session frame; None if the point stays as it is."""
        max_gap, tracker = config.gate.max_age, self._tracker_frame(config)
        T_tracker_given: Array | LookupStatus | None = None
        if tracker not in ('', frame_id):
            if self.frames is None:
                return LookupStatus.NEVER
            T_tracker_given = self.frames.at(tracker, frame_id, stamp, max_gap)
        if not config.reference.topic or isinstance(T_tracker_given, LookupStatus):
            return T_tracker_given
        T_tracker_array = self._array.at(stamp, max_gap)
        if isinstance(T_tracker_array, LookupStatus):
            return T_tracker_array
        T_array_tracker = inverse(T_tracker_array)
        return T_array_tracker if T_tracker_given is None else T_array_tracker @ T_tracker_given

    def failure_reason(self, frame_id: str, topic: str, offset: float,
                       config: Config) -> tuple[Rejection, str]:
        """
        Return why a point of ``topic`` could not be transformed, and a sentence for the operator.

        ``offset``, s: between the stamps of points and array poses that arrive together, if their
        clocks differ; else 0.
        """
        tracker, array = self._tracker_frame(config), config.reference.topic
        if tracker not in ('', frame_id) and not (self.frames
                                                  and self.frames.connected(tracker, frame_id)):
            tf = ('/tf does not connect them' if self.frames
                  else '/tf cannot be received without tf2_msgs')
            return Rejection.WRONG_FRAME, (f'the points of {topic} are in frame "{frame_id}" and '
                                           f'not in "{tracker}", and {tf}')
        if not array:
            why = (f'/tf has no transform from "{frame_id}" to "{tracker}" at the time of the '
                   f'points of {topic}')
        elif offset:
            why = (f'the stamps of {topic} and {array} are {abs(offset):.1f} s apart: both must '
                   'come from one clock')
        else:
            why = (f'there is no pose on {array} at the time of the points of {topic}: is the '
                   'reference array in view?')
        if self._pose_problem:
            why += f' Rejected array poses: {self._rejected_poses}; the last {self._pose_problem}'
        return Rejection.NO_REFERENCE, why

    def _tracker_frame(self, config: Config) -> str:
        """Return the frame that /tf must lead to; empty: any frame is accepted."""
        return config.probe.frame_id or self._array_frame
