# SPDX-License-Identifier: Apache-2.0
"""The replay of a recording: reproducible to the bit, with strokes, frames and rejections."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gsdf_registration.common.config import Config
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import angle_between, exp, inverse, transform
from gsdf_registration.field import Field, build_field
from gsdf_registration.field.model import load_model
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.session.replay import replay
from gsdf_registration.simulation.moving import Sway
from msg_adapters.bag import read_bag
from msg_adapters.bag_writer import BagWriter
from msg_adapters.recording import RecordedTransform, Recording
from msg_adapters.truth import Truth

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


def test_two_replays_are_equal_to_the_bit(field: Field) -> None:
    guess = T_TRACKER_BONE @ exp([0.02, -0.02, 0.02, 0.002, 0.001, 0.0])
    (a, _), (b, _) = (replay(recording(field), field, T_tracker_bone=guess) for _ in range(2))
    assert a.success and a.T_tracker_bone.tobytes() == b.T_tracker_bone.tobytes()
    assert a.residuals_m.tobytes() == b.residuals_m.tobytes()


@pytest.mark.parametrize(('name', 'mesh'), [('optical_recording', 'hip_bone'),
                                            ('em_recording', 'femur_bone')])
def test_finds_the_true_pose_of_the_shipped_recordings(name: str, mesh: str,
                                                       request: pytest.FixtureRequest,
                                                       tmp_path: Path,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path))
    recorded, truth = request.getfixturevalue(name)
    bone = load_model(str(request.getfixturevalue(mesh)), truth.model_unit)
    touched = Landmarks.of(truth.landmarks_model, truth.landmarks_tracker)
    (result, session), (again, _) = (replay(recorded, bone, landmarks=touched) for _ in range(2))
    assert result.success
    assert result.T_tracker_bone.tobytes() == again.T_tracker_bone.tobytes()
    assert result.covariance.tobytes() == again.covariance.tobytes()
    assert np.degrees(angle_between(result.T_tracker_bone[:3, :3],
                                    truth.T_tracker_bone[:3, :3])) < 1.0
    centroid = recorded.positions.mean(axis=0)
    moved = transform(truth.T_tracker_bone @ result.T_bone_tracker, centroid) - centroid
    assert np.linalg.norm(moved) < 1e-3
    assert session.status().frame_id == truth.frame_id


def test_counts_the_points_that_the_recording_dropped(field: Field) -> None:
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


def test_keeps_the_strokes_of_the_recording(field: Field) -> None:
    strokes = np.repeat([7, 3, 9, 3], 50)
    config = Config.from_flat({'gate.max_gap': 100.0, 'collect.automatic': False})
    _, session = replay(recording(field, strokes=strokes),
                        field,
                        config,
                        T_tracker_bone=T_TRACKER_BONE)
    assert session.points().strokes.tolist() == np.repeat([1, 2, 3, 4], 50).tolist()


def test_rejects_a_recording_without_stamps(field: Field) -> None:
    with pytest.raises(InputError, match='no stamps'):
        replay(recording(field, stamps=None), field)


def test_refuses_an_empty_recording(field: Field) -> None:
    result, _ = replay(Recording(positions=np.zeros((0, 3)), stamps=np.zeros(0)), field)
    assert not result.success and result.received == 0


SWAY = Sway(exp([0.3, -0.2, 0.5, 0.05, -0.1, -1.1]))      # of the array, about 0.15 m from the bone
STEP = 1.0 / 80.0       # s, between two points


def moving(field: Field, hidden: tuple[float, float] = (0.0, 0.0)) -> Recording:
    """Return `recording` of a bone that moves with its array, which is hidden for a while."""
    still = recording(field)
    points = transform(inverse(SWAY.T_tracker_body), still.positions)
    stamps = 1.7e9 + STEP * np.arange(200)
    seen = [transform(SWAY.pose(stamp), point) for stamp, point in zip(stamps, points)]
    transforms = [RecordedTransform(int(np.searchsorted(stamps, stamp)), stamp, SWAY.pose(stamp),
                                    'tracker')
                  for stamp in 1.7e9 - 0.004 + STEP * np.arange(201)
                  if not hidden[0] < stamp - 1.7e9 < hidden[1]]
    return recording(field, positions=np.array(seen), stamps=stamps, transforms=transforms)


WITH_ARRAY = Config.from_flat({'reference.topic': '/array', 'gate.max_speed': 100.0})


def test_finds_a_resultbone_with_a_reference_array(field: Field) -> None:
    guess = T_TRACKER_BONE @ exp([0.02, -0.02, 0.02, 0.002, 0.001, 0.0])
    T_array_tracker = inverse(SWAY.T_tracker_body)
    still, _ = replay(recording(field), field, T_tracker_bone=guess)
    result, session = replay(moving(field), field, WITH_ARRAY,
                             T_tracker_bone=T_array_tracker @ guess)
    assert result.success and session.status().frame_id == 'reference_array'
    assert session.status().kept == 200
    bone = field.surface_points.astype(float)
    off = transform(SWAY.T_tracker_body @ result.T_tracker_bone, bone) - transform(
        still.T_tracker_bone, bone)
    assert np.linalg.norm(off, axis=1).max() < 5e-5
    again, _ = replay(moving(field), field, WITH_ARRAY, T_tracker_bone=T_array_tracker @ guess)
    assert result.T_tracker_bone.tobytes() == again.T_tracker_bone.tobytes()


def test_counts_points_without_a_pose_of_the_array(field: Field) -> None:
    _, session = replay(moving(field, hidden=(0.5, 1.5)), field, WITH_ARRAY)
    status = session.status()
    assert status.received == 200 == status.kept + status.rejected['no_reference']
    assert status.rejected['no_reference'] == 81


def test_reports_a_recording_without_the_array(field: Field,
                                               caplog: pytest.LogCaptureFixture) -> None:
    result, session = replay(recording(field), field, WITH_ARRAY)
    assert not result.success and session.status().rejected['no_reference'] == 200
    assert '/array' in caplog.text


def test_a_looped_recording_gives_its_last_pass(
        field: Field, caplog: pytest.LogCaptureFixture) -> None:
    once = recording(field)
    twice = recording(field, positions=np.tile(once.positions, (2, 1)),
                      stamps=np.tile(1.7e9 + STEP * np.arange(200), 2))
    _, session = replay(twice, field, Config.from_flat({'gate.max_speed': 100.0}),
                        T_tracker_bone=T_TRACKER_BONE)
    np.testing.assert_array_equal(session.points().positions, once.positions)
    assert session.status().received == 200
    assert 'went back by 2.5 s' in caplog.text


def test_transforms_points_into_the_session_frame(field: Field) -> None:
    once = recording(field)
    T = exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    fixed = RecordedTransform(0, 0.0, T, 'world', 'tracker', True)
    _, session = replay(recording(field, transforms=[fixed]), field,
                        Config.from_flat({'probe.frame_id': 'world'}))
    assert session.status().frame_id == 'world'
    np.testing.assert_allclose(session.points().positions, transform(T, once.positions))


def test_finds_the_true_pose_from_a_bag_with_a_resultbone(
        optical_recording: tuple[Recording, Truth], hip_bone: Path, tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path))
    recorded, truth = optical_recording
    sway = Sway(truth.T_tracker_bone @ exp([0.2, 0.1, 0.0, 0.1, 0.0, 0.1]))
    T_array_tracker = inverse(sway.T_tracker_body)
    rng = np.random.default_rng(0)
    with BagWriter(tmp_path / 'moving') as bag:
        for stamp, point in zip(recorded.stamps, recorded.positions):
            seen = transform(sway.pose(stamp) @ T_array_tracker, point)
            bag.write_point('/probe/tip', stamp, seen, 'camera')
        for stamp in np.arange(recorded.stamps[0] - 0.004, recorded.stamps[-1] + STEP, STEP):
            noise = exp(np.r_[rng.normal(0.0, 2e-4, 3), rng.normal(0.0, 5e-5, 3)])
            bag.write_pose('/array', stamp, sway.pose(stamp) @ noise, 'camera',
                           received=stamp + 0.02)
    field = load_model(str(hip_bone), truth.model_unit)
    still, _ = replay(recorded, field,
                      landmarks=(truth.landmarks_model, truth.landmarks_tracker))
    result, session = replay(
        read_bag(tmp_path / 'moving', reference='/array'), field, WITH_ARRAY, landmarks=(
            truth.landmarks_model, transform(T_array_tracker, truth.landmarks_tracker)))
    assert result.success and session.status().rejected['no_reference'] == 0
    places = np.vstack([truth.landmarks_model, np.zeros((1, 3))])
    off = transform(sway.T_tracker_body @ result.T_tracker_bone, places) - transform(
        still.T_tracker_bone, places)
    assert np.linalg.norm(off, axis=1).max() < 1e-4
