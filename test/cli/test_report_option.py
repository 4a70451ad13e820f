# SPDX-License-Identifier: Apache-2.0
"""The option --report of `gsdf register` and `gsdf replay`."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from page_text import text_of
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.cli.main import main
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import transform
from gsdf_registration.field.model import load_model
from gsdf_registration.session.replay import replay
from msg_adapters.bag import read_bag
from msg_adapters.bag_writer import BagWriter
from msg_adapters.session_file import write_session


@pytest.fixture
def job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a working directory with a bone, points and a recording."""
    field, points = bone_field(), transform(T_TRACKER_BONE, touched_points(400, sigma=0.0002))
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'cache'))
    monkeypatch.chdir(tmp_path)
    trimesh.Trimesh(1e3 * field.vertices, field.faces).export('bone.ply')
    np.savetxt('points.csv', 1e3 * points, delimiter=',', header='x,y,z', comments='')
    (tmp_path / 'start.json').write_text(json.dumps({'T_tracker_bone': T_TRACKER_BONE.tolist()}))
    with BagWriter(tmp_path / 'run') as bag:
        for i, point in enumerate(points):
            bag.write_point('/probe/tip', 1.7e9 + i, point, 'camera')
    return tmp_path


def test_register_and_replay_write_the_report(job: Path) -> None:
    assert main(['register', 'bone.ply', 'points.csv', '--unit', 'mm', '--initial', 'start.json',
                 '--report', 'a.html']) == 0
    assert main(['replay', 'run', '--model', 'bone.ply', '--initial', 'start.json',
                 '--report', 'b.html', '--case', 'knee 7']) == 0
    a, b = (text_of((job / name).read_text()) for name in ('a.html', 'b.html'))
    assert 'Registered' in a and 'bone.ply from points.csv' in a
    assert 'Registered' in b and 'bone.ply from run' in b and 'frame of the points camera' in b
    assert 'case knee 7' in b and 'date 2023-11-14 22:13 UTC' in b and 'case' not in a
    assert len(re.findall(r'SHA-256 [0-9a-f]{64} ', a)) == 2
    assert main(['register', 'bone.ply', 'points.csv', '--unit', 'm', '--report', 'c.html']) == 1
    assert main(['replay', 'run', '--model', 'bone.ply', '--model-unit', 'm',
                 '--report', 'd.html']) == 1
    for name in ('c.html', 'd.html'):
        assert 'Refused: wrong_unit' in text_of((job / name).read_text())


def test_a_saved_session_has_a_report(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    field = load_model('bone.ply')
    result, session = replay(read_bag('run', None), field, Config(), T_tracker_bone=T_TRACKER_BONE)
    write_session('session.json', session.to_dict())
    command = ['show', 'session.json', '--model', 'bone.ply', '--report', 'a.html', '--case', 'k']
    assert main(command) == 0
    text = text_of((job / 'a.html').read_text())
    assert result.message in text and 'as saved in the session' in text and 'case k' in text
    assert not (job / 'scene.png').exists()
    session.configure(Config().replaced({'limits.max_error': 2e-5}))
    assert not session.register(T_tracker_bone=T_TRACKER_BONE).success
    write_session('session.json', session.to_dict())
    assert main(command) == 1
    text = text_of((job / 'a.html').read_text())
    assert 'Refused: under_constrained' in text and '1: touch here' in text
    assert 'registered again' in text and 'limits.max_error 2e-05' in text
    assert main(['show', 'run', '--model', 'bone.ply', '--report', 'b.html']) == 2
    assert 'gsdf replay --report' in capsys.readouterr().err


def test_a_report_of_two_recordings_is_refused(
        job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['replay', 'run', 'run', '--model', 'bone.ply', '--report', 'a.html']) == 2
    assert capsys.readouterr().err.startswith('gsdf: error: --report describes one recording')
    assert not (job / 'a.html').exists()


def test_without_pillow_the_error_says_what_to_install(job: Path) -> None:
    code = ('import sys; sys.modules["PIL"] = None; '
            'from gsdf_registration.cli.main import main; sys.exit(main(sys.argv[1:]))')
    command = ['register', 'bone.ply', 'points.csv', '--unit', 'mm', '--initial', 'start.json']
    root = Path(__file__).parents[2]
    asked, unasked = (subprocess.run(
        [sys.executable, '-c', code, *command, *more], capture_output=True, text=True,
        env={**os.environ, 'PYTHONPATH': str(root)}) for more in (['--report', 'a.html'], []))
    assert (asked.returncode, asked.stdout) == (2, '')
    assert asked.stderr == ('gsdf: error: a report needs Pillow, which is not installed: '
                            "pip install 'gsdf_registration[report]'\n")
    assert unasked.returncode == 0, unasked.stderr
