# SPDX-License-Identifier: Apache-2.0
"""The events of a session reproduce its state, whatever happens to it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from session_fixtures import sample

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field, build_field
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.session import Session
from gsdf_registration.session import session as session_module
from gsdf_registration.session.events import Replay
from gsdf_registration.session.record import NAMES, column
from msg_adapters.packed_rows import packed, unpacked

CONFIG = Config.from_flat({'landmarks.names': ['x', 'y', 'z'], 'landmarks.positions': [
    0.03, 0.0, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0, 0.03], 'landmarks.dwell': 0.05})


@pytest.fixture(scope='module')
def field() -> Field:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    return build_field(make_bone(ball.vertices, ball.faces), 0.005)


class Follower:
    """Applies the events it receives, after a round trip through JSON."""

    def __init__(self) -> None:
        self.replay = Replay()

    def __call__(self, event: str, value: Any) -> None:
        text = json.dumps(value, allow_nan=False, default=packed)
        self.replay.apply(event, json.loads(text, object_hook=unpacked))


def known(session: dict[str, Any]) -> dict[str, Any]:
    """
    Return the part of a record that events reproduce.

    It has no settings, no counts of 0, and the frame while there is nothing in it.
    """
    content = len(session['points']) or session['landmarks'] or session['verifications']
    frames = session['frames']
    values = {key: value for key, value in session.items()
              if key not in ('versions', 'parameters', 'frames', 'rejected', 'points')}
    return json.loads(json.dumps(values)) | {
                'points': {name: str(column(session['points'], name).tolist())
                           for name in NAMES},
                'rejected': {cause: count for cause, count in session['rejected'].items() if count},
                'frames': (frames['points'] if content else None, frames['pose'])}


def registers(points: np.ndarray, *_: Any, **__: Any) -> RegistrationResult:
    """Stand in for `register`: accepted with an even number of points."""
    if len(points) % 2:
        return RegistrationResult.refused(Reason.AMBIGUOUS, 'no')
    residuals = np.where(np.arange(len(points)) % 3 == 0, np.nan, 1e-4)
    return RegistrationResult(Reason.CONVERGED, 'found', np.eye(4), covariance=np.eye(6),
                              residuals_m=residuals, weights=np.isfinite(residuals).astype(float))


ACTS = ['drag', 'drag', 'drag', 'hold', 'hold', 'landmark', 'verify', 'register', 'register',
        'undo', 'drop', 'clear', 'start', 'end', 'other probe', 'bad', 'load', 'model', 'withdraw']


def act(session: Session, what: str, at: dict[str, float], saved: list[Any], field: Field) -> None:
    def send(count: int, step: float, topic: str = '/probe/tip', frame: str = 'cam') -> None:
        for _ in range(count):
            at['t'] += 0.0125
            at['x'] += step
            session.add(sample(at['t'], (at['x'], np.sin(30.0 * at['x']), -1.0), frame, topic))
    acts = {
        'drag': lambda: send(7, 0.0003), 'hold': lambda: send(9, 1e-6),
        'landmark': session.capture_landmark, 'verify': session.verify,
        'register': session.register, 'undo': session.undo, 'clear': session.clear,
        'drop': lambda: session.drop_stroke(session.status().strokes - 1),
        'start': lambda: session.collect(True), 'end': lambda: session.collect(False),
        'other probe': lambda: send(3, 0.0003, '/second'),
        'bad': lambda: send(2, 0.0003, frame='elsewhere'),
        'load': lambda: session.restore(saved[-1]) if saved else saved.append(session.to_dict()),
        'model': lambda: session.set_model(field),
        'withdraw': lambda: session.withdraw_pose(Withdrawal.POINTS_DROPPED, 'no'),
    }
    acts[what]()


@settings(deadline=None, max_examples=150)
@given(st.lists(st.sampled_from([*ACTS, 'another listener']), max_size=40))
def test_events_reproduce_the_session(field: Field, acts: list[str]) -> None:
    session, follower = Session(CONFIG, field), Follower()
    session.listen(follower)
    at, saved = {'t': 0.0, 'x': 0.0}, []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(session_module, 'register', registers)
        for what in acts:
            if what == 'another listener':
                session.stop_listening(follower)
                follower = Follower()
                session.listen(follower, from_start=True)
            else:
                act(session, what, at, saved, field)
            assert known(follower.replay.session) == known(session.to_dict()), what
    restored = Session(CONFIG, field)
    restored.restore(follower.replay.session)
    for name in ('kept', 'strokes', 'landmarks', 'rejected', 'reason', 'pose_frame_id',
                 'verification', 'stroke_reports'):
        assert getattr(restored.status(), name) == getattr(session.status(), name), name
    assert not restored.status().outdated


def test_events_reproduce_a_change_of_the_bone(
        field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_module, 'register', registers)
    session, follower = Session(CONFIG), Follower()
    session.listen(follower)
    at: dict[str, float] = {'t': 0.0, 'x': 0.0}
    for what in ('hold', 'landmark', 'drag', 'drag'):
        act(session, what, at, [], field)
    assert follower.replay.session['model_sha256'] is None
    session.set_model(field)
    assert session.register().success
    assert follower.replay.session['pose_result'] is not None
    assert len(follower.replay.session['landmarks']) == 1
    cube = trimesh.creation.box([0.05] * 3)
    session.set_model(build_field(make_bone(cube.vertices, cube.faces), 0.005))
    assert known(follower.replay.session) == known(session.to_dict())
    assert follower.replay.session['pose_result'] is None
    assert follower.replay.session['landmarks'] == []
    assert len(follower.replay.session['points']) == 14


@pytest.mark.parametrize('event, value', [
    ('magic', 1), ('point', [1, 0, 1.0]), ('point', None), ('undo', None), ('registration', {}),
    ('withdrawn', [1]), ('rejected', 3), ('session', 4),
])
def test_rejects_invalid_events(event: str, value: Any) -> None:
    replay = Replay()
    replay.apply('point', [1, 0, 1.0, 0.0, 0.0, 0.0])
    try:
        replay.apply(event, value)
    except (KeyError, TypeError, ValueError, AttributeError):
        return
    assert (event, value) == ('undo', None)     # no stroke has the number None
    assert len(replay.session['points']) == 1
