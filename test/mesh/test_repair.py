# SPDX-License-Identifier: Apache-2.0
"""Test each step of the mesh repair separately."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import blob, two, volume

from gsdf_registration.mesh import repair

TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def one_body(faces: np.ndarray) -> np.ndarray:
    return np.zeros(len(faces), dtype=np.int64)


def two_bodies(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.repeat([0, 1], [len(first), len(second)])


def test_merge_vertices_keeps_the_first_of_the_duplicates() -> None:
    vertices = np.vstack([CORNERS, CORNERS[1] + 1e-8])
    faces = np.array([[0, 2, 1], [0, 4, 3], [0, 3, 2], [4, 2, 3]])
    notes: list[str] = []
    merged, remapped = repair.merge_vertices(vertices, faces, notes)
    np.testing.assert_array_equal(merged, CORNERS)
    np.testing.assert_array_equal(remapped, TETRAHEDRON)
    assert notes == ['Merged 1 duplicate vertex.']


def test_merge_vertices_merges_across_cell_boundaries() -> None:
    step = repair.MERGE_TOLERANCE
    vertices = np.vstack([CORNERS, [0.5 + 0.01 * step, 0.0, 0.0], [0.5 - 0.01 * step, 0.0, 0.0]])
    merged, _ = repair.merge_vertices(vertices, np.array([[0, 1, 2], [3, 4, 5]]), [])
    assert len(merged) == 5


def test_merge_vertices_keeps_distinct_vertices() -> None:
    notes: list[str] = []
    vertices, faces = repair.merge_vertices(CORNERS, TETRAHEDRON, notes)
    np.testing.assert_array_equal(vertices, CORNERS)
    np.testing.assert_array_equal(faces, TETRAHEDRON)
    assert notes == []


def test_drop_unused_vertices_keeps_the_order() -> None:
    vertices, faces = repair.drop_unused_vertices(CORNERS, np.array([[3, 1, 0]]))
    np.testing.assert_array_equal(vertices, CORNERS[[0, 1, 3]])
    np.testing.assert_array_equal(faces, [[2, 1, 0]])


def test_drop_invalid_faces_drops_faces_with_zero_area() -> None:
    vertices = np.vstack([CORNERS, [0.5, 0.0, 0.0]])
    notes: list[str] = []
    faces = repair.drop_invalid_faces(vertices, np.vstack([TETRAHEDRON, [[0, 1, 4], [0, 1, 1]]]),
                                      notes)
    np.testing.assert_array_equal(faces, TETRAHEDRON)
    assert notes == ['Dropped 2 faces with zero area.']


@pytest.mark.parametrize('duplicate', [[0, 2, 1], [2, 1, 0], [1, 2, 0]])
def test_drop_invalid_faces_keeps_the_first_of_duplicate_faces(duplicate: list[int]) -> None:
    notes: list[str] = []
    faces = repair.drop_invalid_faces(CORNERS, np.vstack([TETRAHEDRON, [duplicate]]), notes)
    np.testing.assert_array_equal(faces, TETRAHEDRON)
    assert notes == ['Dropped 1 duplicate face.']


def test_wind_consistently_flips_the_minority_of_the_faces() -> None:
    faces = TETRAHEDRON.copy()
    faces[2] = faces[2, ::-1]
    notes: list[str] = []
    wound, bodies = repair.wind_consistently(faces, notes)
    np.testing.assert_array_equal(wound, TETRAHEDRON)
    np.testing.assert_array_equal(bodies, 0)
    assert notes == ['Flipped 1 face to match the neighbours.']


def test_wind_consistently_numbers_the_bodies() -> None:
    _, faces = two((CORNERS, TETRAHEDRON), (CORNERS, TETRAHEDRON))
    notes: list[str] = []
    wound, bodies = repair.wind_consistently(faces, notes)
    np.testing.assert_array_equal(wound, faces)
    assert len(np.unique(bodies[:4])) == len(np.unique(bodies[4:])) == 1 and bodies[0] != bodies[4]
    assert notes == []


def test_large_bodies_excludes_bodies_of_little_area() -> None:
    large = blob(1)
    small = large[0] * 0.05 + [0.2, 0.0, 0.0], large[1]
    vertices, faces = two(large, small)
    notes: list[str] = []
    kept = repair.large_bodies(vertices, faces, two_bodies(large[1], small[1]), notes)
    np.testing.assert_array_equal(kept, np.arange(len(faces)) < len(large[1]))
    assert notes == ['Dropped 1 small body.']


def test_orient_outward_flips_an_inside_out_body() -> None:
    vertices, faces = blob(2)
    notes: list[str] = []
    outward = repair.orient_outward(vertices, faces[:, ::-1], one_body(faces), notes)
    np.testing.assert_array_equal(outward, faces)
    assert volume(vertices, outward) > 0.0
    assert notes == ['Flipped 1 of 1 body that were inside out.']


def test_orient_outward_keeps_an_outward_body() -> None:
    vertices, faces = blob(2)
    notes: list[str] = []
    np.testing.assert_array_equal(repair.orient_outward(vertices, faces, one_body(faces), notes),
                                  faces)
    assert notes == []


def test_orient_outward_handles_a_body_with_a_hole() -> None:
    vertices, faces = blob(2)
    faces = faces[vertices[faces].mean(axis=1)[:, 2] < 0.04]
    flipped = repair.orient_outward(vertices, faces[:, ::-1], one_body(faces), [])
    np.testing.assert_array_equal(flipped, faces)


def test_outer_bodies_excludes_a_body_inside_another() -> None:
    outer = blob(2)
    inner = outer[0] * 0.5, outer[1]
    vertices, faces = two(outer, inner)
    notes: list[str] = []
    kept = repair.outer_bodies(vertices, faces, two_bodies(outer[1], inner[1]), notes)
    np.testing.assert_array_equal(kept, np.arange(len(faces)) < len(outer[1]))
    assert notes == ['Dropped 1 body inside another body.']


def test_outer_bodies_keeps_a_body_that_intersects_another() -> None:
    outer = blob(2)
    other = outer[0] * 0.5 + [0.05, 0.0, 0.0], outer[1]
    vertices, faces = two(outer, other)
    notes: list[str] = []
    assert repair.outer_bodies(vertices, faces, two_bodies(outer[1], other[1]), notes).all()
    assert notes == []


def test_face_areas() -> None:
    np.testing.assert_allclose(repair.face_areas(CORNERS, TETRAHEDRON),
                               [0.5, 0.5, 0.5, np.sqrt(0.75)])
