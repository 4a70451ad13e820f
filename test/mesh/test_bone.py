# SPDX-License-Identifier: Apache-2.0
"""Test that `make_bone` turns a defective mesh into a valid, outward-oriented surface."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from meshes import blob, two, volume

from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.mesh.bone import make_bone

VOLUME = volume(*blob())


def test_keeps_a_valid_mesh(caplog):
    v, f = blob()
    bone = make_bone(v, f)
    np.testing.assert_array_equal(bone.vertices, v)
    np.testing.assert_array_equal(bone.faces, f)
    assert bone.notes == () and not caplog.records
    assert bone.faces.dtype == np.int32
    assert bone.extent == pytest.approx(np.ptp(v, axis=0).max())


def test_merges_the_vertices_of_separate_triangles():
    v, f = blob()
    bone = make_bone(v[f].reshape(-1, 3), np.arange(3 * len(f)).reshape(-1, 3))
    assert len(bone.vertices) == len(v) and len(bone.faces) == len(f)
    assert f'{3 * len(f) - len(v)} duplicate vertices' in bone.notes[0]


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_merges_vertices_within_the_tolerance(seed):
    v, f = blob(2)
    soup = v[f].reshape(-1, 3) + np.random.default_rng(seed).uniform(-1e-8, 1e-8, (3 * len(f), 3))
    assert len(make_bone(soup, np.arange(3 * len(f)).reshape(-1, 3)).vertices) == len(v)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 1.0))
def test_flips_faces_against_the_winding(seed, share):
    v, f = blob(2)
    flipped = np.random.default_rng(seed).random(len(f)) < share
    f[flipped] = f[flipped, ::-1]
    bone = make_bone(v, f)
    assert volume(bone.vertices, bone.faces) == pytest.approx(volume(*blob(2)))


def test_flips_an_inside_out_mesh():
    v, f = blob()
    bone = make_bone(v, f[:, ::-1])
    assert volume(bone.vertices, bone.faces) == pytest.approx(VOLUME)
    assert any('inside out' in note for note in bone.notes)


@pytest.mark.parametrize('inside_out', [False, True])
def test_orients_a_mesh_with_holes(inside_out):
    v, f = blob()
    centres = v[f].mean(axis=1)
    f = f[(centres[:, 2] < 0.05) & (np.linalg.norm(centres - [0.04, 0.0, 0.0], axis=1) > 0.02)]
    bone = make_bone(v, f[:, ::-1] if inside_out else f)
    outward = np.cross(bone.vertices[bone.faces[:, 1]] - bone.vertices[bone.faces[:, 0]],
                       bone.vertices[bone.faces[:, 2]] - bone.vertices[bone.faces[:, 0]])
    assert ((outward * bone.vertices[bone.faces].mean(axis=1)).sum(axis=1) > 0.0).mean() > 0.99


def test_orients_each_body_separately():
    v, f = blob()
    bone = make_bone(*two((v, f[:, ::-1]), (v * 0.5 + [0.2, 0.0, 0.0], f)), body='all')
    assert volume(bone.vertices, bone.faces) == pytest.approx(VOLUME * 1.125)
    assert '1 of 2 bodies' in bone.notes[-1]


@pytest.mark.parametrize('inside_out', [False, True])
def test_drops_a_body_inside_another(inside_out):
    v, f = blob()
    bone = make_bone(*two((v, f), (v * 0.6, f[:, ::-1] if inside_out else f)))
    assert len(bone.faces) == len(f) and volume(bone.vertices, bone.faces) == pytest.approx(VOLUME)
    assert 'inside another' in bone.notes[-1]


def test_keeps_a_body_that_intersects_another():
    v, f = blob()
    assert len(make_bone(*two((v, f), (v * 0.6 + [0.04, 0.0, 0.0], f))).faces) == 2 * len(f)


def test_drops_small_bodies():
    v, f = blob()
    bone = make_bone(*two((v, f), (v * 0.05 + [0.2, 0.0, 0.0], f)))
    assert len(bone.faces) == len(f) and len(bone.vertices) == len(v)
    assert bone.extent == pytest.approx(np.ptp(v, axis=0).max())
    assert '1 small body' in bone.notes[0]


def test_drops_degenerate_faces_duplicate_faces_and_unused_vertices():
    v, f = blob()
    a, b = f[0, :2]
    v = np.vstack([v, 0.5 * (v[a] + v[b]), [0.3, 0.3, 0.3]])
    bone = make_bone(v, np.vstack([f, f[:5], f[5:8, ::-1], [[a, b, len(v) - 2], [a, a, b]]]))
    assert len(bone.faces) == len(f) and len(bone.vertices) == len(v) - 2
    text = ' '.join(bone.notes)
    assert '2 faces with zero area' in text and '8 duplicate faces' in text


def test_logs_all_repairs_in_one_warning(caplog):
    v, f = blob()
    with caplog.at_level(logging.WARNING):
        make_bone(*two((v, f[:, ::-1]), (v * 0.5, f)))
    assert len(caplog.records) == 1 and '\n' not in caplog.text.strip()


@settings(deadline=None, max_examples=20)
@given(st.floats(0.2, 10.0))
def test_repair_does_not_depend_on_the_scale(scale):
    v, f = two(blob(2), (blob(2)[0] * 0.5, blob(2)[1]))
    f = np.vstack([f, f[:3]])
    f[::7] = f[::7, ::-1]
    one, other = make_bone(v, f), make_bone(v * scale, f)
    np.testing.assert_array_equal(one.faces, other.faces)
    np.testing.assert_allclose(one.vertices * scale, other.vertices, rtol=1e-12)
    assert one.notes == other.notes


@pytest.mark.parametrize(('scale', 'message'), [(1000.0, 'mm, not m'), (0.001, 'm, not mm')])
def test_rejects_a_size_that_suggests_the_wrong_unit(scale, message):
    v, f = blob()
    with pytest.raises(InputError, match=message) as refusal:
        make_bone(v * scale, f)
    assert refusal.value.reason is Reason.WRONG_UNIT


def test_rejects_invalid_surfaces():
    v, f = blob(1)
    broken = v.copy()
    broken[3, 1] = np.nan
    beyond = f.copy()
    beyond[2, 2] = len(v)
    for vertices, faces, message in [
            (broken, f, 'not finite'), (v, beyond, 'face 2'), (v, -f, 'does not exist'),
            (v, None, 'neither'), (v, f[:0], 'neither'), (v[:0], f, 'empty'),
            (v[:, :2], f, 'rows of three'), (v, f[:, :2], 'triangulate'),
            (v, f.astype(float), 'indices'), (v, np.repeat(f[:, :1], 3, axis=1), 'area')]:
        with pytest.raises(InputError, match=message):
            make_bone(vertices, faces)


def test_normalizes_the_normals_of_a_cloud_and_drops_duplicate_points():
    v, _ = blob()
    n = v / np.linalg.norm(v, axis=1, keepdims=True)
    bone = make_bone(np.vstack([v, v[:4]]), None, 3.0 * np.vstack([n, n[:4]]))
    np.testing.assert_array_equal(bone.vertices, v)
    np.testing.assert_allclose(bone.normals, n, atol=1e-12)
    assert bone.faces is None and len(bone.notes) == 2


def test_rejects_a_cloud_with_invalid_normals():
    v, _ = blob(1)
    for normals, message in [(v[1:], 'normals'), (v * 0.0, 'zero length'),
                             (v * np.nan, 'not finite')]:
        with pytest.raises(InputError, match=message):
            make_bone(v, None, normals)


def test_hash_depends_only_on_the_geometry():
    v, f = blob()
    assert make_bone(v, f).sha256 == make_bone(v.copy(), f.astype(np.int64)).sha256
    assert make_bone(v, f).sha256 != make_bone(v * 1.001, f).sha256
