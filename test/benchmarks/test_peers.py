# SPDX-License-Identifier: Apache-2.0
"""Peers: their environments, failing processes, and the poses they return."""

from __future__ import annotations

import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from benchmarks.paper import experiment
from benchmarks.peers import environment, peer_process
from benchmarks.peers.environment import Group
from benchmarks.peers.peer_process import PeerError, PeerProcess
from gsdf_registration.common import rigid

OWN = '.'.join(map(str, sys.version_info[:2]))
STUB = """
import os, threading
import numpy as np

def moves(model):
    print('libraries print')
    def align(points, noise):
        print('whatever they like')
        motion = np.eye(4)
        motion[:3, 3] = model['offset'] + points.mean(axis=0) + noise
        return motion
    return align

def raises(model):
    def align(points, noise):
        raise ValueError('no\\ngood')
    return align

def hangs(model):
    return lambda points, noise: threading.Event().wait()

def dies(model):
    return lambda points, noise: os.kill(os.getpid(), 11)

def diverges(model):
    return lambda points, noise: np.full((4, 4), np.inf)

def unfit(model):
    raise ImportError('no such library')
"""


@pytest.fixture
def stub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Return a function that starts one of the peers above."""
    shutil.copy(peer_process.WORKERS / 'worker.py', tmp_path)
    (tmp_path / 'stub.py').write_text(STUB)
    np.savez(tmp_path / 'model.npz', offset=np.array([1.0, 2.0, 3.0]))
    monkeypatch.setattr(peer_process, 'WORKERS', tmp_path)
    opened: list[PeerProcess] = []

    def work(peer: str, limit: float = 60.0) -> PeerProcess:
        opened.append(PeerProcess(Path(sys.executable), ('stub', peer), tmp_path / 'model.npz',
                                  limit))
        return opened[-1]
    yield work
    for peer in opened:
        peer.close()


def test_peer_answers_repeatedly(stub) -> None:
    peer = stub('moves')
    for k in range(3):
        motion, seconds = peer(np.full((1000, 3), float(k)), 0.5)
        np.testing.assert_allclose(motion[:3, 3], [1.5 + k, 2.5 + k, 3.5 + k])
        assert seconds >= 0.0
    assert peer.alive


def test_peer_answers_again_after_an_exception(stub) -> None:
    peer = stub('raises')
    for _ in range(2):
        with pytest.raises(PeerError, match='^ValueError: no good$') as caught:
            peer(np.zeros((3, 3)), 0.5)
        assert not caught.value.timeout
    assert peer.alive


@pytest.mark.parametrize('peer, limit, why', [('hangs', 0.3, 'no answer within'),
                                              ('dies', 60.0, 'died of signal 11')])
def test_reports_a_peer_that_exits_or_times_out(stub, peer: str, limit: float, why: str) -> None:
    gone = stub(peer, limit)
    with pytest.raises(PeerError, match=why) as caught:
        gone(np.zeros((3, 3)), 0.5)
    assert caught.value.timeout == (peer == 'hangs')
    assert not gone.alive


def test_rejects_a_pose_that_is_not_finite(stub) -> None:
    with pytest.raises(PeerError, match='no finite pose'):
        stub('diverges')(np.zeros((3, 3)), 0.5)


def test_reports_why_a_peer_cannot_be_prepared(stub) -> None:
    with pytest.raises(PeerError, match='ImportError: no such library'):
        stub('unfit')


def wheel(folder: Path) -> Path:
    """Return the wheel of a package that pip can install without a network."""
    file = folder / 'tiny_peer-1.0-py3-none-any.whl'
    about = 'tiny_peer-1.0.dist-info'
    with zipfile.ZipFile(file, 'w') as archive:
        archive.writestr('tiny_peer.py', 'WORKS = True\n')
        archive.writestr(f'{about}/METADATA',
                         'Metadata-Version: 2.1\nName: tiny-peer\nVersion: 1.0\n')
        archive.writestr(f'{about}/WHEEL', 'Wheel-Version: 1.0\nGenerator: test\n'
                         'Root-Is-Purelib: true\nTag: py3-none-any\n')
        archive.writestr(f'{about}/RECORD', '')
    return file


def test_environment_is_created_once_and_lists_missing_libraries(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'cache'))
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    tiny, absent = wheel(tmp_path), tmp_path / 'absent-1.0-py3-none-any.whl'
    group = Group('test', (OWN,), ('pip',), {'tiny': (str(tiny),), 'absent': (str(absent),)})
    made = environment.environment(group)
    assert made.python is not None
    assert list(made.missing) == ['absent'] and 'absent-1.0' in made.missing['absent']
    found = next((tmp_path / 'cache').rglob('tiny_peer.py'))
    found.unlink()
    tiny.unlink()
    again = environment.environment(group)
    assert again == made and not found.exists()      # it was not installed again


def test_without_a_suitable_python_all_libraries_are_missing() -> None:
    made = environment.environment(Group('test', ('3.1',), (), {'tiny': ('tiny',)}))
    assert made.python is None and made.missing['tiny'].startswith('needs Python 3.1')


@pytest.mark.parametrize('library, worker', [('open3d', 'open3d_tukey'),
                                             ('small_gicp', 'small_gicp_plane')])
def test_icps_correct_a_small_displacement(library: str, worker: str, hip_bone: Path,
                                           tmp_path: Path) -> None:
    pytest.importorskip(library)
    model = experiment.model_file(str(hip_bone), tmp_path)
    points = np.load(model)['points'][:1500]
    off = rigid.exp([0.02, -0.03, 0.01, 0.002, 0.001, -0.002])
    peer = PeerProcess(Path(sys.executable), ('icp', worker), model)
    motion, _ = peer(rigid.transform(off, points), 5e-4)
    peer.close()
    assert np.linalg.norm(rigid.transform(motion @ off, points) - points, axis=1).max() < 5e-4
