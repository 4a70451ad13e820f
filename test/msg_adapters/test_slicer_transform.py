# SPDX-License-Identifier: Apache-2.0
"""Test the transform files for 3D Slicer with ITK itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import SimpleITK  # noqa: N813

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, exp
from msg_adapters.slicer_transform import write_transform

T = exp([0.3, -0.5, 0.8, 0.1, 0.25, -0.4])      # T_tracker_bone
BONE = np.array([[0.01, 0.02, 0.03], [-0.04, 0.05, 0.06]])
FLIP = np.array([-1.0, -1.0, 1.0])


def moved_by_slicer(path: Path, points_ras: Array) -> Array:
    """Return points (n, 3), m, RAS, as Slicer moves them with a transform that it has loaded."""
    to_parent = SimpleITK.ReadTransform(str(path)).GetInverse()
    return 1e-3 * FLIP * [to_parent.TransformPoint((1e3 * FLIP * point).tolist())
                          for point in points_ras]


@pytest.mark.parametrize('ending', ['tfm', 'h5'])
@pytest.mark.parametrize('model', ['lps', 'ras'])
@pytest.mark.parametrize('tracker', ['lps', 'ras'])
def test_slicer_moves_the_model_to_the_tracker_frame(tmp_path: Path, ending: str, model: str,
                                                     tracker: str) -> None:
    path = tmp_path / f'pose.{ending}'
    write_transform(path, T, model, tracker)
    # Slicer shows model and tracked points in RAS
    bone_ras = BONE if model == 'ras' else FLIP * BONE
    touched = BONE @ T[:3, :3].T + T[:3, 3]
    touched_ras = touched if tracker == 'ras' else FLIP * touched
    np.testing.assert_allclose(moved_by_slicer(path, bone_ras), touched_ras, atol=1e-12)


def test_the_text_file_is_the_inverse_in_millimetres(tmp_path: Path) -> None:
    write_transform(tmp_path / 'pose.tfm', T)
    values = SimpleITK.ReadTransform(str(tmp_path / 'pose.tfm')).GetParameters()
    np.testing.assert_allclose(np.reshape(values[:9], (3, 3)), T[:3, :3].T, atol=1e-15)
    np.testing.assert_allclose(values[9:], -1e3 * T[:3, :3].T @ T[:3, 3])


def test_another_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='has the ending .tfm or .h5'):
        write_transform(tmp_path / 'pose.mat', T)
