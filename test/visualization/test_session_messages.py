# SPDX-License-Identifier: Apache-2.0
"""Which messages are sent after which event, on the node's topics and into a recording."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import NextTouch, Reason, Refusal, RegistrationResult
from gsdf_registration.common.rigid import transform
from gsdf_registration.common.samples import Points, untimed
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.session import Session
from gsdf_registration.session.pose_changes import WithdrawnPose
from gsdf_registration.session.status import Status
from gsdf_registration.visualization.session_messages import SessionMessages
from msg_adapters import results, ros
from msg_adapters.marker_cdr import DELETE_ALL, Marker, from_bytes, to_bytes

X = np.eye(3)[0]
POINTS = untimed(transform(T_TRACKER_BONE, touched_points(50)))
POSE = RegistrationResult(Reason.CONVERGED, 'registered', T_tracker_bone=T_TRACKER_BONE,
                          covariance=1e-8 * np.eye(6), residuals_m=np.zeros(50),
                          weights=np.ones(50))
NO_POSE = RegistrationResult(Reason.TOO_FEW_POINTS, 'touch more')
REFUSAL = Refusal(Reason.AMBIGUOUS, 'ambiguous: touch the rim', 'touch the rim',
                  [NextTouch(0.03 * X, X, 0.0008, 0.001)])
CLEARED = WithdrawnPose(Withdrawal.CLEARED, 'cleared', 'a', 1, 'tracker')
TYPED = {'result', 'guidance'}


class FakeSession:
    """A session in a state that the test chooses."""

    config = Config()

    def __init__(self) -> None:
        self.now = replace(Session(Config()).status(), session_id='a')

    def status(self) -> Status:
        return self.now

    def registered_points(self) -> Points | None:
        return None if self.now.pose_result is None else POINTS

    def change(self, **values: Any) -> None:
        self.now = replace(self.now, **values)

    def register(self, number: int = 1) -> None:
        self.change(pose_result=POSE, registration_id=number, pose_frame_id='tracker',
                    withdrawn=None)


class Sent:
    """The messages since they were taken last, and how many poses were shown."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, Any]] = []

    def now(self) -> Any:
        return ros.seconds_to_stamp(5.0)

    def show_pose(self, status: Any) -> None:
        self.messages.append(('pose', status.pose_result is not None))

    def send(self, topic: str, message: Any) -> None:
        self.messages.append((topic, message))

    def take(self) -> dict[str, Any]:
        """Return the messages by topic, in order; every topic was used at most once."""
        taken, self.messages = self.messages, []
        assert len({topic for topic, _ in taken}) == len(taken)
        return dict(taken)


@pytest.fixture
def session() -> FakeSession:
    return FakeSession()


@pytest.fixture
def sent() -> Sent:
    return Sent()


@pytest.fixture
def shown(session: FakeSession, sent: Sent) -> SessionMessages:
    """Return messages of which those of the beginning are sent."""
    messages = SessionMessages(sent, 'femur')
    messages.set_bone(bone_field())
    messages.show_registration(session)
    assert topics(sent.take()) == expected('pose', 'result', 'guidance', 'markers')
    return messages


def expected(*names: str) -> list[str]:
    return [name for name in names if results.available() or name not in TYPED]


def topics(taken: dict[str, Any]) -> list[str]:
    return list(taken)


def drawn(taken: dict[str, Any]) -> set[str]:
    """Return the namespaces of the markers that are drawn."""
    return {marker.ns for marker in from_bytes(taken['markers']) if len(marker.points)}


def test_a_registration_is_sent_once_with_its_points(session: FakeSession, sent: Sent,
                                                     shown: SessionMessages) -> None:
    session.register()
    shown.show_registration(session)
    taken = sent.take()
    assert topics(taken) == expected('pose', 'result', 'markers', 'points')
    assert taken['pose'] and taken['points'].width == 50 and 'points' in drawn(taken)
    assert taken['points'].header.frame_id == 'femur'
    if results.available():
        assert taken['result'].valid and taken['result'].registration_id == 1
    shown.show_registration(session)
    session.change(received=7)
    shown.show_registration(session)
    assert not sent.take()
    session.register(2)     # of the same points
    shown.show_registration(session)
    assert topics(sent.take()) == expected('pose', 'result', 'markers', 'points')


def test_a_withdrawal_leaves_the_bone_alone_and_only_a_pose_can_be_withdrawn(
        session: FakeSession, sent: Sent, shown: SessionMessages) -> None:
    session.register()
    shown.show_registration(session)
    sent.take()
    session.change(pose_result=None, registration_id=0, session_id='b', withdrawn=CLEARED)
    shown.show_registration(session)
    taken = sent.take()
    assert topics(taken) == expected('pose', 'result', 'markers', 'points')
    assert not taken['pose'] and taken['points'].width == 0 and 'points' not in drawn(taken)
    if results.available():
        message = taken['result']
        assert (message.valid, message.reason, message.session_id) == (False, message.CLEARED, 'a')
    session.change(session_id='c')      # cleared again
    shown.show_registration(session)
    assert topics(sent.take()) == ['pose', 'markers']


def test_an_estimate_is_drawn_until_there_is_none(session: FakeSession, sent: Sent,
                                                  shown: SessionMessages) -> None:
    shown.show_assessment(session, POSE, POINTS, None)
    assert topics(sent.take()) == ['markers', 'points']
    shown.show_assessment(session, NO_POSE, POINTS, REFUSAL)
    taken = sent.take()
    assert topics(taken) == expected('guidance', 'markers', 'points')
    assert taken['points'].width == 0
    if results.available():
        assert taken['guidance'].sentence == 'touch the rim' and len(taken['guidance'].points) == 1
    shown.show_assessment(session, NO_POSE, POINTS, REFUSAL)        # it may have moved
    assert topics(sent.take()) == ['markers']
    shown.show_assessment(session, NO_POSE, POINTS, None)           # removes the place
    assert topics(sent.take()) == expected('guidance', 'markers')
    shown.show_assessment(session, NO_POSE, POINTS, None)
    assert not sent.take()


def test_without_an_estimate_the_registration_is_drawn_again(session: FakeSession, sent: Sent,
                                                             shown: SessionMessages) -> None:
    session.register()
    shown.show_registration(session)
    registered = sent.take()
    few = untimed(POINTS.positions[:20])
    estimate = replace(POSE, residuals_m=np.zeros(20), weights=np.ones(20))
    shown.show_assessment(session, estimate, few, REFUSAL)
    assert sent.take()['points'].width == 20
    shown.show_assessment(session, NO_POSE, few, None)
    assert sent.take()['markers'] == registered['markers']
    shown.show_assessment(session, estimate, few, REFUSAL)
    sent.take()
    session.register(2)     # ends what an estimate has shown
    shown.show_registration(session)
    assert topics(sent.take()) == expected('pose', 'result', 'guidance', 'markers', 'points')
    shown.show_assessment(session, NO_POSE, few, None)
    assert not sent.take()


def test_a_node_that_is_deactivated_deletes_everything_and_sends_it_again(
        session: FakeSession, sent: Sent, shown: SessionMessages) -> None:
    def deactivate() -> dict[str, Any]:
        shown.withdraw(session, Withdrawal.DEACTIVATED, 'deactivated')
        return sent.take()
    assert topics(deactivate()) == ['markers']      # there is no pose
    session.register()
    shown.show_registration(session)
    sent.take()
    taken = deactivate()
    assert topics(taken) == expected('result', 'markers', 'points')
    assert taken['markers'] == to_bytes([Marker('', 0, action=DELETE_ALL)], 'femur')
    assert taken['points'].width == 0
    if results.available():
        assert taken['result'].reason == taken['result'].DEACTIVATED
    shown.set_bone(bone_field())
    shown.show_registration(session)
    assert topics(sent.take()) == expected('pose', 'result', 'markers', 'points')


def test_without_a_bone_nothing_is_drawn(session: FakeSession, sent: Sent) -> None:
    messages = SessionMessages(sent, 'femur')
    messages.show_registration(session)
    messages.show_assessment(session, POSE, POINTS, None)
    assert topics(sent.take()) == expected('pose', 'result', 'guidance')
