# SPDX-License-Identifier: Apache-2.0
"""All kernels are compiled ahead of use, and their cache works wherever it may be."""

from __future__ import annotations

import importlib
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

import gsdf_registration
from gsdf_registration.common import kernel_cache, user_cache
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import transform
from gsdf_registration.field import build_field
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.registration.confidence import reassess
from gsdf_registration.registration.kernels import compile_kernels, load_kernels
from gsdf_registration.registration.pipeline import find_candidate
from gsdf_registration.registration.point_selection import select_points
from gsdf_registration.solver import Neighbourhood, refine

ROOTS = ('common', 'field', 'mesh', 'search', 'solver')


def specializations() -> set[tuple[str, str]]:
    """Return the kernels, and the types for which each is compiled."""
    found = set()
    for root in ROOTS:
        package = importlib.import_module(f'gsdf_registration.{root}')
        for module in pkgutil.iter_modules(package.__path__, f'{package.__name__}.'):
            for kernel in vars(importlib.import_module(module.name)).values():
                found |= {(kernel.py_func.__qualname__, str(types))
                          for types in getattr(kernel, 'signatures', ())}
    return found


def test_a_registration_needs_no_kernel_that_is_not_compiled_ahead(
        hip_surface: tuple[np.ndarray, np.ndarray]) -> None:
    load_kernels()
    before = specializations()
    assert len(before) > 20
    field = build_field(make_bone(*hip_surface, None), 0.003)
    assert field.faces.size
    points = transform(T_TRACKER_BONE, touched_points(500, 0, 3e-4))
    points.flags.writeable = False      # as those of a session
    points = points[select_points(points).rows]
    config = Config.from_flat({'search.rotations': 100, 'search.places': 10})
    candidate = find_candidate(points, bone_field(), config)
    neighbourhood = Neighbourhood(points, bone_field(), candidate.solution.T_bone_tracker)
    neighbourhood.add(points[:30])
    more = np.concatenate([points, points[:30]])
    solution = refine(more, bone_field(), candidate.solution, config.solver, neighbourhood.indices)
    assert candidate.confidence is not None
    assert reassess(candidate.confidence, solution, more) is not None
    find_candidate(points, bone_field(), config.replaced({'solver.method': 'paper'}))
    assert specializations() == before


def test_compiled_kernels_are_not_compiled_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('gsdf_registration.registration.kernels.kernels_compiled', lambda: True)
    compile_kernels(pytest.fail)


def test_kernels_are_compiled_again_after_a_change_of_the_sources(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('NUMBA_CACHE_DIR', str(tmp_path))
    assert not kernel_cache.kernels_compiled()
    kernel_cache.mark_compiled()
    assert kernel_cache.kernels_compiled()
    monkeypatch.setattr(kernel_cache, 'KERNEL_FOLDERS', ('common', 'field'))
    assert not kernel_cache.kernels_compiled()


def run(tmp_path: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a kernel in another process."""
    code = ('from gsdf_registration.common import kernel_cache, downsampling; import numpy as np; '
            'print(kernel_cache.cache_folder(), '
            'len(downsampling.farthest_point_sample(np.eye(3), 2)))')
    return subprocess.run([sys.executable, '-c', code], text=True, capture_output=True, check=True,
                          env=os.environ | {'PYTHONPATH': str(Path(gsdf_registration.__file__)
                                                              .parents[1])} | environment)


def test_uses_a_temporary_cache_with_a_warning_if_no_other_can_be_written(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    done = run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / 'file'), TMPDIR=str(tmp_path))
    folder, chosen = done.stdout.split()
    assert Path(folder).parent.parent == tmp_path and chosen == '2'
    assert any(Path(folder).rglob('*.nbi'))
    assert done.stderr.count('\n') == 1 and 'set NUMBA_CACHE_DIR' in done.stderr


def test_works_without_any_cache_with_a_warning(tmp_path: Path) -> None:
    (tmp_path / 'file').touch()
    done = run(tmp_path, NUMBA_CACHE_DIR=str(tmp_path / 'file'), TMPDIR=str(tmp_path / 'file'))
    assert done.stdout.split() == ['None', '2']
    assert done.stderr.count('\n') == 1 and 'compiled at each start' in done.stderr


def test_a_user_without_a_home_has_a_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_home() -> Path:
        raise RuntimeError('Could not determine home directory.')
    monkeypatch.setattr(Path, 'home', no_home)
    monkeypatch.delenv('XDG_CACHE_HOME', raising=False)
    monkeypatch.setenv('TMPDIR', str(tmp_path))
    assert user_cache.user_cache().parent == tmp_path


def test_a_folder_that_others_can_write_is_not_private(tmp_path: Path) -> None:
    shared = tmp_path / 'shared'
    shared.mkdir()
    shared.chmod(0o777)
    assert user_cache.is_writable(shared)
    assert not user_cache.is_writable(shared, private=True)
    assert user_cache.is_writable(tmp_path / 'own', private=True)
