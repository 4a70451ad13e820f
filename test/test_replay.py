# SPDX-License-Identifier: Apache-2.0
"""A recording gives the same bits every time, and what the session would give."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gsdf_registration.bone import make_bone
from gsdf_registration.config import Config
from gsdf_registration.field import Field, build_field
from gsdf_registration.model import load_model
from gsdf_registration.replay import replay
from gsdf_registration.result import InputError
from gsdf_registration.rigid import angle_between, exp, transform
from msg_adapters.recording import Recording

T_TRACKER_BONE = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])


@pytest.fixture(scope='module')
def field() -> Field:
    ball = trimesh.creation.icosphere(subdivisions=4)
    return build_field(make_bone(ball.vertices * [0.03, 0.045, 0.07], ball.faces), 0.002)


def recording(field: Field, **more: object) -> Recording:
    rows = np.linspace(0, len(field.surface_points) - 1, 200).astype(int)
    points = transform(T_TRACKER_BONE, field.surface_points[rows].astype(float))
    points += np.random.default_rng(0).normal(0.0, 0.0002, points.shape)
    return Recording(
        **{
            'positions': points, 'stamps': 1.7e9
            + np.arange(200), 'frame_ids': 'tracker', 'source_names': ('/probe/tip', ), **more
        })


def test_the_same_bits_twice(field: Field) -> None:
    guess = T_TRACKER_BONE @ exp([0.02, -0.02, 0.02, 0.002, 0.001, 0.0])
    (a, _), (b, _) = (replay(recording(field), field, T_tracker_bone=guess) for _ in range(2))
    assert a.success and a.T_tracker_bone.tobytes() == b.T_tracker_bone.tobytes()
    assert a.residuals_m.tobytes() == b.residuals_m.tobytes()


@pytest.mark.parametrize(('run', 'mesh'), [('optical_run', 'hip_bone'), ('em_run', 'femur_bone')])
def test_shipped_recordings_lead_to_the_truth(run: str, mesh: str, request: pytest.FixtureRequest,
                                              tmp_path: Path,
                                              monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path))
    recorded, truth = request.getfixturevalue(run)
    bone = load_model(str(request.getfixturevalue(mesh)), truth.model_unit)
    pairs = (truth.landmarks_model, truth.landmarks_tracker)
    (result, session), (again, _) = (replay(recorded, bone, landmarks=pairs) for _ in range(2))
    assert result.success
    assert result.T_tracker_bone.tobytes() == again.T_tracker_bone.tobytes()
    assert result.covariance.tobytes() == again.covariance.tobytes()
    assert np.degrees(angle_between(result.T_tracker_bone[:3, :3],
                                    truth.T_tracker_bone[:3, :3])) < 1.0
    touched = recorded.positions.mean(axis=0)
    moved = transform(truth.T_tracker_bone @ result.T_bone_tracker, touched) - touched
    assert np.linalg.norm(moved) < 1e-3
    assert session.status().frame_id == truth.frame_id


def test_what_the_recording_dropped_is_counted(field: Field) -> None:
    quality = np.full(200, 0.0001)
    quality[[3, 4]] = 0.01
    positions = recording(field).positions
    positions[10] = np.nan
    poor = recording(field, positions=positions, quality=quality, dropped={'tracking_state': 12})
    _, session = replay(poor, field, T_tracker_bone=T_TRACKER_BONE)
    status = session.status()
    assert status.received == 212 == status.result.received
    assert {cause: count for cause, count in status.rejected.items() if count} == {
        'tracking_state': 12, 'poor_quality': 2, 'not_finite': 1}


def test_strokes_of_the_recording_are_kept(field: Field) -> None:
    strokes = np.repeat([7, 3, 9, 3], 50)
    config = Config.from_flat({'gate.max_gap': 100.0, 'collect.automatic': False})
    _, session = replay(recording(field, strokes=strokes),
                        field,
                        config,
                        T_tracker_bone=T_TRACKER_BONE)
    assert session.points().strokes.tolist() == np.repeat([0, 1, 2, 3], 50).tolist()


def test_a_recording_without_stamps_is_refused(field: Field) -> None:
    with pytest.raises(InputError, match='no stamps'):
        replay(recording(field, stamps=None), field)


def test_an_empty_recording_is_a_refusal(field: Field) -> None:
    result, _ = replay(Recording(positions=np.zeros((0, 3)), stamps=np.zeros(0)), field)
    assert not result.success and result.received == 0
