# SPDX-License-Identifier: Apache-2.0
"""
The way of a point into the frame of the session, at the time it was measured.

It leads through the frames of /tf to that of the tracker and from there, where the bone has a
reference array, into the frame of the array.
"""

from __future__ import annotations

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, inverse
from gsdf_registration.common.samples import Rejection
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.pose_buffer import LookupStatus, PoseBuffer


class FrameResolver:
    """
    Where the reference array and all frames were, and so the way; not thread-safe.

    config : may be replaced at any time
    frames : None where /tf is not heard
    """

    def __init__(self, config: Config, frames: Frames | None) -> None:
        self.config = config
        self.frames = frames
        self._array = PoseBuffer()
        self._array_frame = ''      # the frame its poses are in
        self._left_out = 0          # poses of it
        self._pose_trouble = ''

    def pose(self, stamp: float, T: Array, frame_id: str) -> None:
        """Take in a pose ``T`` (4, 4), m, of the reference array in ``frame_id``."""
        wanted = self._tracker_frame or frame_id
        refusal = (f'is in frame "{frame_id}" and not in "{wanted}"' if frame_id != wanted
                   else self._array.add(stamp, T))
        self._pose_trouble = refusal
        if refusal:
            self._left_out += 1
        else:
            self._array_frame = wanted

    def rewind(self, stamp: float) -> None:
        """Forget what is of the time before the clock went back to ``stamp``, s."""
        self._array.rewind(stamp)
        if self.frames is not None:
            self.frames.rewind(stamp)

    def motion(self, frame_id: str, stamp: float) -> Array | LookupStatus | None:
        """Return the motion (4, 4), m, that leads there; None if a point stays as it is."""
        max_gap, wanted = self.config.gate.max_age, self._tracker_frame
        T_tracker_given: Array | LookupStatus | None = None
        if wanted not in ('', frame_id):
            if self.frames is None:
                return LookupStatus.NEVER
            T_tracker_given = self.frames.at(wanted, frame_id, stamp, max_gap)
        if not self.config.reference.topic or isinstance(T_tracker_given, LookupStatus):
            return T_tracker_given
        T_tracker_array = self._array.at(stamp, max_gap)
        if isinstance(T_tracker_array, LookupStatus):
            return T_tracker_array
        T_array_tracker = inverse(T_tracker_array)
        return T_array_tracker if T_tracker_given is None else T_array_tracker @ T_tracker_given

    def failure_reason(self, frame_id: str, source: str, apart: float) -> tuple[Rejection, str]:
        """
        Return why no way was found for a point of ``source``, and a sentence on it.

        ``apart``: how far the stamps of points and poses are apart that come together, s; else 0.
        """
        wanted, topic = self._tracker_frame, self.config.reference.topic
        if wanted not in ('', frame_id) and not (self.frames
                                                 and self.frames.connect(wanted, frame_id)):
            tf = 'nothing on /tf leads there' if self.frames else '/tf needs tf2_msgs to be heard'
            return Rejection.WRONG_FRAME, (f'the points of {source} are in frame "{frame_id}" and '
                                           f'not in "{wanted}", and {tf}')
        if not topic:
            why = (f'/tf does not tell where "{frame_id}" was in "{wanted}" at the time of the '
                   f'points of {source}')
        elif apart:
            why = (f'the stamps of {source} and {topic} are {abs(apart):.1f} s apart: both must '
                   'come from one clock')
        else:
            why = (f'there is no pose on {topic} for the time of the points of {source}: is the '
                   'reference array in view?')
        if self._pose_trouble:
            why += f' Left out of its poses: {self._left_out}; the last {self._pose_trouble}'
        return Rejection.NO_REFERENCE, why

    @property
    def _tracker_frame(self) -> str:
        """Frame into which /tf must lead; empty: any will do."""
        return self.config.probe.frame_id or self._array_frame
