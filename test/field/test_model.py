# SPDX-License-Identifier: Apache-2.0
"""Test `load_model` and `find_model`."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
import trimesh

from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.field import model, save_field
from gsdf_registration.field.model import find_model, load_model


@pytest.fixture(autouse=True)
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'cache'))


@pytest.fixture
def mesh(tmp_path: Path) -> Path:
    path = tmp_path / 'bone.stl'
    trimesh.creation.icosphere(subdivisions=3, radius=40.0).export(path)
    return path


def test_rejects_a_wrong_unit(mesh: Path) -> None:
    assert load_model(str(mesh), 'mm', 0.004).extent == pytest.approx(0.08, rel=1e-2)
    with pytest.raises(InputError) as refusal:
        load_model(str(mesh), 'm', 0.004)
    assert refusal.value.reason is Reason.WRONG_UNIT and str(mesh) in refusal.value.message


def test_second_load_uses_the_cache(mesh: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load_model(str(mesh), 'mm', 0.004)
    monkeypatch.setattr('gsdf_registration.field.cache.build_field',
                        lambda *_: pytest.fail('built again'))
    assert load_model(str(mesh), 'mm', 0.004).bone_sha256 == first.bone_sha256


def test_unit_and_voxel_size_do_not_change_a_field_file(mesh: Path, tmp_path: Path) -> None:
    built = load_model(str(mesh), 'mm', 0.004)
    save_field(built, tmp_path / 'bone.gsdf')
    loaded = load_model(str(tmp_path / 'bone.gsdf'), 'm', 0.001)
    assert (loaded.voxel_size, loaded.bone_sha256) == (0.004, built.bone_sha256)


def test_finds_a_package_uri_in_the_ament_index(mesh: Path, tmp_path: Path,
                                                monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('ament_index_python')
    share = tmp_path / 'share' / 'some_bones'
    (tmp_path / 'share/ament_index/resource_index/packages').mkdir(parents=True)
    (tmp_path / 'share/ament_index/resource_index/packages/some_bones').touch()
    share.mkdir()
    (share / 'bone.stl').write_bytes(mesh.read_bytes())
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    assert find_model('package://some_bones/bone.stl') == share / 'bone.stl'
    assert load_model('package://some_bones/bone.stl', 'mm', 0.004).extent > 0.0


def test_finds_a_package_uri_without_ros(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, 'ament_index_python.packages', None)
    assert find_model('package://gsdf_registration/field/model.py') == Path(model.__file__)
    monkeypatch.setattr(sys, 'prefix', str(tmp_path))
    (tmp_path / 'share/some_bones').mkdir(parents=True)
    (tmp_path / 'share/some_bones/bone.stl').touch()
    assert find_model('package://some_bones/bone.stl') == tmp_path / 'share/some_bones/bone.stl'


@pytest.mark.parametrize('uri', ['package://no_such_package_here/bone.stl', 'package://',
                                 'package://gsdf_registration/no.stl', 'package://../x'])
def test_rejects_a_uri_without_a_file(uri: str) -> None:
    with pytest.raises(InputError, match='not installed or has no file'):
        find_model(uri)


@pytest.mark.parametrize('path, sentence', [
    ('x' * 300, 'File name too long'), ('x' * 5000, 'File name too long'),
    ('~nosuchuser/x.ply', 'no such user'), ('nul\0.ply', 'does not exist'),
    ('nowhere.ply', 'nowhere.ply does not exist'), ('{folder}', 'not a regular file'),
    ('{folder}/fifo', 'not a regular file'), ('/dev/null', 'not a regular file'),
    ('package://gsdf_registration/../secret.stl', 'a file inside its package'),
    ('package://gsdf_registration//secret.stl', 'a file inside its package')])
def test_rejects_what_is_no_regular_file(tmp_path: Path, path: str, sentence: str) -> None:
    os.mkfifo(tmp_path / 'fifo')
    with pytest.raises(InputError, match=sentence) as refusal:
        find_model(path.format(folder=tmp_path))
    assert len(refusal.value.message) < 300
