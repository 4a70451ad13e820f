# SPDX-License-Identifier: Apache-2.0
"""Reduced surfaces keep their shape."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from smooth_bone import bone_field

from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization.decimation import decimate, drawn_surface


def test_decimation_keeps_the_shape() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.05)
    vertices, faces = decimate(ball.vertices, ball.faces.astype(np.int32), max_faces=3000)
    assert 1000 < len(faces) <= 3000 and faces.max() == len(vertices) - 1
    reduced = trimesh.Trimesh(vertices, faces, process=False)
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(0.05, abs=0.001)
    assert reduced.volume == pytest.approx(ball.volume, rel=0.03)


def test_a_small_mesh_is_not_changed(hip_surface: tuple[Array, np.ndarray]) -> None:
    vertices, faces = hip_surface
    assert decimate(vertices, faces, max_faces=len(faces))[1] is faces


def test_a_bone_of_300_000_faces_is_reduced_for_a_message() -> None:
    ball = trimesh.creation.icosphere(subdivisions=7, radius=0.1)
    assert len(ball.faces) > 300_000
    vertices, faces = decimate(ball.vertices, ball.faces.astype(np.int32), max_faces=12_000)
    assert 6000 < len(faces) <= 12_000
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(0.1, abs=0.001)


def test_a_point_cloud_is_drawn_as_points() -> None:
    field = bone_field()
    cloud = dataclasses.replace(field, vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), np.int32))
    vertices, faces = drawn_surface(cloud, 1000)
    assert len(faces) == 0 and 500 < len(vertices) <= 1000
    assert np.ptp(vertices, axis=0) == pytest.approx(np.ptp(field.bounds, axis=0), rel=0.05)
