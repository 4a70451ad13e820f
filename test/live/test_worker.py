# SPDX-License-Identifier: Apache-2.0
"""The threads of the live registration: notified of points, stopped at once, restarted on error."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import NO_LANDMARKS, Landmarks
from gsdf_registration.common.result import Cancelled
from gsdf_registration.common.rigid import transform
from gsdf_registration.common.samples import Points, Sample
from gsdf_registration.field import Field
from gsdf_registration.live import LivePose, LiveRegistration, LiveStatus
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.live.worker import LiveWorker
from gsdf_registration.session import Session

TIMEOUT = 60.0      # s
CONFIG = Config.from_flat({'gate.max_speed': 100.0})


class Recorder:
    """Receives the callbacks of a worker and keeps their arguments."""

    def __init__(self) -> None:
        self.errors: list[str] = []
        self.poses: list[LivePose] = []
        self.assessments: list[FullAssessment] = []
        self.changed = threading.Condition()

    def on_error(self, message: str) -> None:
        self.append(self.errors, message)

    def on_status_change(self) -> None:
        with self.changed:
            self.changed.notify_all()

    def on_pose(self, pose: LivePose, frame_id: str) -> None:
        assert frame_id == 'tracker'
        self.append(self.poses, pose)

    def on_assessment(self, assessment: FullAssessment) -> None:
        self.append(self.assessments, assessment)

    def append(self, where: list[Any], item: Any) -> None:
        with self.changed:
            where.append(item)
            self.changed.notify_all()

    def wait_for(self, condition: Callable[[], bool]) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, TIMEOUT)


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


@pytest.fixture
def session() -> Session:
    session = Session(CONFIG, bone_field())
    session.collect(True)
    return session


@pytest.fixture
def worker(recorder: Recorder, session: Session) -> Iterator[LiveWorker]:
    worker = LiveWorker(session, bone_field(), on_pose=recorder.on_pose,
                        on_assessment=recorder.on_assessment, on_error=recorder.on_error,
                        on_status_change=recorder.on_status_change)
    session.listen(lambda event, value: worker.notify())
    yield worker
    worker.stop()


def add(session: Session, stamp: float, position: Any) -> None:
    assert session.add(Sample(stamp, position, 'tracker', '/probe/tip')) is None


def fill(session: Session, count: int = 1200) -> None:
    points = transform(T_TRACKER_BONE, touched_points(1200, 0, 2e-4))
    points = points[np.lexsort((points[:, 1], np.round(points[:, 0] / 0.002)))]
    for stamp, point in enumerate(points[:count].tolist()):
        add(session, 1e3 + stamp, point)


@contextmanager
def without_notifications(worker: LiveWorker) -> Iterator[None]:
    """Notify the worker only at the end, as if all points arrived within one of its steps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, 'notify', lambda: None)
        yield
    worker.notify()


def test_points_alone_give_a_pose(recorder: Recorder, session: Session,
                                  worker: LiveWorker) -> None:
    fill(session, 1190)
    recorder.wait_for(lambda: bool(recorder.poses))
    recorder.wait_for(lambda: worker.status.ready)
    assert recorder.poses[-1].stamp == 1e3 + 1189
    assert not recorder.errors
    session.clear()     # the status no longer applies, even before the worker has noticed
    assert worker.status == LiveStatus()


def test_points_that_arrive_together_give_one_pose(recorder: Recorder, session: Session,
                                                   worker: LiveWorker) -> None:
    fill(session)
    recorder.wait_for(lambda: worker.status.ready)
    last = session.points().positions[-1]
    recorder.poses.clear()
    with without_notifications(worker):
        for stamp in range(50):
            add(session, 3e3 + stamp, last + 1e-4 * (stamp + 1))
    recorder.wait_for(lambda: bool(recorder.poses) and recorder.poses[-1].stamp == 3049.0)
    assert len(recorder.poses) <= 2     # one of the step, one of an assessment


def test_reports_an_internal_error_and_continues(recorder: Recorder, session: Session,
                                                 worker: LiveWorker,
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    fill(session, 1000)
    recorder.wait_for(lambda: worker.status.ready)

    def fail(*_: Any) -> None:
        raise ZeroDivisionError('on purpose')
    with monkeypatch.context() as broken:
        broken.setattr(LiveRegistration, 'follow', fail)
        worker.notify()
        recorder.wait_for(lambda: bool(recorder.errors))
    assert 'ZeroDivisionError: on purpose' in recorder.errors[0]
    recorder.poses.clear()
    worker.notify()
    recorder.wait_for(lambda: bool(recorder.poses))


class EndlessAssessment:
    """An assessment that runs until it is cancelled; keeps the number of points of each run."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.started: list[int] = []
        self.cancelled: list[int] = []

    def __call__(self, points: Points, *_: Any, cancelled: Callable[[], bool],
                 **__: Any) -> FullAssessment:
        count = len(points.stamps)
        self._recorder.append(self.started, count)
        while not cancelled():
            time.sleep(0.001)
        self._recorder.append(self.cancelled, count)
        raise Cancelled


@pytest.fixture
def endless(recorder: Recorder, session: Session, worker: LiveWorker,
            monkeypatch: pytest.MonkeyPatch) -> EndlessAssessment:
    """Return an assessment of 100 points that has started and ends only when it is cancelled."""
    recorder.wait_for(lambda: bool(recorder.assessments))       # of no points, at the start
    assessment = EndlessAssessment(recorder)
    monkeypatch.setattr('gsdf_registration.live.live_registration.assess_all_points', assessment)
    with without_notifications(worker):
        fill(session, 100)
    recorder.wait_for(lambda: assessment.started == [100])
    return assessment


def test_stops_during_an_assessment(recorder: Recorder, worker: LiveWorker,
                                    endless: EndlessAssessment) -> None:
    worker.stop()
    recorder.wait_for(lambda: endless.cancelled == [100])
    assert not any(len(each.points.stamps) for each in recorder.assessments)
    assert not recorder.errors


def test_cancels_the_assessment_of_dropped_points(recorder: Recorder, session: Session,
                                                  endless: EndlessAssessment) -> None:
    assert session.undo().success
    recorder.wait_for(lambda: len(endless.started) == 2)
    assert endless.cancelled == [100]


def test_uses_changed_settings(recorder: Recorder, session: Session, worker: LiveWorker) -> None:
    fill(session)
    recorder.wait_for(lambda: worker.status.ready)
    session.configure(CONFIG.replaced({'limits.max_error': 1e-5}))
    worker.notify()
    recorder.wait_for(lambda: not worker.status.ready)
    assert worker.status.reason is not None


def test_searches_around_the_initial_pose_first(recorder: Recorder, session: Session,
                                                worker: LiveWorker) -> None:
    assert worker._steps._guess(NO_LANDMARKS) is None
    assert session.set_initial_pose(T_TRACKER_BONE).success
    guess = worker._steps._guess(NO_LANDMARKS)
    assert guess is not None and np.allclose(guess @ T_TRACKER_BONE, np.eye(4))


def test_landmarks_touched_by_a_ball_tip_are_expected_where_its_centre_is(
        recorder: Recorder, session: Session, worker: LiveWorker,
        monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[float] = []

    def for_tip(landmarks: Landmarks, field: Field) -> Landmarks:
        seen.append(field.tip_radius)
        return landmarks
    monkeypatch.setattr('gsdf_registration.live.steps.for_tip', for_tip)
    fill(session, 600)
    recorder.wait_for(lambda: bool(seen))
    assert set(seen) == {0.0}
    session.configure(CONFIG.replaced({'probe.tip_radius': 0.001}))
    worker.notify()
    recorder.wait_for(lambda: seen[-1] == 0.001)
    assert not recorder.errors


def test_a_landmark_that_is_measured_later_changes_the_pose(
        recorder: Recorder, session: Session, worker: LiveWorker,
        monkeypatch: pytest.MonkeyPatch) -> None:
    fill(session, 1190)
    recorder.wait_for(lambda: worker.status.ready)
    before = worker.status.predicted_tre_m['rms']
    places = np.array([[0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2]])
    found = Landmarks.of(places, transform(T_TRACKER_BONE, places), np.full(3, 1e-4))
    monkeypatch.setattr(session, 'landmarks', lambda: found)
    worker.notify()
    recorder.wait_for(lambda: worker.status.ready
                      and worker.status.predicted_tre_m['rms'] < 0.7 * before)
    assert not recorder.errors
