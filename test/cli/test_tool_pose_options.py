# SPDX-License-Identifier: Apache-2.0
"""Poses of a tool on the command line: ``gsdf replay`` and ``gsdf register`` with a tip."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gsdf_registration.cli.main import main
from gsdf_registration.common.rigid import (
    displacement,
    from_rt,
    quaternion_from_rotation,
    rotation_exp,
)
from gsdf_registration.simulation.moving import Sway
from msg_adapters.bag import read_bag
from msg_adapters.bag_writer import BagWriter
from msg_adapters.truth import read_truth

BAGS = Path(__file__).parents[2] / 'bags'
MODEL, TRUTH = str(BAGS / 'hip.ply'), str(BAGS / 'hip_optical.yaml')
TIP = np.array([-0.012, -0.021, 0.148])
TIP_MM = '-12,-21,148'
PROBE, ARRAY = '/probe/measured_cp', '/array/measured_cp'


def tool_poses() -> tuple[np.ndarray, np.ndarray]:
    """Return stamps and poses of a tool whose tip was recorded."""
    recording = read_bag(BAGS / 'hip_optical')
    poses = []
    for i, position in enumerate(recording.positions):
        R = rotation_exp([0.3 * np.sin(0.01 * i), 0.3, 0.002 * i])
        poses.append(from_rt(R, position - R @ TIP))
    assert recording.stamps is not None
    return recording.stamps, np.array(poses)


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a bag with the poses of a tool and of a reference array that moves with the bone."""
    path, sway = tmp_path_factory.mktemp('tool') / 'bag', Sway(np.eye(4))
    stamps, poses = tool_poses()
    with BagWriter(path) as writer:
        for stamp, T in zip(stamps.tolist(), poses):
            writer.write_pose(ARRAY, stamp - 1e-4, sway.pose(stamp - 1e-4), 'cam')
            writer.write_pose(PROBE, stamp, sway.pose(stamp) @ T, 'cam')
        writer.write_pose(ARRAY, stamp + 1e-4, sway.pose(stamp + 1e-4), 'cam')
    return path


def run(*words: object) -> int:
    return main([str(word) for word in words])


def assert_near_truth(path: Path) -> None:
    document, truth = json.loads(path.read_text()), read_truth(TRUTH)
    T = np.array(document['T_tracker_bone'])
    assert displacement(T, truth.T_tracker_bone, truth.landmarks_model).max() < 1e-3


def test_replay_applies_the_tip_to_poses_relative_to_the_array(
        bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / 'out.json'
    words = ['replay', bag, '--model', MODEL, '--landmarks', TRUTH, '--reference', ARRAY,
             '--json', out]
    assert run(*words) == 1
    assert 'refused (bad_input): probe.tip is not set' in capsys.readouterr().out
    assert json.loads(out.read_text())['T_tracker_bone'] is None
    assert run(*words, '--tip', TIP_MM, '--unit', 'mm') == 0
    assert_near_truth(out)
    settings, tip = tmp_path / 'settings.yaml', tmp_path / 'tip.yaml'
    settings.write_text(f'probe: {{topics: [{PROBE}]}}\nreference: {{topic: {ARRAY}}}\n')
    tip.write_text(f'/**: {{ros__parameters: {{probe: {{tip: {TIP.tolist()}}}}}}}\n')
    assert run('replay', bag, '--model', MODEL, '--landmarks', TRUTH, '--json', out, '--config',
               settings, '--config', tip) == 0
    assert_near_truth(out)


def test_register_takes_poses_of_a_tool_as_a_table(tmp_path: Path,
                                                   capsys: pytest.CaptureFixture[str]) -> None:
    stamps, poses = tool_poses()
    rows = np.array([[stamp, *(1e3 * T[:3, 3]), *quaternion_from_rotation(T[:3, :3])]
                     for stamp, T in zip(stamps, poses)])
    rows[5, 4:] = 0.0       # no orientation
    out = tmp_path / 'out.json'
    for name, columns in (('times', slice(0, None)), ('places', slice(1, None))):
        path = tmp_path / f'{name}.csv'
        header = ['t', 'tx', 'ty', 'tz', 'qx', 'qy', 'qz', 'qw'][columns]
        np.savetxt(path, rows[:, columns], delimiter=',', header=','.join(header), comments='')
        words = ['register', MODEL, path, '--unit', 'mm', '--landmarks', TRUTH, '--json', out]
        assert run(*words) == 1
        assert 'probe.tip is not set' in capsys.readouterr().out
        assert run(*words, '--tip', TIP_MM) == 0
        assert '1 bad quaternion' in capsys.readouterr().out
        assert_near_truth(out)


def test_register_applies_the_tip_to_an_ndi_recording(tmp_path: Path) -> None:
    block = 'Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers'
    lines = [f'Tools,Port 0x02: Probe,{block}']
    for i, (stamp, T) in enumerate(zip(*tool_poses())):
        x, y, z, w = quaternion_from_rotation(T[:3, :3])
        numbers = ','.join(f'{value:.6f}' for value in (w, x, y, z, *(1e3 * T[:3, 3])))
        lines.append(f'1,Port 0x02: Probe,{i},{stamp:.4f},1,OK,{numbers},0.1,0')
    path, out = tmp_path / 'ndi.csv', tmp_path / 'out.json'
    path.write_text('\n'.join(lines) + '\n')
    assert run('register', MODEL, path, '--unit', 'mm', '--landmarks', TRUTH, '--json', out,
               '--tool', 'Probe', '--tip', TIP_MM) == 0
    assert_near_truth(out)


@pytest.mark.parametrize('tip', ['1,2', '1,2,x', '1,2,nan', '-1', '9999,0,0'])
def test_a_tip_must_be_three_numbers_near_the_tool(tip: str,
                                                   capsys: pytest.CaptureFixture[str]) -> None:
    try:
        status = run('register', MODEL, 'points.csv', '--unit', 'mm', '--tip', tip)
    except SystemExit as error:
        status = error.code
    assert status == 2
    error = capsys.readouterr().err
    assert error.count('\n') == 1 and 'tip' in error
