# SPDX-License-Identifier: Apache-2.0
"""
Drives the live registration: what takes time runs on two threads beside the executor.

One follows the points and publishes ``~/live_pose``; it waits for an event that the executor sets
with every point. The other looks at all points at a calm rate, and now and then searches.
"""

from __future__ import annotations

import threading
import traceback
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from time import monotonic
from typing import TYPE_CHECKING

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Cancelled, Refusal
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.live import Job, LivePose, LiveRegistration, LiveStatus
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.node.outputs import Outputs
from gsdf_registration.registration.pipeline import first_guess
from gsdf_registration.session import Session

if TYPE_CHECKING:
    from gsdf_registration.node.node import RegistrationNode

# s from one search to the next at least; each takes some 0.6 s of one core. An undo need not wait.
SEARCH_EVERY = 2.0
STOPPED = 0.5       # s that a thread may take to stop

Order = Callable[[LiveRegistration], None]


class Live:
    """Keeps a pose up for a node, from `start` to `stop`; the executor may call it in any state."""

    def __init__(self, node: RegistrationNode) -> None:
        self._node = node
        self._pursuit: LiveWorker | None = None

    @property
    def status(self) -> LiveStatus:
        """How it stands."""
        return LiveStatus() if self._pursuit is None else self._pursuit.status

    def start(self, session: Session, field: Field | None, config: Config) -> None:
        """Follow the points of a session from now on, if that is wanted and there is a bone."""
        self.stop()
        outputs = self._node.outputs
        if config.live.enabled and field is not None and outputs is not None:
            self._pursuit = LiveWorker(self._node, outputs, session, field, config)

    def stop(self) -> None:
        """Stop within half a second; what is being looked at is given up."""
        if self._pursuit is not None:
            self._pursuit.stop()
        self._pursuit = None

    def wake(self) -> None:
        """Tell that points have come in, or that anything else has changed; takes microseconds."""
        if self._pursuit is not None:
            self._pursuit.wake()

    def configure(self, config: Config) -> None:
        """Work by these settings from now on."""
        if self._pursuit is not None:
            self._pursuit.order(lambda live: live.configure(config))

    def registered(self, success: bool) -> None:
        """Tell that a registration was asked for, and whether it gave a pose."""
        if self._pursuit is not None:
            self._pursuit.order(lambda live: live.registered(success))


class LiveWorker:
    """
    The threads that follow one session with one bone; they start at once.

    ``status`` is what there is to say, to be read at any time; of points that have been dropped
    since, nothing.
    """

    def __init__(self, node: RegistrationNode, outputs: Outputs, session: Session, field: Field,
                 config: Config) -> None:
        self._told = -1, LiveStatus()       # revision of the points that it is true of, and it
        self._node, self._outputs, self._session, self._field = node, outputs, session, field
        self._live = LiveRegistration(field, config)
        self._woken, self._stopping = threading.Event(), threading.Event()
        self._orders: deque[Order] = deque()
        self._looked_at = (-1, 0)           # revision and count of the last look
        self._looked = 0.0                  # when, s, monotonic
        self._next_look = self._next_search = 0.0   # not before
        self._looking: Future[FullAssessment] | None = None
        self._give_up = threading.Event()
        self._frame_id = ''
        self._looks = ThreadPoolExecutor(1, 'look')
        self._thread = threading.Thread(target=self._run, name='live', daemon=True)
        self._thread.start()
        self.wake()     # there may be points

    @property
    def status(self) -> LiveStatus:
        revision, status = self._told
        return status if revision == self._session.revision else LiveStatus()

    def wake(self) -> None:
        self._woken.set()

    def order(self, order: Order) -> None:
        self._orders.append(order)
        self.wake()

    def stop(self) -> None:
        self._stopping.set()
        self._give_up.set()
        self.wake()
        self._looks.shutdown(wait=False)
        self._thread.join(STOPPED)

    def _run(self) -> None:
        next_step = 0.0
        while True:
            self._woken.wait(self._patience())
            early = next_step - monotonic()
            if early > 0.0:
                self._stopping.wait(early)
            self._woken.clear()
            if self._stopping.is_set():
                return
            next_step = monotonic() + 1.0 / self._live.config.live.max_rate
            try:
                self._step()
            # noqa: BLE001 - a fault here must cost neither points nor the next pose
            except Exception as error:
                self._begin_again(error)

    def _step(self) -> None:
        """Take in what has come, and what a look has found; publish the pose; look anew."""
        live = self._live
        while self._orders:
            self._orders.popleft()(live)
            self._next_search = 0.0
        before = live.revision
        revision, self._frame_id, points = self._session.points_since(before, live.count)
        pose = live.follow(revision, points)
        if revision != before:
            self._give_up.set()
            self._next_look = self._next_search = 0.0
            self._tell()
        if self._looking is not None and self._looking.done():
            looking, self._looking = self._looking, None
            pose = self._accept(looking) or pose
        if pose is not None:
            self._outputs.live(pose, self._frame_id)
        self._look()

    def _accept(self, looking: Future[FullAssessment]) -> LivePose | None:
        try:
            survey = looking.result()
        except Cancelled:
            return None
        live = self._live
        pose = live.accept(survey)
        if survey.searched and live.survey is survey:
            self._next_search = self._looked + SEARCH_EVERY
        self._tell()
        return pose

    def _tell(self) -> None:
        self._told = self._live.revision, self._live.status()
        self._node.show_soon()

    def _patience(self) -> float | None:
        """Return for how long to wait for points, s; None: until some come."""
        if self._looking is not None:
            return None     # it wakes us
        due = self._due()
        return None if due is None else max(0.0, due - monotonic())

    def _due(self) -> float | None:
        """Return when to look again, s, monotonic; None: when something has come in."""
        live = self._live
        if (live.revision, live.count) != self._looked_at:
            return self._next_look
        return max(self._next_look, self._next_search) if live.due else None

    def _look(self) -> None:
        """Have all points looked at, if it is time to."""
        due, now = self._due(), monotonic()
        if self._looking is not None or due is None or due > now:
            return
        live = self._live
        self._looked_at = live.revision, live.count
        self._looked = now
        # half as often when there is nothing left to wait for
        self._next_look = now + (2.0 if live.ready else 1.0) / live.config.live.status_rate
        self._give_up = threading.Event()
        search = now >= self._next_search and self._session.status().state != 'solving'
        job = live.look(search, self._guess())
        self._looking = self._looks.submit(self._survey, job, self._give_up)
        self._looking.add_done_callback(lambda _: self.wake())

    def _survey(self, job: Job, give_up: threading.Event) -> FullAssessment:
        """Look at all points, on a thread of its own, and show what is found."""
        survey = job(give_up.is_set)
        if not give_up.is_set():
            self._outputs.survey(survey, self._session)
        return survey

    def _guess(self) -> Array | None:
        """Return T_bone_tracker (4, 4) where a registration would begin; None: anywhere."""
        status, landmarks = self._session.status(), self._session.landmarks()
        if landmarks is not None:
            try:
                return first_guess(landmarks, None)
            except Refusal:
                return None
        if status.pose_result is None or status.pose_frame_id != self._frame_id:
            return None
        return status.pose_result.T_bone_tracker

    def _begin_again(self, error: Exception) -> None:
        """Say what went wrong, once in a while, and follow the points from the first one on."""
        trace = ''.join(traceback.format_exception(error))
        self._node.get_logger().error(
            'the live pose begins again after an internal error, please report it: '
            f'{type(error).__name__}: {error}\n{trace}', throttle_duration_sec=10.0)
        self._live = LiveRegistration(self._field, self._live.config)
        self._looked_at, self._looking = (-1, 0), None
        self._next_look = self._next_search = monotonic() + SEARCH_EVERY
