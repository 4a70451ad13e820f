# SPDX-License-Identifier: Apache-2.0
"""
A recording through the same session as the node's, without ROS or waiting.

The same bits every time.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Rejection, Sample
from gsdf_registration.field import Field
from gsdf_registration.session import LandmarkPairs, Session
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.point_transformer import PointTransformer

if TYPE_CHECKING:
    from msg_adapters.recording import Recording

_log = logging.getLogger('gsdf_registration')


def replay(recording: Recording, field: Field, config: Config | None = None,
           landmarks: LandmarkPairs | None = None,
           T_tracker_bone: Array | None = None) -> tuple[RegistrationResult, Session]:
    """
    Collect every point of a recording in its order, then register.

    Where its clock goes back, as when a recording in a loop was recorded, a new session begins.

    Parameters
    ----------
    recording : Recording
        With stamps.  Where it numbers strokes, each change of the number ends one and starts the
        next.  With ``reference.topic`` its `Recording.motions` must hold the poses of the array.
    field : Field
    config : Config, optional
    landmarks : ((k, 3), (k, 3)) float, optional
        Model and tracker positions, m.
    T_tracker_bone : (4, 4) float, optional
        A first guess.

    Returns
    -------
    RegistrationResult, Session

    Raises
    ------
    InputError
        When the recording has no stamps.

    """
    session = collected(recording, field, config)
    return session.register(landmarks, T_tracker_bone), session


def collected(recording: Recording, field: Field, config: Config | None = None) -> Session:
    """Return a session that has collected a recording; arguments and errors as of `replay`."""
    if recording.stamps is None:
        raise InputError(
            'the recording has no stamps, so it cannot be replayed; register its points instead')
    session = Session(config or Config(), field)
    session.collect(True)
    _play(recording, PointTransformer(config or Config(), _Collecting(session), Frames()),
          recording.stamps.tolist())
    session.count_dropped(recording.dropped)
    return session


class _Collecting:
    """Puts what it is fed into a session, as the node does."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._stroke: int | None = None

    def take(self, sample: Sample) -> None:
        if self._stroke not in (None, sample.stroke):
            self._session.collect(True)
        self._stroke = sample.stroke
        self._session.add_point(sample.stamp, sample.position, sample.frame_id, sample.source,
                                quality=sample.quality)

    def refuse(self, sample: Sample, cause: Rejection) -> None:
        self._session.count_dropped({cause.value: 1})

    def start_anew(self, why: str) -> None:
        _log.warning('what was collected before is dropped, for %s', why)
        self._session.clear()


def _play(recording: Recording, feed: PointTransformer, stamps: list[float]) -> None:
    """Feed points and motions in the order in which they were received."""
    names = recording.source_names
    positions, sources = recording.positions.tolist(), recording.sources.tolist()
    quality = [None] * len(stamps) if recording.quality is None else recording.quality.tolist()
    strokes = [0] * len(stamps) if recording.strokes is None else recording.strokes.tolist()
    motions = iter([*recording.motions, None])
    motion = next(motions)
    for row in range(len(stamps) + 1):
        while motion is not None and motion.after <= row:
            if motion.child:
                feed.transform(motion.parent, motion.child, motion.stamp, motion.T_parent_child,
                               motion.fixed)
            else:
                feed.pose(motion.stamp, motion.T_parent_child, motion.parent)
            motion = next(motions)
        if row < len(stamps):
            feed.point(Sample(stamps[row], positions[row], recording.frame_ids[row],
                              names[sources[row]], quality=quality[row], stroke=strokes[row]))
    feed.end()
    if feed.trouble:
        _log.warning('%s', feed.trouble)
