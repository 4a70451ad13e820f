# SPDX-License-Identifier: Apache-2.0
"""Test that bags/ is reproducible and that its ground truth is right."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exact import distances

from gsdf_registration.common.rigid import angle_between, inverse, transform
from msg_adapters.bag import LANDMARK_TOPIC, read_bag
from msg_adapters.recording import Recording
from msg_adapters.tool_poses import read_tool_poses
from msg_adapters.truth import Truth, read_truth

CHECKOUT = Path(__file__).parents[2]
Surface = tuple[np.ndarray, np.ndarray]
PROBE, ARRAY = '/probe/measured_cp', '/array/measured_cp'


def test_bags_are_reproduced_bit_for_bit(bags: Path, tmp_path: Path) -> None:
    pytest.importorskip('skimage')
    subprocess.run([sys.executable, '-m', 'benchmarks', 'fixtures', tmp_path],
                   cwd=CHECKOUT,
                   check=True,
                   capture_output=True,
                   env={'PYTHONPATH': str(CHECKOUT), 'PATH': ''})
    made = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob('*') if path.is_file())
    shipped = sorted(path.relative_to(bags) for path in bags.rglob('*') if path.is_file())
    assert made == [path for path in shipped if path.name != 'README.md']
    for path in made:
        assert (tmp_path / path).read_bytes() == (bags / path).read_bytes(), path


@pytest.mark.parametrize('recording, surface, sigma, rate', [
    ('optical_recording', 'hip_surface', 0.15e-3, 80.0),
    ('em_recording', 'femur_surface', 0.4e-3, 40.0)])
def test_recording_is_on_the_bone_at_the_true_pose(request: pytest.FixtureRequest,
                                                   recording: str, surface: str, sigma: float,
                                                   rate: float) -> None:
    points, truth = request.getfixturevalue(recording)
    vertices, faces = request.getfixturevalue(surface)
    assert set(points.frame_ids) == {truth.frame_id}
    assert abs(np.median(np.diff(points.stamps)) - 1.0 / rate) < 0.05 / rate
    tips = transform(inverse(truth.T_tracker_bone), points.positions)
    off = distances(tips, vertices[faces], within=0.01)
    on = off < 5.0 * sigma
    share = truth.about['outlier_share']
    assert 0.02 < share < 0.06
    assert abs(1.0 - on.mean() - share) < 0.02
    assert 0.8 * sigma < np.sqrt((off[on] ** 2).mean()) < 1.1 * sigma
    # within the measurement volume of a tracker
    assert 0.9 < np.abs(truth.T_tracker_bone[2, 3]) < 1.7


@pytest.mark.parametrize('recording, surface', [('optical_recording', 'hip_surface'),
                                          ('em_recording', 'femur_surface')])
def test_landmarks_are_on_the_bone_and_touched_nearby(request: pytest.FixtureRequest,
                                                      recording: str, surface: str) -> None:
    truth: Truth = request.getfixturevalue(recording)[1]
    vertices, faces = request.getfixturevalue(surface)
    assert len(truth.landmark_names) == 3
    assert distances(truth.landmarks_model, vertices[faces]).max() < 1e-5
    touched = transform(inverse(truth.T_tracker_bone), truth.landmarks_tracker)
    miss = np.linalg.norm(touched - truth.landmarks_model, axis=1)
    assert miss.min() > 0.0015 and miss.max() < 0.0045


def test_optical_landmarks_precede_the_scan(optical_recording: tuple[Recording, Truth],
                                            optical_bag: Path) -> None:
    landmarks = read_bag(optical_bag, [LANDMARK_TOPIC])
    assert landmarks.stamps is not None and optical_recording[0].stamps is not None
    assert landmarks.stamps.max() + 1.0 < optical_recording[0].stamps.min()
    touches = np.split(landmarks.positions, np.flatnonzero(np.diff(landmarks.stamps) > 1.0) + 1)
    np.testing.assert_allclose([positions.mean(axis=0) for positions in touches],
                               optical_recording[1].landmarks_tracker, atol=2e-5)


def test_tool_poses_are_on_the_bone_seen_from_the_moving_array(
        bags: Path, femur_surface: Surface) -> None:
    bag, truth = bags / 'femur_tool', read_truth(bags / 'femur_tool.yaml')
    probe, array = read_tool_poses(bag, topic=PROBE), read_tool_poses(bag, topic=ARRAY)
    _, rows, at = np.intersect1d(probe.stamps, array.stamps, return_indices=True)
    assert 0.9 * len(probe.stamps) < len(rows) < len(probe.stamps)      # both drop out
    T = np.linalg.inv(array.T_tracker_body[at]) @ probe.T_tracker_body[rows]
    tips = transform(inverse(truth.T_tracker_bone),
                     T[:, :3, :3] @ truth.about['tip'] + T[:, :3, 3])
    vertices, faces = femur_surface
    off = distances(tips, vertices[faces], within=0.01) - 1e-3 * truth.about['tip_radius']
    on = np.abs(off) < 0.002
    assert 0.55 < on.mean() < 0.8       # the rest is in the air
    assert 1e-4 < np.sqrt((off[on] ** 2).mean()) < 8e-4
    assert np.diff(array.stamps).max() > 0.1        # a gap
    moved = array.T_tracker_body[:, :3, 3]
    assert 0.02 < np.linalg.norm(moved - moved[0], axis=1).max() < 0.1


def test_tool_poses_turn_about_divot_and_hip(bags: Path) -> None:
    bag, about = bags / 'femur_tool', read_truth(bags / 'femur_tool.yaml').about
    for topic, point, spread in (('/probe/pivoting', about['tip'], 1e-3),
                                 ('/array/swinging', about['hip_centre']['array'], 5e-3)):
        T = read_tool_poses(bag, topic=topic).T_tracker_body
        places = T[:, :3, :3] @ point + T[:, :3, 3]
        assert np.linalg.norm(places - places.mean(axis=0), axis=1).mean() < spread
        assert angle_between(T[0, :3, :3], T[len(T) // 2, :3, :3]) > np.radians(5.0)
