# SPDX-License-Identifier: Apache-2.0
"""The recording of tool poses in bags/, pivoting, swing and strokes, over DDS and offline."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import PoseStamped
from ros_support import ROOT, Client, NodeProcess

from gsdf_registration.cli.main import main
from gsdf_registration.common.rigid import Array, displacement
from msg_adapters import ros
from msg_adapters.bag import read_bag
from msg_adapters.settings_file import read_config
from msg_adapters.truth import Truth, read_truth

pytestmark = pytest.mark.ros
BAG = ROOT / 'bags' / 'femur_tool'
PROBE, ARRAY = '/probe/measured_cp', '/array/measured_cp'
PARTS = {'pivoting': '/probe/pivoting', 'swinging': '/array/swinging', 'strokes': PROBE,
         'array': ARRAY}
RATE = '10'     # times the speed of the recording


@pytest.fixture(scope='module')
def truth() -> Truth:
    return read_truth(BAG.with_suffix('.yaml'))


@pytest.fixture(scope='module')
def client(truth: Truth, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    about, model = truth.about, BAG.parent / truth.model
    node = NodeProcess(tmp_path_factory.mktemp('recording') / 'log', 'recording', **{
        'model.path': model, 'model.unit': truth.model_unit,
        'probe.topics': [PROBE], 'probe.type': 'pose',
        'probe.tip_radius': 1e-3 * about['tip_radius'], 'reference.topic': ARRAY,
        'collect.automatic': 'false', 'live.enabled': 'false', 'landmarks.names': ['hip_centre'],
        'landmarks.positions': about['hip_centre']['model']})
    with Client(node) as client:
        client.await_state('active')
        yield client
    node.stop()


def play(**topics: str) -> None:
    """Play parts of the recording on the given topics."""
    words = [word for part, name in topics.items()
             for word in ('--topic', PARTS[part], '--as', name)]
    done = subprocess.run([sys.executable, '-m', 'gsdf_registration.clients.player', str(BAG),
                           '--rate', RATE, *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def calibrate(client: Client, service: str, part: str, topic: str) -> str:
    """Return the answer of a calibration with a part of the recording."""
    count = len(read_bag(BAG, [PARTS[part]]).positions)
    assert client.ask(service).success
    play(**{part: topic})
    client.spin_until(lambda: client.status().get('calibration.poses') == str(count),
                      'poses were lost')
    answer = client.ask(service)
    assert answer.success, answer.message
    return answer.message


def offline_pose(tmp_path: Path, truth: Truth) -> Array:
    """Return the pose that the commands find in the same recording."""
    tip, out = tmp_path / 'tip.yaml', tmp_path / 'out.json'
    assert main(['pivot', str(BAG), '--topic', '/probe/pivoting', '-o', str(tip)]) == 0
    assert main(['replay', str(BAG), '--model', str(BAG.parent / truth.model), '--topic', PROBE,
                 '--reference', ARRAY, '--config', str(tip), '--tip-radius',
                 str(1e-3 * truth.about['tip_radius']), '--json', str(out)]) == 0
    return np.array(json.loads(out.read_text())['T_tracker_bone'])


def test_the_recording_registers_alike_over_dds_and_offline(client: Client, truth: Truth,
                                                            tmp_path: Path) -> None:
    message = calibrate(client, 'calibrate_tip', 'pivoting', PROBE)
    tip = read_config(re.search(r'written to (\S+\.yaml)', message)[1]).probe.tip
    assert np.linalg.norm(np.array(tip) - truth.about['tip']) < 3e-4
    message = calibrate(client, 'find_joint_centre', 'swinging', ARRAY)
    found = np.array(json.loads(re.search(r' at (\[.*?\]) mm', message)[1]))
    assert np.linalg.norm(1e-3 * found - truth.about['hip_centre']['array']) < 0.004

    client.collect(True)
    play(strokes=PROBE, array=ARRAY)
    client.spin_until(lambda: int(client.status()['kept']) > 700, 'points were lost')
    client.collect(False)
    answer = client.ask('register')
    assert answer.success, answer.message
    _, T, frame_id = ros.pose_from(client.receive(PoseStamped, '~/bone_pose'))
    assert frame_id == 'recording_reference_array'
    T_offline, places = offline_pose(tmp_path, truth), truth.landmarks_model
    assert displacement(T, truth.T_tracker_bone, places).max() < 1e-3
    assert displacement(T_offline, truth.T_tracker_bone, places).max() < 1e-3
    assert displacement(T, T_offline, places).max() < 5e-4


@pytest.mark.parametrize('options, sentence', [
    (['--topic', '/other'], 'contains no positions or poses on /other'),
    (['--topic', PROBE, '--topic', ARRAY, '--as', '/a'], 'give --as once for each --topic')])
def test_the_player_says_what_is_wrong(options: list[str], sentence: str) -> None:
    done = subprocess.run([sys.executable, '-m', 'gsdf_registration.clients.player', str(BAG),
                           *options], capture_output=True, text=True)
    assert done.returncode == 2 and sentence in done.stderr and done.stderr.count('\n') == 1
