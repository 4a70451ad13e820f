# SPDX-License-Identifier: Apache-2.0
"""
Replay of a recording through the session that the node uses, without ROS and without waiting.

The result is the same to the bit every time.
"""

from __future__ import annotations

import logging
import math
from typing import Any

from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import InputError, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Sample
from gsdf_registration.field import Field
from gsdf_registration.session import Session, restart_notice
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.point_transformer import PointTransformer
from msg_adapters.recording import Recording

_log = logging.getLogger('gsdf_registration')


def replay(recording: Recording, field: Field, config: Config | None = None,
           landmarks: Landmarks | None = None,
           T_tracker_bone: Array | None = None) -> tuple[RegistrationResult, Session]:
    """
    Collect every point of a recording in order, then register.

    If its clock goes back, as in the recording of a looped playback, a new session is started.

    Parameters
    ----------
    recording : Recording
        With stamps.  If it numbers strokes, each change of the number starts a stroke.  With
        ``reference.topic`` its `Recording.transforms` must contain the poses of the array.
    field : Field
    config : Config, optional
    landmarks : Landmarks, optional
    T_tracker_bone : (4, 4) float, optional
        Start pose.

    Returns
    -------
    RegistrationResult, Session

    Raises
    ------
    InputError
        If the recording has no stamps.

    """
    session = collected(recording, field, config)
    return session.register(landmarks, T_tracker_bone), session


def collected(recording: Recording, field: Field, config: Config | None = None) -> Session:
    """Return a session with the points of a recording; arguments and errors as in `replay`."""
    if recording.stamps is None:
        raise InputError(
            'the recording has no stamps, so it cannot be replayed; register its points instead')
    session = Session(config or Config(), field)
    session.collect(True)
    session.listen(_log_restart)
    _play(recording, PointTransformer(session, Frames()), recording.stamps.tolist())
    session.count_rejected(recording.dropped)
    return session


def _log_restart(event: str, value: Any) -> None:
    if event == 'clear' and value:
        _log.warning('%s; the points before it are dropped', restart_notice(value))


def _play(recording: Recording, transformer: PointTransformer, stamps: list[float]) -> None:
    """Add points and transforms in the order in which they were received."""
    names = recording.source_names
    positions, sources = recording.positions.tolist(), recording.sources.tolist()
    quality = [None] * len(stamps) if recording.quality is None else recording.quality.tolist()
    strokes = [0] * len(stamps) if recording.strokes is None else recording.strokes.tolist()
    tools = [None] * len(stamps) if recording.tools is None else [
        None if all(math.isnan(value) for value in tool) else tuple(tool)
        for tool in recording.tools.tolist()]
    transforms = iter([*recording.transforms, None])
    pending = next(transforms)
    for row in range(len(stamps) + 1):
        while pending is not None and pending.after <= row:
            if pending.child:
                transformer.add_transform(pending.parent, pending.child, pending.stamp,
                                          pending.T_parent_child, pending.fixed)
            else:
                transformer.add_pose(pending.stamp, pending.T_parent_child, pending.parent)
            pending = next(transforms)
        if row < len(stamps):
            transformer.add_point(Sample(
                stamps[row], tuple(positions[row]), recording.frame_ids[row], names[sources[row]],
                quality=quality[row], stroke=strokes[row], tool=tools[row]))
    transformer.finish()
    if transformer.problem:
        _log.warning('%s', transformer.problem)
