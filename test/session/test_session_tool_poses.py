# SPDX-License-Identifier: Apache-2.0
"""Test sessions of poses of a tool: what a tip that is known later, or set again, changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from session_fixtures import (
    CONFIG,
    LANDMARKS,
    RATE,
    T_TRACKER_BONE,
    send,
    surface_point,
    surface_points,
    with_landmarks,
)

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.rigid import quaternion_from_rotation, rotation_exp, transform
from gsdf_registration.common.samples import Rejection, Sample
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.session import Session
from gsdf_registration.session.events import Replay
from msg_adapters.session_file import read_session, write_session
from msg_adapters.session_journal import SessionJournal, read_journal

TIP = [0.012, -0.021, 0.148]
KNOWN, UNKNOWN = CONFIG.replaced({'probe.tip': TIP}), CONFIG


def tool_sample(stamp: float, position: np.ndarray, tilt: float = 0.0, **more: Any) -> Sample:
    """Return the pose of a tool whose tip is at ``position``."""
    R = rotation_exp([0.3 * np.sin(tilt), 0.3 * np.cos(1.7 * tilt), 0.2 * tilt])
    x, y, z = (position - R @ np.array(TIP)).tolist()
    qx, qy, qz, qw = quaternion_from_rotation(R).tolist()
    return Sample(stamp, (x, y, z), 'cam', '/probe/measured_cp',
                  tool=(x, y, z, qx, qy, qz, qw), **more)


def hold_tool(session: Session, position: np.ndarray, start: float, tilt: float = 0.0) -> float:
    for i in range(50):
        session.add(tool_sample(start + i / RATE, position, tilt))
    return start + 51 / RATE


def collected(field: Field, config: Config) -> Session:
    """Return a session with landmarks and points that were touched with a tool."""
    session, time = Session(config, field), 0.0
    session.collect(True)
    for k, point in enumerate(transform(T_TRACKER_BONE, LANDMARKS)):
        time = hold_tool(session, point, time, 0.1 * k) + 1.0
        assert session.capture_landmark().success
    for i, point in enumerate(surface_points(field)):
        assert session.add(tool_sample(100.0 + i, point, 0.02 * i)) is None
    return session


def test_a_tip_that_is_set_later_gives_the_same_session_to_the_bit(field: Field) -> None:
    early, late = collected(field, KNOWN), collected(field, UNKNOWN)
    late.configure(KNOWN)
    assert np.array_equal(late.points().positions, early.points().positions)
    assert np.allclose(late.landmarks().touched, early.landmarks().touched, atol=1e-12)
    touched = transform(T_TRACKER_BONE, LANDMARKS)
    assert np.allclose(late.landmarks().touched, touched, atol=1e-9)
    a, b = early.register(), late.register()
    assert a.success and b.success
    assert a.T_tracker_bone is not None and b.T_tracker_bone is not None
    assert np.allclose(a.T_tracker_bone, b.T_tracker_bone, atol=1e-9)
    assert np.allclose(a.T_tracker_bone, T_TRACKER_BONE, atol=1e-3)


def test_nothing_is_registered_without_a_tip(field: Field) -> None:
    session = collected(field, UNKNOWN)
    result = session.register()
    assert result.reason is Reason.BAD_INPUT and result.message.startswith(
        'probe.tip is not set: calibrate the tip (~/calibrate_tip')
    status = session.status()
    assert status.kept == 300 and status.warning and 'probe.tip is not set' in status.message
    assert len(session.points_since(0, 0)[2].stamps) == 0       # nor is there a live pose
    session.configure(UNKNOWN.replaced({'probe.tip': [0.0, 0.0, 0.0]}))
    assert 'probe.tip' not in session.status().message      # the pose is that of the tip
    revision, _, points = session.points_since(-1, 0)
    assert len(points.stamps) == 300
    assert np.array_equal(points.positions, points.tools[:, :3])


def test_another_tip_withdraws_the_pose_of_the_former_one(field: Field) -> None:
    session = collected(field, KNOWN)
    assert session.register().success
    place = surface_point(field, 40)
    time = hold_tool(session, place, 1000.0)
    assert session.verify().success
    other = [0.012, -0.021, 0.149]
    session.configure(KNOWN.replaced({'probe.tip': other}))
    status = session.status()
    assert status.pose_result is None and status.withdrawn is not None
    assert status.withdrawn.reason is Withdrawal.TIP_CHANGED
    assert 'register again' in status.message and status.warning
    (verification,) = session._state.verifications
    assert np.linalg.norm(verification.position - place) == pytest.approx(1e-3, rel=1e-6)
    assert hold_tool(session, place, time) and not session.verify().success
    assert session.register().success


def test_positions_of_the_tip_stay_when_the_tip_of_a_tool_is_set(field: Field) -> None:
    session = with_landmarks(field)
    send(session, surface_points(field), start=100.0)
    assert session.register().success
    before = session.points().positions.copy()
    session.configure(KNOWN)
    assert np.array_equal(session.points().positions, before)
    assert session.status().pose_result is not None


def test_a_running_registration_is_void_when_the_tip_changes(field: Field) -> None:
    session = collected(field, KNOWN)

    def change(share: float) -> None:
        session.configure(KNOWN.replaced({'probe.tip': [0.0, 0.0, 0.1]}))
    result = session.register(progress=change)
    assert not result.success and 'register again' in result.message


def test_a_tool_is_not_verified_without_its_tip(field: Field) -> None:
    session = with_landmarks(field)
    send(session, surface_points(field), start=100.0)
    assert session.register().success
    hold_tool(session, surface_point(field, 40), 1000.0)
    answer = session.verify()
    assert not answer.success and 'probe.tip is not set' in answer.message


def test_bad_quaternions_are_rejected_under_their_own_cause() -> None:
    session = Session(KNOWN)
    session.collect(True)
    for stamp, w in ((1.0, 0.0), (2.0, float('nan')), (3.0, 0.998), (4.0, 1.0005)):
        cause = session.add(Sample(stamp, (0.0, 0.0, 0.0), 'cam', '/t',
                                   tool=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, w)))
        assert cause is (None if stamp == 4.0 else Rejection.BAD_QUATERNION)
    status = session.status()
    assert (status.received, status.kept, status.rejected['bad_quaternion']) == (4, 1, 3)
    assert np.allclose(session.points().positions, TIP)


def test_the_stroke_goes_on_when_the_tip_is_set(field: Field) -> None:
    session = Session(UNKNOWN, field)
    session.collect(True)
    for i in range(100):
        if i == 50:
            session.configure(KNOWN)
        place = surface_point(field, 0) + [1e-4 * i, 0.0, 0.0]
        assert session.add(tool_sample(i / RATE, place, 0.01 * i)) is None
    assert session.status().strokes == 1


@pytest.mark.parametrize('now, tip, same_pose', [
    (KNOWN, TIP, True), (UNKNOWN, TIP, True),
    (CONFIG.replaced({'probe.tip': [0.0, 0.0, 0.1]}), [0.0, 0.0, 0.1], False)],
    ids=['the same tip', 'no tip', 'another tip'])
def test_a_session_file_keeps_poses_and_tip(field: Field, tmp_path: Path, now: Config,
                                            tip: list[float], same_pose: bool) -> None:
    session = collected(field, KNOWN)
    assert session.register().success
    write_session(tmp_path / 's.json', session.to_dict())
    loaded = Session(now, field)
    loaded.restore(read_session(tmp_path / 's.json'))
    assert loaded.config.probe.tip == tip
    assert np.array_equal(loaded.points().tools, session.points().tools)
    assert np.array_equal(loaded.points().positions, session.points().positions) == same_pose
    status = loaded.status()
    assert (status.pose_result is not None) == same_pose
    if not same_pose:
        assert status.withdrawn is not None
        loaded.configure(KNOWN)
        assert np.array_equal(loaded.points().positions, session.points().positions)
        assert np.allclose(loaded.landmarks().touched, session.landmarks().touched)


def test_a_journal_follows_the_tip(field: Field, tmp_path: Path) -> None:
    session = Session(UNKNOWN, field)
    journal = SessionJournal(tmp_path / 'j', print)
    session.listen(journal, from_start=True)
    session.collect(True)
    time = hold_tool(session, transform(T_TRACKER_BONE, LANDMARKS)[0], 0.0)
    assert session.capture_landmark().success
    for i, point in enumerate(surface_points(field, 50)):
        session.add(tool_sample(time + 10.0 + i, point, 0.02 * i))
    session.configure(KNOWN)
    session.add(tool_sample(1000.0, surface_point(field, 7)))
    journal.close()
    replay = Replay()
    assert read_journal(tmp_path / 'j', replay.apply) == ''
    resumed = Session(UNKNOWN, field)
    resumed.restore(replay.session)
    assert resumed.config.probe.tip == TIP
    for a, b in zip(resumed.points(), session.points()):
        assert np.array_equal(a, b, equal_nan=True)
    assert np.array_equal(resumed.landmarks().touched, session.landmarks().touched)
    assert 'probe.tip' not in resumed.status().message


def test_the_tip_survives_a_clear_in_the_journal(field: Field, tmp_path: Path) -> None:
    session = Session(KNOWN, field)
    journal = SessionJournal(tmp_path / 'j', print)
    session.listen(journal, from_start=True)
    session.collect(True)
    session.add(tool_sample(1.0, surface_point(field, 0)))
    session.clear()
    session.add(tool_sample(2.0, surface_point(field, 1)))
    journal.close()
    replay = Replay()
    read_journal(tmp_path / 'j', replay.apply)
    resumed = Session(UNKNOWN, field)
    resumed.restore(replay.session)
    assert resumed.config.probe.tip == TIP and resumed.status().kept == 1


@pytest.mark.parametrize('change', [{'tool_qw': 0.5}, {'tool_x': 1e7}, {'tool_qx': float('nan')}])
def test_a_session_with_an_invalid_pose_is_damaged(field: Field, change: dict[str, float]) -> None:
    record = collected(field, KNOWN).to_dict()
    for name, value in change.items():
        record['points'][name][3] = value
    with pytest.raises(InputError, match='damaged'):
        Session(KNOWN, field).restore(record)
