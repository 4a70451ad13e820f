# SPDX-License-Identifier: Apache-2.0
"""Test points, landmarks and results in the formats of 3D Slicer, tf2 and CRTK."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from refusals import command_refusal as refusal

from gsdf_registration.cli.main import main
from gsdf_registration.common.rigid import Array, from_rt, rotation_from_quaternion
from msg_adapters.recording import Recording
from msg_adapters.slicer import FLIP, PointList, only_list, read_point_lists, write_point_lists
from msg_adapters.truth import Truth

TURN = np.diag([*FLIP, 1.0])        # from LPS to RAS, its own inverse


@pytest.fixture
def points(tmp_path: Path, optical_recording: tuple[Recording, Truth]) -> Path:
    path = tmp_path / 'points.csv'
    np.savetxt(path, optical_recording[0].positions, delimiter=',', header='x,y,z', comments='')
    return path


@pytest.fixture
def lists(tmp_path: Path, optical_recording: tuple[Recording, Truth]) -> tuple[Path, Path]:
    """Return the landmarks on the model and the touched ones, saved by Slicer in RAS."""
    truth, paths = optical_recording[1], (tmp_path / 'model.mrk.json', tmp_path / 'touched.fcsv')
    for path, positions in zip(paths, (truth.landmarks_model, truth.landmarks_tracker)):
        write_point_lists(path, [PointList('', list(truth.landmark_names), FLIP * positions)],
                          'ras')
    return paths


def register(tmp_path: Path, model: Path, points: Path, *options: object,
             unit: str = 'm') -> dict[str, Any]:
    out = tmp_path / 'result.json'
    assert main(['register', str(model), str(points), '--unit', unit, '--json', str(out),
                 *map(str, options)]) == 0
    return json.loads(out.read_text())


def assert_pose(T: Array, expected: Array) -> None:
    assert np.abs(T - expected).max() < 2e-3


def test_point_lists_give_the_pose_in_the_axes_of_the_model(
        tmp_path: Path, hip_bone: Path, lists: tuple[Path, Path],
        optical_recording: tuple[Recording, Truth]) -> None:
    recording, truth = optical_recording
    points = tmp_path / 'points.mrk.json'
    write_point_lists(points, [PointList('', ['p'] * len(recording), recording.positions)], 'lps')
    landmarks = ['--landmarks', lists[0], '--landmarks', lists[1]]
    T = register(tmp_path, hip_bone, points, *landmarks, unit='mm')['T_tracker_bone']
    assert_pose(np.array(T), truth.T_tracker_bone)
    T = register(tmp_path, hip_bone, points, *landmarks, '--tracker-axes', 'ras',
                 unit='mm')['T_tracker_bone']
    assert_pose(np.array(T), TURN @ truth.T_tracker_bone)


def test_the_pose_is_written_for_slicer_tf2_and_crtk(
        tmp_path: Path, hip_bone: Path, points: Path, lists: tuple[Path, Path],
        optical_recording: tuple[Recording, Truth]) -> None:
    files = {name: tmp_path / f'out.{name}' for name in ('tfm', 'mrk.json', 'tf2', 'crtk')}
    T = np.array(register(
        tmp_path, hip_bone, points, '--landmarks', lists[0], '--landmarks', lists[1],
        '--slicer', files['tfm'], '--markups', files['mrk.json'], '--tf2', files['tf2'],
        '--crtk', files['crtk'])['T_tracker_bone'])
    assert 'AffineTransform_double_3_3' in files['tfm'].read_text()
    static = yaml.safe_load(files['tf2'].read_text())['transforms'][0]
    assert static['header']['frame_id'] == 'tracker' and static['child_frame_id'] == 'bone'
    pose = yaml.safe_load(files['crtk'].read_text())['pose']
    for rotation, position in ((static['transform']['rotation'],
                                static['transform']['translation']),
                               (pose['orientation'], pose['position'])):
        np.testing.assert_allclose(
            from_rt(rotation_from_quaternion([rotation[name] for name in 'xyzw']),
                    [position[name] for name in 'xyz']), T, atol=1e-12)
    marks, touched = read_point_lists(files['mrk.json'])
    assert marks.labels == list(optical_recording[1].landmark_names)
    np.testing.assert_allclose(marks.positions, optical_recording[1].landmarks_tracker)
    np.testing.assert_allclose(touched.positions, optical_recording[0].positions, atol=1e-9)


def test_wrong_axes_of_the_landmarks_are_named(
        tmp_path: Path, hip_bone: Path, points: Path, lists: tuple[Path, Path],
        capsys: pytest.CaptureFixture[str], optical_recording: tuple[Recording, Truth]) -> None:
    truth = optical_recording[1]
    # saved with the other coordinate system than that of the model
    write_point_lists(lists[0], [PointList('', list(truth.landmark_names), truth.landmarks_model)],
                      'ras')
    landmarks = ['--landmarks', lists[0], '--landmarks', lists[1]]
    message = refusal(capsys, 'register', hip_bone, points, '--unit', 'm', *landmarks)
    assert 'use --model-axes ras' in message and 'off the model' in message
    T = register(tmp_path, hip_bone, points, *landmarks, '--model-axes', 'ras',
                 '--tracker-axes', 'lps')['T_tracker_bone']
    assert_pose(np.array(T), truth.T_tracker_bone)


def test_axes_that_contradict_the_model_are_refused(
        tmp_path: Path, hip_bone: Path, points: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stated = tmp_path / 'stated.ply'
    shutil.copy(hip_bone, stated)
    content = stated.read_bytes().replace(b'ply\n', b'ply\n', 1)
    first, rest = content.split(b'\n', 1)
    second, rest = rest.split(b'\n', 1)
    stated.write_bytes(b'\n'.join([first, second, b'comment SPACE=RAS', rest]))
    message = refusal(capsys, 'register', stated, points, '--unit', 'm', '--model-axes', 'lps')
    assert 'states that its axes are RAS: omit --model-axes lps' in message


def test_messages_say_what_a_landmark_list_needs(
        tmp_path: Path, hip_bone: Path, points: Path, lists: tuple[Path, Path],
        capsys: pytest.CaptureFixture[str]) -> None:
    command = ['register', hip_bone, points, '--unit', 'm']
    model, touched = lists
    assert 'add a list of the touched points' in refusal(capsys, *command, '--landmarks', model)
    labels = only_list(model, 'lps').labels
    other = tmp_path / 'other.fcsv'
    write_point_lists(other, [PointList('', [*labels[1:], 'other'], np.zeros((len(labels), 3)))])
    assert f'{labels[0]}, other is in one list only' in refusal(
        capsys, *command, '--landmarks', model, '--landmarks', other)
    assert 'is not a point list of Slicer' in refusal(
        capsys, *command, '--landmarks', model, '--landmarks', points)
    assert 'only point lists of Slicer come in two files' in refusal(
        capsys, *command, '--landmarks', points, '--landmarks', points)
    assert 'has the ending .tfm or .h5' in refusal(capsys, *command, '--slicer', 'pose.mat')
    assert 'has the ending .mrk.json or .fcsv' in refusal(capsys, *command, '--markups', 'a.json')
    (tmp_path / 'marks.csv').write_text('label,r,a,s\n')     # can be read, but not written
    assert 'has the ending .mrk.json or .fcsv' in refusal(
        capsys, *command, '--markups', tmp_path / 'marks.csv', '--json', tmp_path / 'none.json')
    assert not (tmp_path / 'none.json').exists()        # before the registration


def test_replay_writes_the_pose_of_one_recording(
        tmp_path: Path, optical_bag: Path, hip_bone: Path,
        capsys: pytest.CaptureFixture[str], optical_recording: tuple[Recording, Truth]) -> None:
    options = ['--model', hip_bone, '--landmarks', optical_bag.with_suffix('.yaml')]
    out = tmp_path / 'pose.yaml'
    assert main([str(word) for word in ['replay', optical_bag, *options, '--crtk', out]]) == 0
    pose = yaml.safe_load(out.read_text())
    assert pose['header']['frame_id'] == optical_recording[1].frame_id
    message = refusal(capsys, 'replay', optical_bag, optical_bag, *options, '--crtk', out)
    assert '--crtk is for one recording' in message
