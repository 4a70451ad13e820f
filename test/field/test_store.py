# SPDX-License-Identifier: Apache-2.0
"""Test that a field survives saving and loading, and that the cache builds a field once."""

from __future__ import annotations

import json
import os
import pickle
import struct
import threading
import zlib

import numba
import numpy as np
import pytest
import trimesh
from same_field import assert_same

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
    """Return the list of voxel sizes that were built, with an empty cache."""
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'cache'))
    built = []

    def counting(bone, voxel_size):
        built.append(voxel_size)
        return build_field(bone, voxel_size)

    monkeypatch.setattr(cache, 'build_field', counting)
    return built


def test_loads_the_field_that_was_saved(field, path):
    assert_same(load_field(path), field)


def test_loaded_field_uses_the_same_kernels(field, path):
    assert numba.typeof(load_field(path).arrays) == numba.typeof(field.arrays)


def test_saving_leaves_no_temporary_files(path):
    assert [p.name for p in path.parent.iterdir()] == ['bone.gsdf']


def test_field_has_the_notes_of_the_bone(bone, field):
    assert field.notes == bone.notes and len(bone.notes) == 1


def test_rejects_a_file_with_a_changed_byte(path):
    good = path.read_bytes()
    for at in [*range(0, 1000, 7), *range(1000, len(good), len(good) // 100), len(good) - 4,
               len(good) - 1]:
        bad = bytearray(good)
        bad[at] ^= 0x10
        path.write_bytes(bad)
        with pytest.raises(InputError) as refusal:
            load_field(path)
        assert str(path) in refusal.value.message


@pytest.mark.parametrize('share', [0.0, 0.00001, 0.0001, 0.001, 0.5, 0.999])
def test_rejects_a_truncated_file(path, share):
    good = path.read_bytes()
    path.write_bytes(good[:int(share * len(good))])
    with pytest.raises(InputError):
        load_field(path)


@pytest.mark.parametrize(
    'foreign',
    [b'ply\nformat ascii 1.0\n', pickle.dumps({'a': 1}), b'\0' * 4096])
def test_rejects_a_file_of_another_format(path, foreign):
    path.write_bytes(foreign)
    with pytest.raises(InputError, match='is not a field file'):
        load_field(path)


def test_rejects_another_format_version(path):
    header = json.dumps({'version': 7}).encode()
    data = MAGIC + struct.pack('<I', len(header)) + header
    path.write_bytes(data + struct.pack('<I', zlib.crc32(data)))
    with pytest.raises(InputError, match='format version 7'):
        load_field(path)


def test_rejects_a_missing_file_and_a_directory(field, tmp_path):
    with pytest.raises(InputError, match='cannot be read'):
        load_field(tmp_path / 'none.gsdf')
    with pytest.raises(InputError, match='cannot be read'):
        load_field(tmp_path)
    with pytest.raises(InputError, match='cannot be written'):
        save_field(field, tmp_path / 'none' / 'bone.gsdf')


def test_cache_builds_a_field_once(bone, builds):
    first, second = cached_field(bone, 0.002), cached_field(bone, 0.002)
    assert builds == [0.002]
    assert_same(first, second)


def test_cache_builds_another_voxel_size_or_bone(bone, builds):
    cached_field(bone, 0.002)
    cached_field(bone, 0.004)
    cached_field(make_bone(bone.vertices * 1.01, bone.faces), 0.002)
    assert builds == [0.002, 0.004, 0.002]


@pytest.mark.parametrize('damage', [lambda b: b[:100], lambda b: b[:-9] + bytes(9), lambda b: b''])
def test_cache_rebuilds_a_damaged_file(bone, builds, damage, caplog):
    cached_field(bone, 0.002)
    file, = cache.cache_directory().iterdir()
    file.write_bytes(damage(file.read_bytes()))
    assert_same(cached_field(bone, 0.002), cached_field(bone, 0.002))
    assert builds == [0.002, 0.002]
    assert len(caplog.records) == 1


def test_processes_that_need_the_same_field_build_it_once(bone, builds, monkeypatch):
    waiting = threading.Thread(target=cached_field, args=(bone, 0.002))

    def build_while_another_waits(*args):
        if not waiting.ident:
            waiting.start()
            waiting.join(0.2)       # it would build, too, if it did not wait
        return build_field(*args)
    build_field = cache.build_field
    monkeypatch.setattr(cache, 'build_field', build_while_another_waits)
    cached_field(bone, 0.002)
    waiting.join()
    assert builds == [0.002]
    file, = cache.cache_directory().iterdir()
    assert file.suffix == '.gsdf'


def test_a_pipe_in_the_cache_is_replaced(bone, builds, caplog):
    cached_field(bone, 0.002)
    file, = cache.cache_directory().iterdir()
    file.unlink()
    os.mkfifo(file)     # reading it would wait for ever
    assert_same(cached_field(bone, 0.002), cached_field(bone, 0.002))
    assert builds == [0.002, 0.002] and 'not a regular file' in caplog.text


def test_builds_without_a_writable_cache(bone, builds, monkeypatch, tmp_path, caplog):
    (tmp_path / 'file').write_text('')
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'file' / 'cache'))
    assert cached_field(bone, 0.002).bone_sha256 == bone.sha256
    assert builds == [0.002]
    assert 'could not be cached' in caplog.text


def test_cache_directory_follows_xdg(monkeypatch, tmp_path):
    monkeypatch.delenv('GSDF_CACHE_DIR', raising=False)
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    assert cache.cache_directory() == tmp_path / 'gsdf'
