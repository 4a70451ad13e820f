# SPDX-License-Identifier: Apache-2.0
"""Records, while a recording is replayed, what the node would publish."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from gsdf_registration.cli.session_topics import SessionTopics
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Rejection, Sample, SampleSink, at_tip
from gsdf_registration.field import Field
from gsdf_registration.live import LivePose, LiveStatus
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.live.steps import LiveSteps, run_now
from gsdf_registration.live.worker import MAX_RATE
from gsdf_registration.session import Session
from gsdf_registration.session.status_values import combined_status
from msg_adapters.bag_writer import BagWriter
from msg_adapters.recording import Recording

Watch = Callable[[Session], SampleSink]
TICK = 1.0      # s, between two messages on /diagnostics, as in the node


@contextmanager
def recorded(path: str | None, recording: Recording, field: Field) -> Iterator[Watch | None]:
    """
    Record what the node would publish in the block; yield the ``watch`` of `replay_events`.

    Parameters
    ----------
    path : new rosbag2 directory; None: nothing is recorded
    recording : that is replayed
    field : of the bone

    Raises
    ------
    InputError
        If ``path`` exists or cannot be written.

    """
    if path is None:
        yield None
        return
    with BagWriter(path) as bag:
        topics = SessionBag(bag, recording, field)
        yield topics.watch
        topics.finish()


class SessionBag:
    """
    A sink of samples that passes them on to a session and writes its topics.

    All times are those of the samples: the live registration runs by their clock too, so the same
    recording gives the same messages.

    Parameters
    ----------
    bag : BagWriter
    recording : Recording
        That is replayed; with stamps.
    field : Field
        Of the bone.

    """

    def __init__(self, bag: BagWriter, recording: Recording, field: Field) -> None:
        self._bag, self._field = bag, field
        stamps = [] if recording.stamps is None else recording.stamps.tolist()
        # what the operator did, with the stamp of the last sample before it, s
        self._events = [(stamps[max(each.after - 1, 0)], each.event) for each in recording.events]

    def watch(self, session: Session) -> SessionBag:
        """Write the topics of a new session from now on."""
        self._session, self._topics = session, SessionTopics(
            self._bag, session, self._field)
        self._changed, self._begun = True, False
        self._next_step = self._next_tick = self._next_transform = -math.inf
        self._live = LiveSteps(session, self._field, on_pose=self._on_pose,
                               on_assessment=self._on_assessment,
                               on_status_change=self._on_change, submit=run_now,
                               clock=lambda: self._topics.time)
        session.listen(self._on_event)
        return self

    def finish(self) -> None:
        """Write what the session shows at the end of the recording."""
        self._write_due(math.inf)
        self._write_changes(tick=True)

    # ---- the sink

    @property
    def config(self) -> Config:
        """Settings in force."""
        return self._session.config

    def take(self, sample: Sample) -> bool:
        """Pass on a sample, as it was received."""
        self._advance(sample.stamp)
        return self._session.take(sample)

    def add_reference_pose(self, stamp: float, T: Array) -> None:
        """Pass on a pose of the reference array."""
        self._session.add_reference_pose(stamp, T)

    def add(self, sample: Sample) -> Rejection | None:
        """Pass on a sample, and write the tip unless the sample is invalid."""
        rejection, tip = self._session.add(sample), self.config.probe.tip
        valid = rejection is None or not rejection.invalidates_sample
        if valid and (sample.tool is None or tip):
            self._topics.write_tip(at_tip(sample, tip))
        return rejection

    def reject(self, sample: Sample, cause: Rejection) -> None:
        """Pass on a rejected sample."""
        self._session.reject(sample, cause)

    def restart(self, reason: str) -> None:
        """Pass on that the clock of the samples restarted; the times start again too."""
        self._session.restart(reason)
        self._topics.time = -math.inf
        self._next_step = self._next_tick = self._next_transform = -math.inf

    # ---- what is written

    def _advance(self, stamp: float) -> None:
        """Write what is due before a sample."""
        self._topics.time = now = max(self._topics.time, stamp)
        if not self._begun:
            self._begun = True
            self._topics.write_centre()
        self._write_due(now)
        if self.config.live.enabled and now >= self._next_step:
            self._next_step = now + 1.0 / MAX_RATE
            self._live.step()
        tick = now >= self._next_tick
        if self._changed or tick:
            self._next_tick = now + TICK if tick else self._next_tick
            self._write_changes(tick)
        rate = self.config.tf.rate
        if rate > 0.0 and now >= self._next_transform:
            self._next_transform = now + 1.0 / rate
            self._topics.write_transform(self._session.status())

    def _write_due(self, now: float) -> None:
        """Write what the operator did up to ``now``, s."""
        while self._events and self._events[0][0] <= now:
            self._topics.write_event(self._events.pop(0)[1])

    def _write_changes(self, tick: bool) -> None:
        """Write the registration or its withdrawal, and the status, if they have changed."""
        self._changed = False
        status = self._session.status()
        self._topics.write_registration()
        live = self._live_status
        self._topics.write_status(combined_status(status, live), live, tick)

    @property
    def _live_status(self) -> LiveStatus:
        return self._live.status if self.config.live.enabled else LiveStatus()

    def _on_event(self, event: str, value: Any) -> None:
        if event == 'registration':
            self._live.registration_finished(value['pose_frame_id'] is not None)
        if event not in ('point', 'rejected'):
            self._on_change()

    def _on_change(self) -> None:
        self._changed = True

    def _on_pose(self, pose: LivePose, frame_id: str) -> None:
        self._topics.write_live_pose(pose, frame_id)

    def _on_assessment(self, found: FullAssessment) -> None:
        self._topics.write_assessment(found)
