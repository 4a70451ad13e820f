# SPDX-License-Identifier: Apache-2.0
"""``gsdf show``: draw a session, a recording or points, without a display."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from pixel_colours import has_colour
from smooth_bone import T_TRACKER_BONE, bone_mesh, touched_points

from gsdf_registration.cli.main import main
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field.model import load_model
from gsdf_registration.session.replay import replay
from gsdf_registration.visualization import colours, picture
from msg_adapters.bag import read_bag
from msg_adapters.session_file import write_session

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope='module')
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a directory with a bone, points on it, mm, and an initial guess."""
    root = tmp_path_factory.mktemp('show')
    mesh = bone_mesh().copy()
    mesh.apply_scale(1e3)
    mesh.export(root / 'bone.ply')
    points = 1e3 * transform(T_TRACKER_BONE, touched_points(300, sigma=0.0002))
    np.savetxt(root / 'points.csv', points, delimiter=',', header='x,y,z', comments='')
    (root / 'near.json').write_text(json.dumps({'T_tracker_bone': T_TRACKER_BONE.tolist()}))
    return root


@pytest.fixture(autouse=True)
def in_job_directory(job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in that directory, with a separate cache."""
    monkeypatch.setenv('GSDF_CACHE_DIR', str(job / 'cache'))
    monkeypatch.delenv('DISPLAY', raising=False)
    monkeypatch.chdir(job)


def shown(file: str | Path) -> Array:
    """Return the part of a picture that shows the bone."""
    image = matplotlib.image.imread(file)[..., :3]
    return image[image.shape[0] // 8:-picture.BELOW]


def test_draws_a_session(
        bags: Path, hip_bone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    field = load_model(str(hip_bone))
    result, session = replay(read_bag(bags / 'hip_optical', ['/probe/tip']), field, Config())
    assert result.success, result.message
    write_session(tmp_path / 'session.json', session.to_dict())
    drawn = tmp_path / 'scene.png'
    assert main(['show', str(tmp_path / 'session.json'), '--model', str(hip_bone),
                 '-o', str(drawn)]) == 0
    printed = capsys.readouterr().out
    assert 'points lie on the bone; accurate to 2.0 mm (95 %)' in printed and str(drawn) in printed
    image = shown(drawn)
    assert drawn.stat().st_size < 500_000
    assert (image.mean(axis=-1) < 0.9).mean() > 0.2                 # the bone
    assert has_colour(image, colours.RESIDUAL[0]).sum() > 1000            # points close to it
    assert has_colour(image, colours.RESIDUAL[-1]).sum() == 0
    # the pose is well constrained: no next touch, and no large expected error
    assert has_colour(image, colours.NEXT).sum() == has_colour(image, colours.ERROR[-1]).sum() == 0


def test_draws_a_recording(bags: Path, hip_bone: Path) -> None:
    assert main(['show', str(bags / 'hip_optical'), '--model', str(hip_bone), '--landmarks',
                 str(bags / 'hip_optical.yaml')]) == 0
    assert has_colour(shown('scene.png'), colours.RESIDUAL[0]).sum() > 1000


def test_draws_a_rejected_pose_with_the_next_touch(
        capsys: pytest.CaptureFixture[str]) -> None:
    Path('strict.yaml').write_text('limits: {max_error: 0.00002}')
    points = ['points.csv', '--unit', 'mm', '--model', 'bone.ply', '--initial', 'near.json']
    assert main(['show', *points, '-o', 'good.png']) == 0
    assert main(['show', *points, '-o', 'poor.png', '--config', 'strict.yaml']) == 1
    assert 'touch the bone' in capsys.readouterr().out
    good, poor = shown('good.png'), shown('poor.png')
    assert has_colour(good, colours.NEXT).sum() == 0 and has_colour(poor, colours.NEXT).sum() > 1000
    assert has_colour(good, colours.ERROR[-1]).sum() == 0
    assert has_colour(poor, colours.ERROR[-1]).sum() > 1000


def test_draws_the_next_touch_of_an_ambiguous_pose(
        bags: Path, hip_bone: Path, capsys: pytest.CaptureFixture[str]) -> None:
    positions = read_bag(bags / 'hip_optical', ['/probe/tip']).positions[:120]
    np.savetxt('begun.csv', positions, delimiter=',', header='x,y,z', comments='')
    assert main(['show', 'begun.csv', '--unit', 'm', '--model', str(hip_bone)]) == 1
    assert ', where the poses differ most' in capsys.readouterr().out
    image = shown('scene.png')
    assert has_colour(image, colours.NEXT).sum() > 200
    assert has_colour(image, colours.RESIDUAL[0]).sum() == 0      # the pose is not known


def test_draws_the_bone_alone_without_a_pose(capsys: pytest.CaptureFixture[str]) -> None:
    Path('few.csv').write_text('x,y,z\n0,0,0\n10,0,0\n20,0,0\n')
    assert main(['show', 'few.csv', '--unit', 'mm', '--model', 'bone.ply', '-o', 'few.png']) == 1
    assert 'too few' in capsys.readouterr().out
    image = shown('few.png')
    assert (image.mean(axis=-1) < 0.9).mean() > 0.1
    assert has_colour(image, colours.RESIDUAL[0]).sum() == 0


@pytest.mark.parametrize('words, complaint', [
    (['points.csv'], 'add --unit mm or --unit m'),
    (['nowhere.json'], 'nowhere.json'),
    (['points.csv', '--unit', 'mm', '--model-unit', 'm'], 'its unit is probably mm'),
    (['points.csv', '--unit', 'mm', '--initial', 'near.json', '-o', 'nowhere/a.png'],
     'nowhere/a.png'),
])
def test_reports_errors_in_one_line(words: list[str], complaint: str,
                                    capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['show', *words, '--model', 'bone.ply']) == 2
    error = capsys.readouterr().err
    assert error.startswith('gsdf: error: ') and complaint in error and error.count('\n') == 1


def test_names_the_missing_library() -> None:
    code = ('import sys; sys.modules["matplotlib"] = None; '
            'from gsdf_registration.cli.main import main; sys.exit(main(sys.argv[1:]))')
    done = subprocess.run(
        [sys.executable, '-c', code, 'show', 'points.csv', '--unit', 'mm', '--model', 'bone.ply'],
        capture_output=True, text=True, env={**os.environ, 'PYTHONPATH': str(ROOT)})
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr == ('gsdf: error: a picture needs matplotlib, which is not installed: '
                           "pip install 'gsdf_registration[report]'\n")
