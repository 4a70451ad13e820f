# SPDX-License-Identifier: Apache-2.0
"""
A field comes back from its file bit by bit, or a sentence says why not; the cache builds once.
"""

import json
import pickle
import struct
import zlib

import numba
import numpy as np
import pytest
import trimesh

from gsdf_registration.common.result import InputError
from gsdf_registration.field import build_field, cache, cached_field, load_field, save_field
from gsdf_registration.field.store import MAGIC
from gsdf_registration.mesh.bone import make_bone


@pytest.fixture(scope='module')
def bone():
    mesh = trimesh.creation.icosphere(2, 0.02)
    return make_bone(mesh.vertices, np.vstack([mesh.faces, mesh.faces[:1]]))


@pytest.fixture(scope='module')
def field(bone):
    return build_field(bone, 0.002)


@pytest.fixture
def path(field, tmp_path):
    save_field(field, tmp_path / 'bone.gsdf')
    return tmp_path / 'bone.gsdf'


@pytest.fixture
def builds(monkeypatch, tmp_path):
    """The voxel sizes built so far, with a cache of our own."""
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'cache'))
    built = []

    def counting(bone, voxel_size):
        built.append(voxel_size)
        return build_field(bone, voxel_size)

    monkeypatch.setattr(cache, 'build_field', counting)
    return built


def assert_same(a, b):
    for one, other in zip(a.arrays, b.arrays):
        np.testing.assert_array_equal(one, other)
    for name in ('bone_sha256', 'voxel_size', 'bounds', 'surface_points', 'surface_normals',
                 'vertices', 'faces', 'notes', 'nbytes'):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_a_field_comes_back_as_it_was(field, path):
    assert_same(load_field(path), field)


def test_a_loaded_field_needs_no_other_kernels(field, path):
    assert numba.typeof(load_field(path).arrays) == numba.typeof(field.arrays)


def test_saving_leaves_nothing_else_behind(path):
    assert [p.name for p in path.parent.iterdir()] == ['bone.gsdf']


def test_what_was_repaired_is_kept(bone, field):
    assert field.notes == bone.notes and len(bone.notes) == 1


def test_damage_anywhere_is_noticed(path):
    good = path.read_bytes()
    for at in [
            *range(0, 1000, 7), *range(1000, len(good),
                                       len(good) // 100),
            len(good) - 4,
            len(good) - 1
    ]:
        bad = bytearray(good)
        bad[at] ^= 0x10
        path.write_bytes(bad)
        with pytest.raises(InputError) as refusal:
            load_field(path)
        assert str(path) in refusal.value.message


@pytest.mark.parametrize('share', [0.0, 0.00001, 0.0001, 0.001, 0.5, 0.999])
def test_a_file_cut_short_is_refused(path, share):
    good = path.read_bytes()
    path.write_bytes(good[:int(share * len(good))])
    with pytest.raises(InputError):
        load_field(path)


@pytest.mark.parametrize(
    'foreign',
    [b'ply\nformat ascii 1.0\n', pickle.dumps({'a': 1}), b'\0' * 4096])
def test_a_foreign_file_is_refused(path, foreign):
    path.write_bytes(foreign)
    with pytest.raises(InputError, match='is not a gsdf field'):
        load_field(path)


def test_a_newer_version_is_named(path):
    header = json.dumps({'version': 7}).encode()
    data = MAGIC + struct.pack('<I', len(header)) + header
    path.write_bytes(data + struct.pack('<I', zlib.crc32(data)))
    with pytest.raises(InputError, match='format 7'):
        load_field(path)


def test_no_file_and_no_folder_are_refused(field, tmp_path):
    with pytest.raises(InputError, match='cannot be read'):
        load_field(tmp_path / 'none.gsdf')
    with pytest.raises(InputError, match='cannot be read'):
        load_field(tmp_path)
    with pytest.raises(InputError, match='cannot be written'):
        save_field(field, tmp_path / 'none' / 'bone.gsdf')


def test_the_second_run_does_not_build(bone, builds):
    first, second = cached_field(bone, 0.002), cached_field(bone, 0.002)
    assert builds == [0.002]
    assert_same(first, second)


def test_another_voxel_or_bone_is_built(bone, builds):
    cached_field(bone, 0.002)
    cached_field(bone, 0.004)
    cached_field(make_bone(bone.vertices * 1.01, bone.faces), 0.002)
    assert builds == [0.002, 0.004, 0.002]


@pytest.mark.parametrize('damage', [lambda b: b[:100], lambda b: b[:-9] + bytes(9), lambda b: b''])
def test_a_damaged_cache_is_built_again(bone, builds, damage, caplog):
    cached_field(bone, 0.002)
    file, = cache.cache_directory().iterdir()
    file.write_bytes(damage(file.read_bytes()))
    assert_same(cached_field(bone, 0.002), cached_field(bone, 0.002))
    assert builds == [0.002, 0.002]
    assert len(caplog.records) == 1


def test_without_a_cache_the_field_is_still_built(bone, builds, monkeypatch, tmp_path, caplog):
    (tmp_path / 'file').write_text('')
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'file' / 'cache'))
    assert cached_field(bone, 0.002).bone_sha256 == bone.sha256
    assert builds == [0.002]
    assert 'not kept' in caplog.text


def test_the_cache_is_where_xdg_says(monkeypatch, tmp_path):
    monkeypatch.delenv('GSDF_CACHE_DIR', raising=False)
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    assert cache.cache_directory() == tmp_path / 'gsdf'
