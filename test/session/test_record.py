# SPDX-License-Identifier: Apache-2.0
"""A session that is saved and loaded."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from session_fixtures import (
    CONFIG,
    LANDMARKS,
    T_TRACKER_BONE,
    bone,
    hold,
    registered,
    sample,
    surface_point,
)

from gsdf_registration.common.result import (
    InputError,
    Reason,
    RegistrationResult,
    WeakestDirection,
)
from gsdf_registration.common.rigid import transform
from gsdf_registration.field import Field
from gsdf_registration.session import Session
from gsdf_registration.session import session as session_module
from gsdf_registration.session.record import SessionRecord
from msg_adapters.packed_rows import packed, unpacked


def through_json(record: dict[str, Any]) -> dict[str, Any]:
    """Return a record as it is after it was written and read."""
    text = json.dumps(record, allow_nan=False, default=packed)
    found: dict[str, Any] = json.loads(text, object_hook=unpacked)
    return found | {'points': found['points'].copy()}


def test_a_session_survives_json(field: Field) -> None:
    session = registered(field)
    hold(session, transform(T_TRACKER_BONE, LANDMARKS[0]), 1000.0)
    session.verify()
    record = through_json(session.to_dict())
    assert record['parameters'] == CONFIG.flat() and record['model_sha256'] == field.bone_sha256
    assert len(record['verifications']) == 1
    other = Session(CONFIG, field)
    other.restore(record)
    assert all(np.array_equal(a, b, equal_nan=True)
               for a, b in zip(other.points(), session.points()))
    before, after = session.status(), other.status()
    for name in ('state', 'received', 'kept', 'rejected', 'strokes', 'landmarks', 'frame_id',
                 'pose_frame_id'):
        assert getattr(before, name) == getattr(after, name), name
    assert np.array_equal(after.pose_result.T_tracker_bone, before.pose_result.T_tracker_bone)
    assert np.array_equal(after.pose_result.covariance, before.pose_result.covariance)
    assert json.dumps(other.to_dict(), default=packed) == json.dumps(record, default=packed)
    assert np.array_equal(other.register().T_tracker_bone, session.register().T_tracker_bone)


def test_unknown_values_are_saved_as_null(field: Field,
                                          monkeypatch: pytest.MonkeyPatch) -> None:
    result = RegistrationResult(Reason.CONVERGED,
                                'found',
                                T_tracker_bone=np.eye(4),
                                sigma_m=float('nan'))
    monkeypatch.setattr(session_module, 'register', lambda *_, **__: result)
    session = Session(CONFIG, field)
    session.register()
    record = through_json(session.to_dict())
    session.restore(record)
    loaded = session.status().result
    assert loaded == dataclasses.replace(
        result, sigma_m=None, T_tracker_bone=loaded.T_tracker_bone, residuals_m=loaded.residuals_m,
        weights=loaded.weights, rejected=loaded.rejected)


def test_rejects_a_session_of_another_bone(field: Field) -> None:
    record = registered(field).to_dict()
    with pytest.raises(InputError, match='another bone'):
        Session(CONFIG, bone(width=0.035)).restore(record)
    with pytest.raises(InputError, match='load the bone model'):
        Session(CONFIG).restore(record)
    with pytest.raises(InputError, match='no bone model'):
        Session(CONFIG).to_dict()


TEXT = [(name, 'S9') for name in ('stroke', 'source', 'stamp', 'x', 'y', 'z')]


def set_column(record: dict[str, Any], name: str, value: float) -> None:
    """Change a value of the first point, in a table like one that was read from a file."""
    points = record['points']
    points = points.astype([(column, '<f8') for column in points.dtype.names])
    points[name][0] = value
    record['points'] = points


@pytest.mark.parametrize('damage', [
    lambda r: r.pop('points'), lambda r: r.update(points=r['points'][['stroke', 'x']]),
    lambda r: set_column(r, 'stroke', 0), lambda r: set_column(r, 'source', 1),
    lambda r: set_column(r, 'stroke', 1.5), lambda r: set_column(r, 'source', -1),
    lambda r: set_column(r, 'stroke', np.nan), lambda r: set_column(r, 'stroke', 2.0**31),
    lambda r: r['landmarks'][0].pop('model'),
    lambda r: r['landmarks'][0].update(tracker=[1.0, 2.0]),
    lambda r: r.update(result={'reason': 'magic'}), lambda r: r.update(landmarks=7),
    lambda r: set_column(r, 'x', np.nan), lambda r: r.update(points=[1.0] * 16),
    lambda r: r.update(points=[[1, 0, 0.5, 0.0, 0.0, 0.0, None, None]]),
    lambda r: r['pose_result'].update(T_tracker_bone=[[1.0]]),
    lambda r: r['result'].update(T_tracker_bone=None),
    lambda r: r['pose_result'].update(covariance=[1.0]),
    lambda r: r['pose_result']['predicted_tre_m'].update(rms='x'),
    lambda r: r['pose_result'].update(message=1.5), lambda r: r['result'].update(used='7'),
    lambda r: r['result'].update(inliers=-1), lambda r: r['result'].update(sigma_m=True),
    lambda r: r['result'].update(received=1.5), lambda r: r['result'].pop('used'),
    lambda r: r['result'].update(timing_s=[1.0]), lambda r: r['result'].update(used=None),
    lambda r: r['pose_result']['weakest_direction'].update(sentence=None),
    lambda r: r['pose_result']['weakest_direction'].update(axis=[0.0, 1.0]),
    lambda r: r['pose_result'].update(reason='ambiguous'), lambda r: r.update(collecting=1),
    lambda r: r['rejected'].update(stale=-1), lambda r: r['rejected'].update(stale=1.5),
    lambda r: r.update(rejected=[1]), lambda r: r.update(sources=[1]),
    lambda r: r['frames'].update(points=1), lambda r: r['frames'].update(pose=None),
    lambda r: r['landmarks'][0].update(name=1), lambda r: r['landmarks'][0].update(stamp='now'),
    lambda r: set_column(r, 'x', 1e9), lambda r: set_column(r, 'stamp', np.inf),
    lambda r: set_column(r, 'weight', 2.0), lambda r: set_column(r, 'residual', np.inf),
    lambda r: r.update(points=np.zeros(3, TEXT)), lambda r: r.update(points='AAAA'),
])
def test_rejects_a_damaged_session_and_keeps_its_state(field: Field,
                                                       damage: Callable[[Any], Any]) -> None:
    session = registered(field)
    record = through_json(session.to_dict())
    damage(record)
    before = session.status()
    with pytest.raises(InputError, match='damaged'):
        session.restore(record)
    assert session.status() == before


def test_infinite_values_are_restored(field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    screw = WeakestDirection(np.eye(3)[0], np.zeros(3), np.inf, 0.0, np.inf, 'along x')
    result = RegistrationResult(Reason.CONVERGED, 'found', np.eye(4), weakest_direction=screw,
                                predicted_tre_m={'rms': np.inf, 'max': 0.5})
    monkeypatch.setattr(session_module, 'register', lambda *_, **__: result)
    session = Session(CONFIG, field)
    session.register()
    session.restore(through_json(session.to_dict()))
    loaded = session.status().result
    assert loaded is not None and loaded.weakest_direction is not None
    assert loaded.weakest_direction.pitch_m_per_rad == np.inf
    assert loaded.weakest_direction.translation_sigma_m == np.inf
    assert loaded.predicted_tre_m == {'rms': None, 'max': 0.5}


def test_points_are_added_while_a_session_is_converted(field: Field,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    session, record = registered(field), registered(field).to_dict()
    added: list[Any] = []

    def convert(*given: Any) -> SessionRecord:
        added.append(session.add(sample(2000.0, surface_point(field, 3))))  # waits if it is locked
        return real(*given)
    real = SessionRecord.from_dict
    monkeypatch.setattr(SessionRecord, 'from_dict', convert)
    session.restore(record)
    assert added == [None] and session.status().kept == 300
