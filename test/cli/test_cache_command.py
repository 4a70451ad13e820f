# SPDX-License-Identifier: Apache-2.0
"""Test ``gsdf cache``."""

from __future__ import annotations

from pathlib import Path

import pytest
import trimesh

from gsdf_registration.cli.main import main
from gsdf_registration.field.cache import cached_field, cached_files
from gsdf_registration.field.known_bones import remember
from gsdf_registration.mesh.bone import make_bone


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'cache'))
    return tmp_path / 'cache'


def test_fields_are_listed_and_deleted_and_other_files_stay(
        folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sphere = trimesh.creation.icosphere(2, 0.03)
    ball = make_bone(sphere.vertices, sphere.faces)
    cached_field(ball, 0.004)
    remember('0' * 64, ball)
    (folder / 'notes.txt').write_text('mine')
    field, = folder.glob('*.gsdf')      # what killed processes leave
    for name in (f'{field.name}ab12.tmp', f'.{field.name}.ab12'):
        (folder / name).touch()
    size = sum(path.stat().st_size for path in cached_files())
    assert main(['cache', 'list']) == 0
    first, last = capsys.readouterr().out.splitlines()
    assert first.split()[:3] == [ball.sha256[:32], '4', 'mm']
    assert last == f'1 field, {1e-6 * size:.1f} MB in {folder}'
    assert main(['cache', 'clear']) == 0
    assert capsys.readouterr().out == (f'deleted from {folder}: 1 field, {1e-6 * size:.1f} MB\n')
    assert [path.name for path in folder.iterdir()] == ['notes.txt']
    assert cached_field(ball, 0.004).voxel_size == 0.004


def test_a_folder_that_does_not_exist_has_no_fields(
        folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for action in ('list', 'clear'):
        assert main(['cache', action]) == 0
        assert '0 fields, 0.0 MB' in capsys.readouterr().out
    assert not folder.exists()
