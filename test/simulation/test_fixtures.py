# SPDX-License-Identifier: Apache-2.0
"""Test that bags/ is reproducible and that its ground truth is right."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exact import distances

from gsdf_registration.common.rigid import inverse, transform
from msg_adapters.bag import LANDMARK_TOPIC, read_bag
from msg_adapters.recording import Recording
from msg_adapters.truth import Truth

CHECKOUT = Path(__file__).parents[2]
Surface = tuple[np.ndarray, np.ndarray]


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
