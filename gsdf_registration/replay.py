# SPDX-License-Identifier: Apache-2.0
"""
A recording through the same session as the node's, without ROS or waiting.

The same bits every time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from gsdf_registration.config import Config
from gsdf_registration.field import Field
from gsdf_registration.result import InputError, RegistrationResult
from gsdf_registration.rigid import Array
from gsdf_registration.session import LandmarkPairs, Session

if TYPE_CHECKING:
    from msg_adapters.recording import Recording


def replay(recording: Recording, field: Field, config: Config | None = None,
           landmarks: LandmarkPairs | None = None,
           T_tracker_bone: Array | None = None) -> tuple[RegistrationResult, Session]:
    """
    Collect every point of a recording in its order, then register.

    Parameters
    ----------
    recording : Recording
        With stamps.  Where it numbers strokes, each change of the number ends one and starts the
        next.
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
    if recording.stamps is None:
        raise InputError(
            'the recording has no stamps, so it cannot be replayed; register its points instead')
    session = Session(config or Config(), field)
    session.collect(True)
    session.count_dropped(recording.dropped)
    _feed(session, recording, recording.stamps.tolist())
    return session.register(landmarks, T_tracker_bone), session


def _feed(session: Session, recording: Recording, stamps: list[float]) -> None:
    names = recording.source_names
    positions = recording.positions.tolist()
    sources = [0] * len(stamps) if recording.sources is None else recording.sources.tolist()
    quality = [None] * len(stamps) if recording.quality is None else recording.quality.tolist()
    strokes = [0] * len(stamps) if recording.strokes is None else recording.strokes.tolist()
    stroke = strokes[0] if strokes else 0
    for row, stamp in enumerate(stamps):
        if strokes[row] != stroke:
            stroke = strokes[row]
            session.collect(True)
        session.add_point(stamp, positions[row], recording.frame_ids[row], names[sources[row]],
                          quality=quality[row])
