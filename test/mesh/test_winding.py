# SPDX-License-Identifier: Apache-2.0
"""Test the generalized winding number."""

from __future__ import annotations

import numpy as np
from meshes import blob, two

from gsdf_registration.mesh.winding import winding_numbers


def test_one_inside_and_zero_outside_a_closed_mesh() -> None:
    vertices, faces = blob(2)
    points = np.array([[0.0, 0.0, 0.0], [0.01, -0.01, 0.02], [0.2, 0.0, 0.0], [0.0, 0.0, -5.0]])
    np.testing.assert_allclose(winding_numbers(vertices, faces, points), [1, 1, 0, 0], atol=1e-12)


def test_negative_inside_an_inside_out_mesh() -> None:
    vertices, faces = blob(2)
    np.testing.assert_allclose(winding_numbers(vertices, faces[:, ::-1], np.zeros((1, 3))), -1.0)


def test_half_on_a_face() -> None:
    vertices, faces = blob(3)
    on_faces = vertices[faces[::50]].mean(axis=1)
    np.testing.assert_allclose(winding_numbers(vertices, faces, on_faces), 0.5, atol=0.05)


def test_between_zero_and_one_in_the_plane_of_a_hole() -> None:
    vertices, faces = blob(3)
    open_ = faces[vertices[faces].mean(axis=1)[:, 2] < 0.0]
    at_hole, deep = winding_numbers(vertices, open_, np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.05]]))
    assert 0.3 < at_hole < 0.7 < deep < 1.0


def test_two_inside_two_bodies() -> None:
    outer = blob(2)
    vertices, faces = two(outer, (0.5 * outer[0], outer[1]))
    np.testing.assert_allclose(winding_numbers(vertices, faces, np.zeros((1, 3))), 2.0)
