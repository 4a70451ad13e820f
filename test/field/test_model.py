# SPDX-License-Identifier: Apache-2.0
"""Test `load_model` and `find_model`."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import trimesh
from same_field import assert_same

from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.field import known_bones, model, save_field
from gsdf_registration.field.model import find_model, load_model
from msg_adapters.points import read_model


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


def reads(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Return the list of mesh files that are read from now on."""
    files: list[Path] = []

    def counting(file: Path, *options: str) -> Any:
        files.append(file)
        return read_model(file, *options)
    monkeypatch.setattr(model, 'read_model', counting)
    return files


def test_a_known_file_is_not_read_again_and_gives_the_same_field_and_warning(
        mesh: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
        caplog: pytest.LogCaptureFixture) -> None:
    first, files = load_model(str(mesh), 'mm', 0.004), reads(monkeypatch)
    warnings = caplog.messages[:]
    caplog.clear()
    moved = tmp_path / 'other_name.STL'
    mesh.rename(moved)
    assert_same(load_model(str(moved), 'mm', 0.004), first)
    assert caplog.messages == warnings and 'Merged' in warnings[0]
    assert files == []


@pytest.mark.parametrize('change', ['content', 'unit', 'body', 'type', 'code', 'entry', 'field'])
def test_a_file_is_read_again_after_any_change(mesh: Path, monkeypatch: pytest.MonkeyPatch,
                                               tmp_path: Path, change: str) -> None:
    first = load_model(str(mesh), 'mm', 0.004)
    files, unit, body = reads(monkeypatch), 'mm', ''
    if change == 'content':
        data = bytearray(mesh.read_bytes())
        data[84 + 12] ^= 1      # the last bit of a coordinate
        mesh.write_bytes(data)
    elif change == 'unit':
        unit = 'm'
    elif change == 'body':
        body = 'largest'
    elif change == 'type':
        mesh = mesh.rename(mesh.with_suffix('.ply'))
    elif change == 'code':
        monkeypatch.setattr(known_bones, '_code', lambda: 'other')
    else:
        file, = (tmp_path / 'cache').glob('*.bone.json' if change == 'entry' else '*.gsdf')
        file.write_bytes(file.read_bytes()[:20])
    with suppress(InputError):      # the unit and the type are wrong
        found = load_model(str(mesh), unit, 0.004, body=body)
        assert (found.bone_sha256 == first.bone_sha256) is (change != 'content')
    assert files == [mesh]


def test_a_file_that_is_replaced_while_it_is_read_is_not_remembered(
        mesh: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before, after = mesh.read_bytes(), tmp_path / 'after.stl'
    trimesh.creation.icosphere(subdivisions=3, radius=30.0).export(after)

    def replaced(file: Path, *options: str) -> Any:
        file.write_bytes(after.read_bytes())
        return read_model(file, *options)
    monkeypatch.setattr(model, 'read_model', replaced)
    assert load_model(str(mesh), 'mm', 0.004).extent == pytest.approx(0.06, rel=1e-2)
    monkeypatch.setattr(model, 'read_model', read_model)
    mesh.write_bytes(before)
    assert load_model(str(mesh), 'mm', 0.004).extent == pytest.approx(0.08, rel=1e-2)


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
