# SPDX-License-Identifier: Apache-2.0
"""
Runs the live registration on two threads.

The first waits for points, follows them and reports the pose. The second runs the full assessments.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from time import monotonic

from gsdf_registration.field import Field
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.live.live_registration import LivePose, LiveStatus
from gsdf_registration.live.steps import LiveSteps, PointSource

# Hz, of the live pose. A follow step takes about 1 ms, so this leaves the other threads their time;
# points that arrive faster share a step.
MAX_RATE = 100.0
STOP_TIMEOUT = 0.5      # s


class LiveWorker:
    """
    Follows the points of one source on one bone, from construction until `stop`.

    Parameters
    ----------
    source : PointSource
        Called from both threads.
    field : of the bone
    on_pose : called with each new pose and its frame
    on_assessment : called with each full assessment
    on_status_change : called when `status` may have changed
    on_error : called with a description of an internal error

    The callbacks run on the threads of the worker. After an internal error the registration starts
    again.

    """

    def __init__(self, source: PointSource, field: Field, *,
                 on_pose: Callable[[LivePose, str], None],
                 on_assessment: Callable[[FullAssessment], None],
                 on_status_change: Callable[[], None],
                 on_error: Callable[[str], None]) -> None:
        self._on_error = on_error
        self._notified, self._stopping = threading.Event(), threading.Event()
        self._pool = ThreadPoolExecutor(1, 'assessment')
        self._steps = LiveSteps(source, field, on_pose=on_pose, on_assessment=on_assessment,
                                on_status_change=on_status_change, submit=self._submit,
                                clock=monotonic)
        self._thread = threading.Thread(target=self._run, name='live', daemon=True)
        self._thread.start()
        self.notify()       # the source may hold points already

    @property
    def status(self) -> LiveStatus:
        """The last status; the default while the points it describes have been dropped."""
        return self._steps.status

    def notify(self) -> None:
        """Check the source for changes; returns at once, also if the source is locked."""
        self._notified.set()

    def registration_finished(self, success: bool) -> None:
        """Search again, after a registration that succeeded or was refused."""
        self._steps.registration_finished(success)
        self.notify()

    def stop(self) -> None:
        """Stop within half a second; a running assessment is cancelled."""
        self._stopping.set()
        self._steps.cancel()
        self.notify()
        self._pool.shutdown(wait=False)
        self._thread.join(STOP_TIMEOUT)

    def _submit(self, job: Callable[[], FullAssessment]) -> Future[FullAssessment]:
        """Run an assessment on the second thread; its end notifies the first."""
        running = self._pool.submit(job)
        running.add_done_callback(lambda _: self.notify())
        return running

    def _run(self) -> None:
        next_step = 0.0
        while True:
            self._notified.wait(self._steps.wait_time())
            early = next_step - monotonic()
            if early > 0.0:
                self._stopping.wait(early)
            self._notified.clear()
            if self._stopping.is_set():
                return
            next_step = monotonic() + 1.0 / MAX_RATE
            try:
                self._steps.step()
            # noqa: BLE001 - an internal error must neither stop the thread nor lose points
            except Exception as error:
                self._recover(error)

    def _recover(self, error: Exception) -> None:
        """Report an internal error and start again from the first point."""
        trace = ''.join(traceback.format_exception(error))
        self._on_error('the live registration restarts after an internal error, please report it: '
                       f'{type(error).__name__}: {error}\n{trace}')
        self._steps.start_again()
