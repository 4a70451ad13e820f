# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks phantom``: reads the published files, and compares with targets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from smooth_bone import T_TRACKER_BONE, ball_mesh, touched_points

from benchmarks.__main__ import main
from benchmarks.phantom.recording import DRAG, MODEL, SCRIPT, TOUCHED, read_phantom
from benchmarks.phantom.targets import target_errors
from gsdf_registration.common import rigid
from gsdf_registration.common.result import InputError, Reason, RegistrationResult
from gsdf_registration.common.rigid import Array

SIGMA = 1e-4        # m, of a point
TARGETS = 0.03 * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.2], [0.0, 0.3, 1.0], [-1.0, 0.5, 0.0],
                           [0.4, -1.0, 0.5], [0.2, 0.1, -1.0], [0.6, 0.6, 0.6]])


def touched(places: Array, seed: int, sigma: float = SIGMA) -> Array:
    noise = sigma * np.random.default_rng(seed).normal(size=places.shape)
    return rigid.transform(T_TRACKER_BONE, places) + noise


def write_csv(path: Path, positions: Array) -> None:
    rows = [f'{0.025 * k:.3f},' + ','.join(f'{1e3 * value:.4f}' for value in position)
            for k, position in enumerate(positions)]
    path.write_text('\n'.join(['time,x,y,z', *rows]))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with files as published, of a bone-like body."""
    mesh = ball_mesh(np.array([0.012, 0.02, 0.03]))
    savemat(tmp_path / MODEL, {'ver': 1e3 * mesh.vertices, 'tri': mesh.faces + 1})
    drag = touched_points(500, 0, mesh=mesh)
    write_csv(tmp_path / DRAG, touched(drag[np.argsort(drag[:, 0])], 1))
    write_csv(tmp_path / TOUCHED, touched(TARGETS, 2, 1e-3))
    text = [';\n  '.join(', '.join(f'{1e3 * value:.4f}' for value in row) for row in rows)
            for rows in (TARGETS[:3], TARGETS[3:])]
    (tmp_path / SCRIPT).write_text(
        f"load('mesh_hip.mat');\nTar_fea=[{text[0]}]; %landmarks\nhip_keypoints=[{text[1]}];\n")
    return tmp_path


def test_reads_the_published_files(folder: Path) -> None:
    phantom = read_phantom(folder)
    assert len(phantom.drag) == 500
    assert phantom.landmarks.shape == (2, 3, 3) and phantom.targets.shape == (2, 4, 3)
    np.testing.assert_allclose(phantom.targets[0], TARGETS[3:], atol=1e-7)
    np.testing.assert_allclose(phantom.targets[1], touched(TARGETS, 2, 1e-3)[3:], atol=1e-7)


def test_prints_a_line_for_each_of_the_settings(folder: Path,
                                                capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['phantom', str(folder)]) == 0
    printed = capsys.readouterr().out
    assert '500 samples, 4 targets' in printed
    assert 'default settings' in printed and 'published method, from landmarks' in printed


@pytest.mark.parametrize('name', [MODEL, DRAG, TOUCHED, SCRIPT])
def test_names_a_file_that_is_missing(folder: Path, name: str,
                                      capsys: pytest.CaptureFixture[str]) -> None:
    (folder / name).unlink()
    assert main(['phantom', str(folder)]) == 2
    assert name in capsys.readouterr().err


def test_names_a_matrix_that_is_missing(folder: Path) -> None:
    (folder / SCRIPT).write_text('hip_keypoints=[1, 2, 3];')
    with pytest.raises(InputError, match='has no matrix Tar_fea'):
        read_phantom(folder)


def test_names_a_number_of_places_that_does_not_match(folder: Path) -> None:
    write_csv(folder / TOUCHED, touched(TARGETS, 2)[:-1])
    with pytest.raises(InputError, match='has 6 places, but .* 3 landmarks and 4 targets'):
        read_phantom(folder)


def test_the_difference_to_the_targets_has_the_covariance_of_both() -> None:
    """Chi-square of 400 differences: 6 on average, whatever the shares of pose and targets."""
    rng = np.random.default_rng(0)
    for pose_sd, target_sd in ((1e-3, 1e-5), (1e-3, 5e-4), (1e-5, 5e-4)):
        found = []
        covariance = pose_sd**2 * np.diag([1.0, 1.0, 1.0, 400.0, 400.0, 400.0])
        for _ in range(400):
            noise = rng.multivariate_normal(np.zeros(6), covariance)
            T = T_TRACKER_BONE.copy()       # x y z and a rotation about the fixed axes, REP-103
            T[:3, :3] = rigid.rotation_exp(noise[3:]) @ T[:3, :3]
            T[:3, 3] += noise[:3]
            result = RegistrationResult(Reason.CONVERGED, '', T_tracker_bone=T,
                                        covariance=covariance)
            places = rigid.transform(T_TRACKER_BONE, TARGETS)
            places = places + target_sd * rng.normal(size=places.shape)
            found.append(target_errors(result, np.stack([TARGETS, places])))
        assert np.mean([each.chi_square for each in found]) == pytest.approx(6.0, rel=0.25)
        expected = np.mean([each.stated**2 + each.of_targets**2 for each in found])
        assert np.mean([each.difference**2 for each in found]) == pytest.approx(expected, rel=0.15)
