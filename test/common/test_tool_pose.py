# SPDX-License-Identifier: Apache-2.0
"""Test the poses of a tool and the position of its tip."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.rigid import (
    exp,
    from_rt,
    quaternion_from_rotation,
    rotation_exp,
    transform,
)
from gsdf_registration.common.tool_pose import (
    ToolPose,
    is_valid,
    mean_pose,
    moved,
    normalized,
    tip_position,
    tip_positions,
)

TIP = [0.012, -0.021, 0.148]


def pose(T: np.ndarray) -> ToolPose:
    x, y, z, qx, qy, qz, qw = (*T[:3, 3].tolist(), *quaternion_from_rotation(T[:3, :3]).tolist())
    return x, y, z, qx, qy, qz, qw


def poses(count: int = 50) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [from_rt(rotation_exp(rng.normal(size=3)), rng.normal(size=3)) for _ in range(count)]


def test_the_tip_is_where_the_pose_maps_it() -> None:
    for T in poses():
        assert np.allclose(tip_position(pose(T), TIP), transform(T, TIP), atol=1e-14)
        assert tip_position(pose(T), []) == tuple(T[:3, 3])


def test_an_array_gives_the_same_bits_as_single_poses() -> None:
    tools = np.array([pose(T) for T in poses()])
    tools[7] = np.nan
    single = [tip_position(tuple(tool), TIP) for tool in tools.tolist()]
    assert np.array_equal(tip_positions(tools, TIP), single, equal_nan=True)


def test_a_pose_moves_with_its_frame() -> None:
    T_a_b = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])
    for T in poses():
        assert np.allclose(tip_position(moved(T_a_b, pose(T)), TIP), transform(T_a_b @ T, TIP),
                           atol=1e-14)


@pytest.mark.parametrize('quaternion, valid', [
    ((0.0, 0.0, 0.0, 1.0), True), ((0.0, 0.0, 0.0, 1.0009), True), ((0.0, 0.6, 0.0, -0.8), True),
    ((0.0, 0.0, 0.0, 0.0), False), ((0.0, 0.0, 0.0, 1.0011), False),
    ((0.0, 0.0, 0.0, float('nan')), False), ((float('inf'), 0.0, 0.0, 0.0), False)])
def test_only_a_unit_quaternion_is_an_orientation(quaternion: tuple[float, ...],
                                                  valid: bool) -> None:
    qx, qy, qz, qw = quaternion
    tool = (1.0, 2.0, 3.0, qx, qy, qz, qw)
    assert is_valid(tool) == valid
    if valid:
        assert np.linalg.norm(normalized(tool)[3:]) == pytest.approx(1.0, abs=1e-15)


def test_the_mean_does_not_depend_on_the_signs_of_quaternions() -> None:
    middle = pose(poses()[0])
    x, y, z, qx, qy, qz, qw = middle
    assert np.allclose(mean_pose([middle, (x, y, z, -qx, -qy, -qz, -qw)]), middle, atol=1e-15)
    a, b = (pose(from_rt(rotation_exp([0.0, 0.0, angle]), [angle, 0.0, 0.0]))
            for angle in (-0.01, 0.01))
    assert np.allclose(mean_pose([a, b]), [0, 0, 0, 0, 0, 0, 1], atol=1e-15)
