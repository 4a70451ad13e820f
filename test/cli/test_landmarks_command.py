# SPDX-License-Identifier: Apache-2.0
"""``gsdf landmarks``: what it prints is settings; and landmarks of a file as measurements."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from gsdf_registration.cli.main import main
from gsdf_registration.common.config import Config
from gsdf_registration.simulation.femur import HEAD
from msg_adapters.slicer import only_list


def test_prints_settings_with_the_hip_centre(femur_bone: Path,
                                             capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['landmarks', str(femur_bone)]) == 0
    output = capsys.readouterr().out
    assert 'femoral head, radius 23.5' in output
    config = Config.from_nested(yaml.safe_load(output))
    assert config.landmarks.names[0] == config.landmarks.joint_centre == 'hip_centre'
    np.testing.assert_allclose(config.landmarks.positions[:3], 1e-3 * np.array(HEAD), atol=3e-4)
    assert len(config.landmarks.names) == 5


def test_says_when_there_is_no_hip_joint(tmp_path: Path,
                                         capsys: pytest.CaptureFixture[str]) -> None:
    from smooth_bone import bone_mesh
    bone_mesh().export(tmp_path / 'bone.stl')
    assert main(['landmarks', str(tmp_path / 'bone.stl'), '--model-unit', 'm', '--json', '-']) == 0
    output, errors = capsys.readouterr()
    document = json.loads(output)
    assert document['hip_centre'] is None and list(document['landmarks']) == [
        'extreme_1', 'extreme_2', 'extreme_3', 'extreme_4']
    assert errors.startswith('note: the bone has no femoral head or acetabulum')


@pytest.mark.parametrize(('unit', 'scale'), [('m', 1.0), ('mm', 1e3)])
def test_a_file_of_landmarks_with_sigma_measures_the_pose(
        unit: str, scale: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from smooth_bone import LANDMARKS, T_TRACKER_BONE, bone_mesh, touched_points

    from gsdf_registration.common.rigid import transform
    bone_mesh().export(tmp_path / 'bone.stl')
    points = scale * transform(T_TRACKER_BONE, touched_points(400, 0, 3e-4))
    np.savetxt(tmp_path / 'points.csv', points, delimiter=',', header='x,y,z', comments='')
    touched = scale * (transform(T_TRACKER_BONE, LANDMARKS) + [[0, 0, 0], [0.03, 0, 0], [0, 0, 0]])
    rows = [f'{name},{",".join(map(str, model))},{",".join(map(str, at))},{scale * 0.002}'
            for name, model, at in zip('abc', LANDMARKS, touched)]
    (tmp_path / 'marks.csv').write_text('\n'.join([
        'name,model_x,model_y,model_z,tracker_x,tracker_y,tracker_z,sigma', *rows]))
    assert main(['register', str(tmp_path / 'bone.stl'), str(tmp_path / 'points.csv'),
                 '--model-unit', 'm', '--unit', unit, '--landmarks', str(tmp_path / 'marks.csv'),
                 '--json', str(tmp_path / 'result.json')]) == 0
    document = json.loads((tmp_path / 'result.json').read_text())
    assert [(each['name'], each['used'], each['sigma_m']) for each in document['landmarks']] == [
        ('a', True, 0.002), ('b', False, 0.002), ('c', True, 0.002)]
    assert 'left out as a mistake: "b" is 29.7 mm' in document['message']
    assert 'landmark b' in capsys.readouterr().out


def test_writes_the_landmarks_for_slicer(femur_bone: Path, tmp_path: Path,
                                         capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['landmarks', str(femur_bone), '--markups', str(tmp_path / 'a.mrk.json'), '--json',
                 str(tmp_path / 'a.json')]) == 0
    listed = json.loads((tmp_path / 'a.json').read_text())['landmarks']
    points = only_list(tmp_path / 'a.mrk.json', 'lps')
    np.testing.assert_allclose(points.positions, [listed[label] for label in points.labels])
    assert points.labels[0] == 'hip_centre'
    capsys.readouterr()
    assert main(['landmarks', str(femur_bone), '--markups', str(tmp_path / 'a.csv')]) == 2
    shown = capsys.readouterr()
    assert 'has the ending .mrk.json or .fcsv' in shown.err and not shown.out   # at once
