# SPDX-License-Identifier: Apache-2.0
"""The threads beside the executor: woken by points, stopped at once, not stopped by a fault."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Cancelled
from gsdf_registration.common.rigid import transform
from gsdf_registration.common.samples import Points
from gsdf_registration.live import LivePose, LiveStatus
from gsdf_registration.live import live as live_module
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.live.worker import Live
from gsdf_registration.session import Session

pytestmark = pytest.mark.ros
PATIENCE = 60.0
CONFIG = Config.from_flat({'gate.max_speed': 100.0})


class Node:
    """Stands for the node and for what it publishes; remembers everything."""

    def __init__(self) -> None:
        self.outputs = self
        self.errors: list[str] = []
        self.poses: list[LivePose] = []
        self.surveys: list[FullAssessment] = []
        self.changed = threading.Condition()

    def get_logger(self) -> Node:
        return self

    def error(self, text: str, **_: Any) -> None:
        with self.changed:
            self.errors.append(text)
            self.changed.notify_all()

    def show_soon(self) -> None:
        with self.changed:
            self.changed.notify_all()

    def live(self, pose: LivePose, frame_id: str) -> None:
        assert frame_id == 'tracker'
        with self.changed:
            self.poses.append(pose)
            self.changed.notify_all()

    def survey(self, survey: FullAssessment, session: Session) -> None:
        with self.changed:
            self.surveys.append(survey)
            self.changed.notify_all()

    def await_that(self, condition: Callable[[], bool]) -> None:
        with self.changed:
            assert self.changed.wait_for(condition, PATIENCE)


@pytest.fixture
def node() -> Node:
    return Node()


@pytest.fixture
def session() -> Session:
    session = Session(CONFIG, bone_field())
    session.collect(True)
    return session


@pytest.fixture
def live(node: Node, session: Session) -> Iterator[Live]:
    live = Live(node)  # type: ignore[arg-type]
    live.start(session, bone_field(), CONFIG)
    yield live
    live.stop()


def fill(session: Session, count: int = 1200) -> None:
    points = transform(T_TRACKER_BONE, touched(1200, 0, 2e-4))
    points = points[np.lexsort((points[:, 1], np.round(points[:, 0] / 0.002)))]
    for stamp, point in enumerate(points[:count].tolist()):
        assert session.add_point(1e3 + stamp, point, 'tracker') is None


def test_a_pose_follows_from_points_alone(node: Node, session: Session, live: Live) -> None:
    fill(session, 1190)
    live.wake()
    node.await_that(lambda: bool(node.poses))
    node.await_that(lambda: live.status.ready)
    assert node.poses[0].stamp == 1e3 + 1189
    assert not node.errors
    session.clear()     # and before anyone has looked, it is not true any more
    assert live.status == LiveStatus()


def test_points_that_came_in_meanwhile_make_one_pose(node: Node, session: Session,
                                                     live: Live) -> None:
    fill(session)
    live.wake()
    node.await_that(lambda: live.status.ready)
    node.poses.clear()
    last = session.points().positions[-1]
    for stamp in range(50):
        session.add_point(3e3 + stamp, last + 1e-4 * (stamp + 1), 'tracker')
    live.wake()
    node.await_that(lambda: bool(node.poses) and node.poses[-1].stamp == 3049.0)
    assert len(node.poses) <= 2     # and a look's


def test_a_fault_is_said_and_the_pose_comes_back(node: Node, session: Session, live: Live,
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    fill(session, 1000)
    live.wake()
    node.await_that(lambda: live.status.ready)

    def fail(*_: Any) -> None:
        raise ZeroDivisionError('on purpose')
    with monkeypatch.context() as broken:
        broken.setattr(live_module.LiveRegistration, 'follow', fail)
        live.wake()
        node.await_that(lambda: bool(node.errors))
    assert 'ZeroDivisionError: on purpose' in node.errors[0]
    node.poses.clear()
    live.wake()
    node.await_that(lambda: bool(node.poses))


class Endless:
    """A survey that goes on until it is given up; remembers how many points it was given."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self.begun: list[int] = []
        self.ended: list[int] = []

    def __call__(self, points: Points, *more: Any) -> FullAssessment:
        count, given_up = len(points.stamps), more[-1]
        self._tell(self.begun, count)
        while not given_up():
            time.sleep(0.001)
        self._tell(self.ended, count)
        raise Cancelled

    def _tell(self, where: list[int], count: int) -> None:
        with self._node.changed:
            where.append(count)
            self._node.changed.notify_all()


@pytest.fixture
def endless(node: Node, session: Session, live: Live, monkeypatch: pytest.MonkeyPatch) -> Endless:
    """Return a search of 100 points that has begun and ends only when it is given up."""
    search = Endless(node)
    fill(session, 100)
    monkeypatch.setattr('gsdf_registration.live.live.survey', search)
    live.wake()
    node.await_that(lambda: 100 in search.begun)
    return search


def test_it_stops_in_the_middle_of_a_search(node: Node, live: Live, endless: Endless) -> None:
    live.stop()
    node.await_that(lambda: 100 in endless.ended)
    assert live.status == LiveStatus()
    assert not any(len(each.points.stamps) for each in node.surveys) and not node.errors


def test_a_search_of_points_that_are_dropped_is_given_up(node: Node, session: Session, live: Live,
                                                         endless: Endless) -> None:
    assert session.undo().success
    live.wake()
    node.await_that(lambda: 99 in endless.begun)
    assert endless.ended == [100]


def test_settings_can_be_changed_while_it_runs(node: Node, session: Session, live: Live) -> None:
    fill(session)
    live.wake()
    node.await_that(lambda: live.status.ready)
    live.configure(CONFIG.replaced({'limits.max_bone_tre': 1e-5}))
    node.await_that(lambda: not live.status.ready)
    assert live.status.reason is not None


def test_nothing_runs_without_a_bone_or_where_it_is_not_wanted(node: Node,
                                                               session: Session) -> None:
    live = Live(node)  # type: ignore[arg-type]
    for field, config in ((None, CONFIG), (bone_field(), CONFIG.replaced({'live.enabled': False}))):
        live.start(session, field, config)
        live.wake()
        live.registered(True)
        assert live.status == LiveStatus()
        live.stop()
