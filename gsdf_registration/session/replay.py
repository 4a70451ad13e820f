# SPDX-License-Identifier: Apache-2.0
"""
Replay of a recording through the session that the node uses, without ROS and without waiting.

The result is the same to the bit every time. With the events of the node, what the operator did is
carried out again at the same places among the samples.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import InputError, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Sample, SampleSink
from gsdf_registration.field import Field
from gsdf_registration.session import Session, restart_notice
from gsdf_registration.session.operator_replay import OperatorReplay, Settle, recorded_config
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.point_transformer import PointTransformer
from msg_adapters.recorded_events import settings_of
from msg_adapters.recording import Recording

STATES = ('configure', 'activate', 'deactivate')        # events that change the node's state

_log = logging.getLogger('gsdf_registration')


@dataclass(frozen=True)
class Replayed:
    """
    The outcome of a replay.

    result : that of the node: its accepted registration, or why the last one was refused; without
        a registration by the operator, that of all points
    session : at the end
    notes : sentences on what was noticed
    """

    result: RegistrationResult
    session: Session
    notes: tuple[str, ...]


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
    session, notes = _collected(recording, field, config or Config())
    for note in notes:
        _log.warning('%s', note)
    return session.register(landmarks, T_tracker_bone), session


def replay_events(recording: Recording, field: Field, settle: Settle,
                  landmarks: Landmarks | None = None,
                  T_tracker_bone: Array | None = None,
                  watch: Callable[[Session], SampleSink] | None = None) -> Replayed:
    """
    Replay a recording with what the operator did, if that is recorded; else as `replay`.

    Parameters
    ----------
    recording, field, landmarks, T_tracker_bone
        As in `replay`; landmarks and start pose are used in place of those of the node.
    settle : function
        Returns the settings to use in place of those of the node, or of the defaults.
    watch : function, optional
        Returns a sink that receives the samples in place of the session and passes them on.

    """
    if not recording.events:
        session, remarks = _collected(recording, field, settle(Config()), watch)
        return Replayed(session.register(landmarks, T_tracker_bone), session, remarks)
    session, transformer, operator = _operated(recording, field, settle, landmarks, T_tracker_bone,
                                               watch)
    restarts = _restarts(session)
    notes = _play(recording, transformer, operator)
    session.count_rejected(recording.dropped)
    status = session.status()
    result = status.pose_result or status.result
    if result is None:
        result = session.register(landmarks, T_tracker_bone)
    return Replayed(result, session, (*operator.notes, *restarts, *notes))


def begin(recording: Recording, field: Field, settle: Settle) -> tuple[Session, Iterator[int]]:
    """
    Return a new session, and an iterator of which each step adds one sample.

    It yields the row of the sample that comes next. What the operator did, if that is recorded, is
    carried out at its place among the samples.  Arguments as in `replay_events`.
    """
    if not recording.events:
        session = Session(settle(Config()), field)
        session.collect(True)
        return session, _steps(recording, PointTransformer(session, Frames()), None)
    session, transformer, operator = _operated(recording, field, settle)
    return session, _steps(recording, transformer, operator)


def _operated(recording: Recording, field: Field, settle: Settle,
              landmarks: Landmarks | None = None, T_tracker_bone: Array | None = None,
              watch: Callable[[Session], SampleSink] | None = None
              ) -> tuple[Session, PointTransformer, OperatorReplay]:
    """Return a session with the settings of the recorded node, and what repeats its operator."""
    settings = settings_of([each.event for each in recording.events])
    if not settings:    # of service introspection: those given, until the operator changes them
        settings, settle = settle(Config()).flat(), lambda config: config
    session = Session(recorded_config(settings, settle), field)
    session.collect(False)
    transformer = PointTransformer(watch(session) if watch else session, Frames())
    operator = OperatorReplay(session, transformer, field.bone_sha256, settle, settings,
                              landmarks, T_tracker_bone)
    # what the node did before its first change of state that is recorded
    first = next((each.event.name for each in recording.events if each.event.name in STATES), '')
    operator.receiving, operator.active = first != 'configure', first in ('', 'deactivate')
    return session, transformer, operator


def collected(recording: Recording, field: Field, config: Config | None = None) -> Session:
    """Return a session with the points of a recording; arguments and errors as in `replay`."""
    return _collected(recording, field, config or Config())[0]


def _collected(recording: Recording, field: Field, config: Config,
               watch: Callable[[Session], SampleSink] | None = None
               ) -> tuple[Session, tuple[str, ...]]:
    """Return a session with the points of a recording, and what was noticed."""
    session = Session(config, field)
    session.collect(True)
    restarts = _restarts(session)
    sink = watch(session) if watch else session
    notes = _play(recording, PointTransformer(sink, Frames()), None)
    session.count_rejected(recording.dropped)
    return session, (*restarts, *notes)


def _restarts(session: Session) -> list[str]:
    """Return a list that receives a sentence whenever the session starts again by itself."""
    restarts: list[str] = []

    def listen(event: str, value: Any) -> None:
        if event == 'clear' and value:
            restarts.append(f'{restart_notice(value)}; the points before it are dropped')
    session.listen(listen)
    return restarts


def _play(recording: Recording, transformer: PointTransformer,
          operator: OperatorReplay | None) -> list[str]:
    """Add the whole recording; return what was noticed."""
    deque(_steps(recording, transformer, operator), maxlen=0)
    return [transformer.problem] if transformer.problem else []


def _steps(recording: Recording, transformer: PointTransformer,
           operator: OperatorReplay | None) -> Iterator[int]:
    """Add points, transforms and events in the order in which they were received."""
    if recording.stamps is None:
        raise InputError(
            'the recording has no stamps, so it cannot be replayed; register its points instead')
    stamps = recording.stamps.tolist()
    names = recording.source_names
    positions, sources = recording.positions.tolist(), recording.sources.tolist()
    quality = [None] * len(stamps) if recording.quality is None else recording.quality.tolist()
    strokes = [0] * len(stamps) if recording.strokes is None else recording.strokes.tolist()
    tools = [None] * len(stamps) if recording.tools is None else [
        None if all(math.isnan(value) for value in tool) else tuple(tool)
        for tool in recording.tools.tolist()]
    transforms, events = recording.transforms, recording.events if operator else ()
    moved = done = 0        # transforms and events so far
    for row in range(len(stamps) + 1):
        if row < len(stamps):
            yield row
        while True:
            if (done < len(events) and events[done].after <= row
                    and events[done].transforms <= moved):
                assert operator is not None
                operator.apply(events[done].event)
                done += 1
            elif moved < len(transforms) and transforms[moved].after <= row:
                pending, moved = transforms[moved], moved + 1
                if pending.child:
                    transformer.add_transform(pending.parent, pending.child, pending.stamp,
                                              pending.T_parent_child, pending.fixed)
                elif operator is None or operator.receiving:
                    transformer.add_pose(pending.stamp, pending.T_parent_child, pending.parent)
            else:
                break
        if row < len(stamps) and (operator is None or operator.active):
            transformer.add_point(Sample(
                stamps[row], tuple(positions[row]), recording.frame_ids[row], names[sources[row]],
                quality=quality[row], stroke=strokes[row], tool=tools[row]))
    transformer.finish()
