# SPDX-License-Identifier: Apache-2.0
"""``gsdf simulate``: the bag, the ground truth and the messages."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from gsdf_registration.cli.inputs import field_or_refusal, read_recording
from gsdf_registration.cli.main import main
from gsdf_registration.cli.simulate import ARRAY_TOPIC, REGIONS
from gsdf_registration.cli.simulate_tool import TOPICS
from gsdf_registration.cli.simulation_options import ARRAY_FRAME, STRUCTURED
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import inverse, rms_displacement, transform
from gsdf_registration.common.tool_pose import tip_positions
from gsdf_registration.field import Field
from gsdf_registration.search.global_search import find_start_poses
from gsdf_registration.session.replay import replay_events
from gsdf_registration.simulation.ball_tip import BallContact
from gsdf_registration.simulation.interference import Interference
from gsdf_registration.simulation.regions import RADIUS
from msg_adapters.bag import list_topics, read_bag
from msg_adapters.truth import read_truth


def test_help_names_all_regions_and_kinds() -> None:
    assert set(REGIONS) == set(RADIUS)
    assert {'uniform', *STRUCTURED} == {share.name for share in fields(Interference)}


def simulate(bone: Path, output: Path, *options: str, region: str = 'acetabulum') -> int:
    return main(['simulate', str(bone), f'--region={region}', '-o', str(output), *options])


def test_writes_bag_and_ground_truth(hip_bone: Path, tmp_path: Path,
                                     capsys: pytest.CaptureFixture[str]) -> None:
    options = [
        '--points', '200', '--outliers', '0.1', '--interference', 'soft_tissue:0.1,lift_off:0.05',
        '--landmark', 'asis=33.9,58.3,78.2', '--frame-id', 'camera'
    ]
    assert simulate(hip_bone, tmp_path / 'run', *options) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert '267 points' in line and '200 of them' in line and '1 landmark;' in line
    recording, truth = read_bag(tmp_path / 'run'), read_truth(tmp_path / 'run.yaml')
    assert len(recording) == 267 and set(recording.frame_ids) == {'camera'
                                                                  } and truth.frame_id == 'camera'
    assert (tmp_path / truth.model).resolve() == hip_bone.resolve()
    np.testing.assert_allclose(truth.landmarks_model, [[0.0339, 0.0583, 0.0782]])
    near = np.linalg.norm(transform(inverse(truth.T_tracker_bone), recording.positions),
                          axis=1) < 0.055
    assert near.mean() > 0.8        # around the acetabulum, the origin of the model


def test_same_arguments_give_the_same_bytes(hip_bone: Path, tmp_path: Path) -> None:
    for place in ('a', 'b'):
        (tmp_path / place).mkdir()
        assert simulate(hip_bone, tmp_path / place / 'run', '--points', '100', '--seed', '3') == 0
    for name in ('run/run.mcap', 'run/metadata.yaml', 'run.yaml'):
        assert (tmp_path / 'a' / name).read_bytes() == (tmp_path / 'b' / name).read_bytes()


def test_region_as_a_ball(femur_bone: Path, tmp_path: Path) -> None:
    assert simulate(femur_bone, tmp_path / 'run', '--points', '100', region='-25,0,0,30') == 0
    truth = read_truth(tmp_path / 'run.yaml')
    points = transform(inverse(truth.T_tracker_bone), read_bag(tmp_path / 'run').positions)
    assert np.linalg.norm(points - [-0.025, 0.0, 0.0], axis=1).max() < 0.032


def test_registers_a_moving_patient_in_the_frame_of_the_array(
        hip_bone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
        monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path))
    places = {'asis': '33.9,58.3,78.2', 'rim': '10,-28,-12', 'spine': '-25,-45,30'}
    marks = [word for mark in places.items() for word in ('--landmark', '='.join(mark))]
    assert simulate(hip_bone, tmp_path / 'run', *marks, '--move', '20,10') == 0
    truth = read_truth(tmp_path / 'run.yaml')
    assert truth.frame_id == ARRAY_FRAME and truth.about['move'] == '20,10'
    config = tmp_path / 'config.yaml'
    config.write_text(f'reference: {{topic: {ARRAY_TOPIC}}}')
    printed = []
    for options in ([], ['--config', str(config)]):
        main(['replay', str(tmp_path / 'run'), '--model', str(hip_bone), '--landmarks',
              str(tmp_path / 'run.yaml'), '--json', str(tmp_path / 'out.json'), *options])
        printed.append(capsys.readouterr().out)
    outcome = json.loads((tmp_path / 'out.json').read_text())
    assert outcome['success'] and outcome['bone_pose']['frame_id'] == ARRAY_FRAME
    T = np.array(outcome['T_tracker_bone'])
    assert np.linalg.norm((T - truth.T_tracker_bone)[:3, 3]) < 1e-3
    assert 'true error' in printed[1] and 'true error' not in printed[0]


def test_writes_poses_of_a_tool_and_the_calls_of_the_operator(
        femur_bone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ['--tool-poses', '--points', '100', '--rate', '40', '--pivoting', '6', '--swinging',
               '6', '--tip', '0,0,200', '--tip-radius', '1', '--landmark', 'trochlea=2.4,27.9,52.8']
    assert simulate(femur_bone, tmp_path / 'run', *options, region='condyles') == 0
    assert '100 samples on the bone, 1 landmark;' in capsys.readouterr().out
    truth = read_truth(tmp_path / 'run.yaml')
    counts = {topic.name: topic.messages for topic in list_topics(tmp_path / 'run')}
    assert set(counts) == set(TOPICS.values())
    assert counts['/probe/pivoting'] == counts['/array/swinging'] == 240
    recording = read_bag(tmp_path / 'run', ['/probe/pivoting'])
    assert recording.tools is not None
    tips = tip_positions(recording.tools, truth.about['tip'])
    assert np.linalg.norm(tips - truth.about['pivot'], axis=1).max() < 3e-3
    assert truth.frame_id == ARRAY_FRAME and truth.about['tip'] == [0.0, 0.0, 0.2]
    head = truth.about['hip_centre']
    np.testing.assert_allclose(transform(truth.T_tracker_bone, head['model']), head['array'],
                               atol=1e-6)
    np.testing.assert_allclose(head['model'], [-0.005, 0.011, 0.414], atol=1e-3)
    assert [call[1] for call in truth.about['calls']] == [
        'calibrate_tip', 'calibrate_tip', 'find_joint_centre', 'find_joint_centre',
        'capture_landmark', 'collect', 'collect', 'register']


def test_gaps_cartilage_soft_tissue_and_a_ball_tip_are_for_positions_too(
        hip_bone: Path, hip_surface: tuple[np.ndarray, np.ndarray], tmp_path: Path) -> None:
    options = ['--points', '300', '--rate', '40', '--sigma', '0.05', '--tip-radius', '1',
               '--cartilage', '--soft-tissue', '1', '--gaps', '30', '--pause', '2,3']
    assert simulate(hip_bone, tmp_path / 'run', *options) == 0
    recording, truth = read_bag(tmp_path / 'run'), read_truth(tmp_path / 'run.yaml')
    assert len(recording) < 300
    tips = transform(inverse(truth.T_tracker_bone), recording.positions)
    heights = BallContact(*hip_surface).distance(tips)[0]
    assert 0.0015 < np.median(heights) < 0.004 and heights.min() > 0.0008


@pytest.mark.parametrize('options, sentence', [
    (['--pivoting', '5'], '--pivoting needs --tool-poses'),
    (['--tool-poses', '--swinging', '5'], 'no head'),
    (['--tool-poses', '--tip', '1,2'], '--tip must be 3 numbers'),
    (['--tool-poses', '--pivoting', '-5'], '--pivoting must be at least 0'),
    (['--tool-poses', '--orientation-noise', 'nan'], '--orientation-noise must be at least 0'),
    (['--tip-radius', '-1'], 'radius of the tip must be 0 to 10 mm'),
    (['--soft-tissue', '50'], 'thickness of soft tissue must be 0 to 10 mm'),
    (['--gaps', '-1'], '--gaps must be at least 0'),
    (['--pause', '2,1'], '--pause must be two rising times'),
    (['--stroke', '0'], '--stroke must be at least 1'),
    (['--unsteadiness', '-1'], '--unsteadiness must be at least 0'),
    (['--move', '20'], '--move must be 2 numbers'),
    (['--move', '20,-1'], '--move must not be negative'),
    (['--interference', 'gremlins:0.1'], '"gremlins" is unknown'),
    (['--interference', 'resting:lots'], '--interference resting must be 1 number'),
    (['--outliers', '1.0'], 'shares of interference'),
    (['--sigma', '0.1,0.2'], '--sigma must be 3 numbers'),
    (['--sigma=-1'], '--sigma must not be negative'),
    (['--points', '3'], '--points must be at least 30'),
    (['--rate', 'nan'], '--rate must be at least 1'),
    (['--seed', '-4'], '--seed must be at least 0'),
    (['--dropouts', '0.95'], '--dropouts must lie in'),
    (['--landmark', 'here'], '--landmark here must be 3 numbers'),
    (['--region', '1,2,3'], '--region must be 4 numbers'),
    (['--region', '900,0,0,10'], 'the region has too little bone'),
    (['--region', 'skull'], 'is unknown'),
    (['--model-unit', 'm'], 'unit'),
])
def test_reports_errors_in_one_line(hip_bone: Path, tmp_path: Path,
                                    capsys: pytest.CaptureFixture[str], options: list[str],
                                    sentence: str) -> None:
    assert simulate(hip_bone, tmp_path / 'run', *options) == 2
    error = capsys.readouterr().err
    assert sentence in error and len(error.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_overwrites_nothing(hip_bone: Path, tmp_path: Path,
                            capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'run').mkdir()
    assert simulate(hip_bone, tmp_path / 'run') == 2
    assert 'exists already' in capsys.readouterr().err
    assert list(tmp_path.rglob('*')) == [tmp_path / 'run']


def test_the_search_finds_the_bone_among_the_ways_of_a_tool_through_the_air(
        bags: Path, tmp_path: Path) -> None:
    assert simulate(bags / 'hip.ply', tmp_path / 'stream', '--tool-poses', '--seed', '22') == 0
    config = Config.from_flat({
        'model.path': str(bags / 'hip.ply'), 'probe.tip': [0.012, -0.021, 0.148],
        'reference.topic': '/array/measured_cp'})
    field = field_or_refusal(config)
    assert isinstance(field, Field)
    recording = read_recording(str(tmp_path / 'stream'), config, ['/probe/measured_cp'], '')
    replayed = replay_events(recording, field, lambda *_: config, None, None)
    points = replayed.session.points().positions
    T_bone_tracker = inverse(read_truth(tmp_path / 'stream.yaml').T_tracker_bone)
    # also without the filter of isolated points, which a registration applies before the search
    found = find_start_poses(points, field, config.search)
    assert min(rms_displacement(T, T_bone_tracker, points) for T in found) < 0.002
