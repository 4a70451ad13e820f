# SPDX-License-Identifier: Apache-2.0
"""Which positions of the probe in the air are kept, and where the shaft was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, on_plate, plate_field

from gsdf_registration.common.config import Config, GateConfig
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.common.samples import Points, Rejection, Sample, without_tools
from gsdf_registration.session import Session
from gsdf_registration.session.air import (
    CELL,
    MAX_POSITIONS,
    MAX_STEP,
    REACH,
    SHAFT,
    Air,
    positions,
    with_tip,
)
from gsdf_registration.session.events import Replay
from msg_adapters.session_file import read_session, write_session
from msg_adapters.session_journal import SessionJournal, read_journal

GATE = GateConfig()
AIR = Rejection.NOT_COLLECTING
TURNED = (0.0, 0.0, 1.0, 0.0)       # half a turn about z


def fly(air: Air, heights: Array, rejection: Rejection | None = AIR, start: float = 0.0) -> int:
    """Move the tip through these heights, 50 samples per second; return how many are kept."""
    return sum(len(air.add(Sample(start + 0.02 * k, (0.0, 0.0, float(z)), 'tracker', 'tip'), 0,
                           rejection, GATE)) for k, z in enumerate(heights))


UP, DOWN = np.arange(1, 11) * 0.004, np.arange(10, 0, -1) * 0.004
ON_BONE = np.zeros(5)


def test_a_way_from_the_bone_counts() -> None:
    air = Air()
    assert fly(air, ON_BONE, None) == 0
    assert fly(air, UP, start=1.0 - 0.9) == 10
    assert [row[2] for row in air.rows] == pytest.approx(UP)


def test_a_way_to_the_bone_counts_once_the_bone_is_reached() -> None:
    air = Air()
    assert fly(air, DOWN) == 0
    assert fly(air, ON_BONE, None, start=0.2) == 10


def test_a_way_that_never_meets_the_bone_does_not_count() -> None:
    air = Air()
    fly(air, np.tile(np.concatenate([UP, DOWN]), 5))
    assert air.rows == []


def test_a_jump_of_the_tracker_separates_a_way_from_the_bone() -> None:
    air = Air()
    fly(air, ON_BONE, None)
    assert fly(air, UP + 2.0 * MAX_STEP, start=0.1) == 0


def test_readings_that_jump_away_and_back_do_not_count_but_the_way_after_them_does() -> None:
    air = Air()
    fly(air, ON_BONE, None)
    fly(air, np.r_[0.004, 0.104, 0.105, 0.106, 0.008, 0.004], start=0.1)
    fly(air, ON_BONE, None, start=0.22)
    assert [row[2] for row in air.rows] == pytest.approx([0.004, 0.008])


def test_a_position_long_after_the_touch_does_not_count() -> None:
    air = Air()
    fly(air, ON_BONE, None)
    still = np.full(round(REACH / 0.02) + 10, 0.004)
    assert fly(air, still, start=0.1) == 1
    assert fly(air, UP, start=0.1 + 0.02 * len(still)) == 0


@pytest.mark.parametrize('cause', [Rejection.TOO_FAST, Rejection.NO_REFERENCE,
                                   Rejection.WRONG_FRAME, Rejection.POOR_QUALITY,
                                   Rejection.TOUCHED, Rejection.CALIBRATING])
def test_samples_rejected_for_another_cause_do_not_count(cause: Rejection) -> None:
    air = Air()
    fly(air, ON_BONE, None)
    assert fly(air, UP, cause, start=0.1) == 0
    fly(air, ON_BONE, None, start=0.3)
    assert air.rows == []


def test_one_position_is_kept_in_a_cell() -> None:
    air = Air()
    fly(air, ON_BONE, None)
    assert fly(air, CELL * (5.1 + 0.8 * np.linspace(0.0, 1.0, 20)), start=0.1) == 1


def test_the_number_of_positions_is_limited() -> None:
    air = Air()
    air.restore((CELL * k, 0.0, 0.5 * CELL) for k in range(MAX_POSITIONS + 100))
    assert len(air.rows) == MAX_POSITIONS


def test_another_tip_moves_the_positions_of_tools_only() -> None:
    tool = (0.1, 0.2, 0.3, *TURNED)
    assert with_tip([(1.0, 2.0, 3.0), (0.1, 0.2, 0.3, *tool)], [0.01, 0.0, -0.1]) == [
        (1.0, 2.0, 3.0), (pytest.approx(0.09), pytest.approx(0.2), pytest.approx(0.2), *tool)]


def test_the_shaft_is_behind_the_tip_in_the_air_and_on_the_bone() -> None:
    rows = [(0.1, 0.0, 0.0, 0.1, 0.0, 0.0, *TURNED)]
    stroke = Points(np.array([[0.0, 0.0, 0.001 * k] for k in range(5)]), np.arange(5.0),
                    np.ones(5, np.int32), np.zeros(5, np.int32),
                    np.array([[0.0, 0.0, 0.001 * k, *TURNED] for k in range(5)]))
    found = positions(rows, stroke, [], [2.0, 0.0, 0.0])
    # the tip in the air, its shaft, and that of the three inner points of the stroke
    assert len(found) == 1 + len(SHAFT) * (1 + 3)
    assert found[0].tolist() == [0.1, 0.0, 0.0]
    in_air, touching = found[1::4], found[2::4]
    np.testing.assert_allclose(in_air[:, 0], 0.1 - SHAFT, atol=1e-12)
    np.testing.assert_allclose(touching[:, 0], -SHAFT, atol=1e-12)
    np.testing.assert_allclose(touching[:, 2], 0.001, atol=1e-12)


def test_the_shaft_at_a_point_after_a_jump_does_not_count() -> None:
    heights = np.r_[0.0, 0.001, 0.002, 0.1, 0.101, 0.003]
    columns = np.arange(6.0), np.ones(6, np.int32), np.zeros(6, np.int32)
    at = np.column_stack([np.zeros((6, 2)), heights])
    points = Points(at, *columns, np.column_stack([at, np.tile(TURNED, (6, 1))]))
    found = positions([], points, [], [1.0, 0.0, 0.0])
    assert set(found[:, 2]) == {0.001}


def test_without_the_pose_of_a_tool_only_the_tip_counts() -> None:
    points = without_tools(np.zeros((4, 3)), np.arange(4.0), np.ones(4, np.int32),
                           np.zeros(4, np.int32))
    assert positions([(1.0, 2.0, 3.0)], points, [], [0.0, 0.0, 1.0]).tolist() == [[1.0, 2.0, 3.0]]
    assert positions([], points, [], []).shape == (0, 3)


def operate(session: Session) -> None:
    """Drag the tip over a plate in ten strokes; lift it between them while not collecting."""
    rng, clock = np.random.default_rng(0), 0.0

    def send(places: Array) -> None:
        nonlocal clock
        for place in transform(T_TRACKER_BONE, places):
            clock += 0.02
            session.add(Sample(clock, tuple(place.tolist()), 'tracker', 'tip'))
    for y in np.linspace(-0.03, 0.03, 10):
        stroke = on_plate(np.column_stack([np.linspace(-0.03, 0.03, 60), np.full(60, y)]))
        up = np.arange(1.0, 11.0)[:, None] * [0.0, 0.0, 0.002]
        session.collect(True)
        send(stroke + 1e-4 * rng.normal(size=stroke.shape))
        session.collect(False)
        send(stroke[-1] + up)


@pytest.fixture(scope='module')
def operated() -> tuple[Session, Replay]:
    """Return a session, and the record of its events."""
    replay = Replay()
    session = Session(Config.from_flat({'search.rotations': 60}), plate_field())
    session.listen(replay.apply)
    operate(session)
    return session, replay


def test_a_session_decides_by_the_air_on_which_side_the_bone_is(operated: Any) -> None:
    session, _ = operated
    assert 80 < len(session.air()) <= 100
    assert session.register().success
    session.configure(session.config.replaced({'collect.air': False}))
    assert session.air().shape == (0, 3)
    assert session.register().reason is Reason.AMBIGUOUS
    session.configure(session.config.replaced({'collect.air': True}))


def test_the_air_is_in_the_record_and_in_the_events(operated: Any) -> None:
    session, replay = operated
    assert len(session.to_dict()['air']) == len(session.air())
    assert replay.session['air'] == session.to_dict()['air']
    other = Session(Config(), plate_field())
    other.restore(session.to_dict())
    np.testing.assert_array_equal(other.air(), session.air())
    other.clear()
    assert len(other.air()) == 0


def test_the_air_is_in_the_session_file_and_in_the_journal(operated: Any, tmp_path: Path) -> None:
    session, _ = operated
    write_session(tmp_path / 'session.json', session.to_dict())
    assert read_session(tmp_path / 'session.json')['air'] == session.to_dict()['air']
    journal, replay = SessionJournal(tmp_path / 'journal', pytest.fail), Replay()
    other = Session(Config(), plate_field())
    other.listen(journal)
    operate(other)
    journal.close()
    assert read_journal(tmp_path / 'journal', replay.apply) == ''
    assert replay.session['air'] == other.to_dict()['air'] != []


@pytest.mark.parametrize('row', [[0.0, 0.0], [0.0, 0.0, float('nan')], [0.0, 0.0, 1e9],
                                 [0.0] * 10, 'abc', 3.0])
def test_a_session_with_a_damaged_position_in_the_air_is_not_loaded(operated: Any,
                                                                    row: Any) -> None:
    with pytest.raises(InputError, match='the session is damaged'):
        Session(Config(), plate_field()).restore(operated[0].to_dict() | {'air': [row]})


def test_a_tip_that_is_set_later_moves_the_air_of_the_session() -> None:
    session, replay = Session(Config.from_flat({'collect.automatic': False}), None), Replay()
    session.listen(replay.apply)
    for k in range(40):
        session.collect(k < 20)
        at = (0.0, 0.0, 0.002 * k)
        session.add(Sample(0.02 * k, at, 'tracker', 'tool', tool=(*at, 0.0, 0.0, 0.0, 1.0)))
    before = session.air()
    session.configure(session.config.replaced({'probe.tip': [0.01, 0.0, 0.0]}))
    np.testing.assert_allclose(session.air(), before + [0.01, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose([row[:3] for row in replay.session['air']], session.air(),
                               atol=1e-12)
    session.configure(session.config.replaced({'probe.shaft': [0.0, 0.0, 1.0]}))
    assert len(session.air()) > 10 * len(before)
