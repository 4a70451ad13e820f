# SPDX-License-Identifier: Apache-2.0
"""Test that regions are found for any pose of the bone."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import transform
from gsdf_registration.simulation import femur, hip
from gsdf_registration.simulation.probe import random_pose
from gsdf_registration.simulation.regions import RADIUS, named_patch

Surface = tuple[np.ndarray, np.ndarray]


def test_finds_the_acetabulum(hip_surface: Surface) -> None:
    T = random_pose(np.random.default_rng(3))
    patch = named_patch('acetabulum', transform(T, hip_surface[0]), hip_surface[1])
    assert np.linalg.norm(patch.corners.mean(axis=1) - T[:3, 3],
                          axis=1).max() < RADIUS['acetabulum'] + 0.001
    assert patch.approach @ T[:3, :3] @ hip.CUP_AXIS > 0.95


def test_finds_a_cup_with_the_roughness_of_a_segmentation(hip_surface: Surface) -> None:
    vertices, faces = hip_surface
    rough = vertices + 4.5e-4 * np.random.default_rng(0).normal(size=vertices.shape)
    found, smooth = (named_patch('acetabulum', v, faces) for v in (rough, vertices))
    assert np.linalg.norm(found.centre - smooth.centre) < 0.004


def test_finds_both_ends_of_the_femur(femur_surface: Surface) -> None:
    proximal = named_patch('proximal_femur', *femur_surface).corners.reshape(-1, 3)
    assert proximal[:, 2].min() > 0.34
    assert np.linalg.norm(proximal - 1e-3 * np.array(femur.HEAD), axis=1).min() < 0.025
    distal = named_patch('condyles', *femur_surface)
    assert distal.corners[..., 2].max() < 0.08 and distal.approach[2] < -0.9
    assert np.ptp(distal.corners[..., 0]) > 0.06        # both condyles


def test_finds_the_wider_end_of_a_long_bone(femur_surface: Surface) -> None:
    """There is no tibia in bags/; the wider end of a femur is the distal one."""
    patch = named_patch('proximal_tibia', *femur_surface, radius=0.03)
    assert patch.corners[..., 2].max() < 0.08


def test_rejects_the_wrong_bone(hip_surface: Surface, femur_surface: Surface) -> None:
    with pytest.raises(InputError, match='has no cup'):
        named_patch('acetabulum', *femur_surface)
    with pytest.raises(InputError, match='has no head'):
        named_patch('proximal_femur', *hip_surface)
    with pytest.raises(InputError, match='is unknown'):
        named_patch('skull', *hip_surface)
