# SPDX-License-Identifier: Apache-2.0
"""What the node would publish during a replay, written to a recording that viewers open."""

from __future__ import annotations

import re
import shutil
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.cli.main import main
from gsdf_registration.cli.session_bag import recorded
from gsdf_registration.common.config import Config
from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.rigid import transform
from gsdf_registration.field.store import save_field
from gsdf_registration.session.replay import replay_events
from gsdf_registration.visualization.marker_scene import centre_of
from msg_adapters import results
from msg_adapters.bag_writer import BagWriter
from msg_adapters.marker_cdr import Shape, from_bytes
from msg_adapters.motion import to_matrix
from msg_adapters.recording import RecordedEvent, Recording

PAGE = Path(__file__).parents[2] / 'docs/interface.md'
START, RATE = 1.7e9, 100.0      # s, Hz, of the samples
# number of points before each call
COLLECT, REGISTER, CLEAR, END = 0, 250, 330, 340
TYPED = {'/registration/result', '/registration/guidance'}
TOPICS = {'/tf', '/tf_static', '/diagnostics', *(f'/registration/{name}' for name in (
    'bone_pose', 'bone_pose_with_covariance', 'live_pose', 'tip', 'status', 'events', 'points',
    'markers'))}


def recording() -> Recording:
    """Return a scan with what the operator did, as the node records it."""
    points = transform(T_TRACKER_BONE, touched_points(END, sigma=1e-4))
    order = np.argsort(points @ [0.6, 0.5, 0.4])        # a slow stroke
    settings = {'settings': Config().replaced({'gate.max_speed': 50.0}).flat()}
    calls = [(0, 'configure', settings), (0, 'activate', settings), (COLLECT, 'collect', {
        'data': True}), (REGISTER, 'register', {}), (CLEAR, 'clear', {})]
    return Recording(
        positions=points[order], stamps=START + np.arange(END) / RATE, frame_ids='tracker',
        source_names=('/probe/tip',), events=[
            RecordedEvent(after, 0, OperatorEvent(number, name, 5.0, request=request, kept=-1))
            for number, (after, name, request) in enumerate(calls, 1)])


def record(path: Path) -> Any:
    """Replay the scan and record the topics; return what the replay found."""
    with recorded(str(path), recording(), bone_field()) as watch:
        return replay_events(recording(), bone_field(), lambda config: config, watch=watch)


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('session') / 'topics'
    record(path)
    return path


@pytest.fixture(scope='module')
def decoded(bag: Path) -> dict[str, list[tuple[float, Any]]]:
    """Return time, s, and content of every message by topic, read as its own schema says."""
    found, stores = defaultdict(list), {}
    for schema, channel, message in messages_of(bag):
        assert (schema.encoding, channel.message_encoding) == ('ros2msg', 'cdr')
        if schema.name not in stores:
            stores[schema.name] = get_typestore(Stores.EMPTY)
            stores[schema.name].register(get_types_from_msg(schema.data.decode(), schema.name))
        found[channel.topic].append((1e-9 * message.log_time, stores[schema.name].deserialize_cdr(
            message.data, schema.name)))
    return found


def messages_of(path: Path) -> Iterator[Any]:
    with (path / f'{path.name}.mcap').open('rb') as file:
        yield from make_reader(file).iter_messages()


def values(status: Any) -> dict[str, str]:
    return {each.key: each.value for each in status.values}


def test_every_topic_of_the_node_is_there_with_a_complete_schema(
        decoded: dict[str, list[tuple[float, Any]]]) -> None:
    assert decoded.keys() == TOPICS | (TYPED if results.available() else set())
    times = [time for messages in decoded.values() for time, _ in messages]
    assert min(times) >= START and max(times) <= START + (END - 1) / RATE + 1e-6
    tips = decoded['/registration/tip']
    assert len(tips) == END
    assert np.ptp([tip.header.stamp.sec + 1e-9 * tip.header.stamp.nanosec - time
                   for time, tip in tips]) < 1e-6
    assert [values(event)['event'] for _, event in decoded['/registration/events']] == [
        'configure', 'activate', 'collect', 'register', 'clear']


def test_a_player_offers_what_the_node_offers(bag: Path) -> None:
    with AnyReader([bag]) as reader:        # from metadata.yaml
        latched = {each.topic for each in reader.connections if any(
            qos.durability is QosDurability.TRANSIENT_LOCAL
            for qos in each.ext.offered_qos_profiles)}
    rows = re.findall(r'^\| pub \| `(\S+)` \| \S+ \| latched', PAGE.read_text(), re.MULTILINE)
    assert latched == {name.replace('~', '/registration') for name in rows} - (
        set() if results.available() else TYPED)
    for _, channel, _ in messages_of(bag):
        assert ('transient_local' in channel.metadata['offered_qos_profiles']) is (
            channel.topic in latched)


def test_the_pose_is_there_from_the_registration_until_it_is_withdrawn(
        decoded: dict[str, list[tuple[float, Any]]]) -> None:
    states = [values(status)['state'] for _, status in decoded['/registration/status']]
    assert 'collecting' in states[states.index('registered'):]      # cleared
    (_, pose), = decoded['/registration/bone_pose']
    T = to_matrix(pose.pose.position, pose.pose.orientation)
    assert np.abs(T - T_TRACKER_BONE).max() < 5e-3
    sent = decoded['/tf']
    assert {(each.transforms[0].header.frame_id, each.transforms[0].child_frame_id)
            for _, each in sent} == {('tracker', 'bone')}
    # re-sent at tf.rate until the session is cleared
    first, last = sent[0][0] - START, sent[-1][0] - START
    assert REGISTER / RATE <= first < last <= CLEAR / RATE and len(sent) >= 5
    assert len(decoded['/registration/live_pose']) > 10
    if results.available():
        assert [result.valid for _, result in decoded['/registration/result']] == [
            False, True, False]


def test_the_bone_is_drawn_and_the_layouts_look_at_its_centre(
        bag: Path, decoded: dict[str, list[tuple[float, Any]]]) -> None:
    drawn = [from_bytes(message.data) for _, channel, message in messages_of(bag)
             if channel.topic == '/registration/markers']
    assert all(scene[0].shape is Shape.TRIANGLE_LIST for scene in drawn)
    assert any(marker.ns == 'points' for scene in drawn for marker in scene)
    (_, sent), = decoded['/tf_static']
    shift = sent.transforms[0].transform.translation
    assert [shift.x, shift.y, shift.z] == pytest.approx(centre_of(bone_field()))
    assert sent.transforms[0].child_frame_id == 'bone_centre'
    clouds = [cloud.width for _, cloud in decoded['/registration/points']]
    assert max(clouds) > 200 and clouds[-1] == 0        # cleared


def test_the_same_recording_gives_the_same_bytes_and_the_same_pose(bag: Path,
                                                                   tmp_path: Path) -> None:
    plain = replay_events(recording(), bone_field(), lambda config: config)
    watched = record(tmp_path / 'topics')
    name = 'topics/topics.mcap'
    assert (tmp_path / name).read_bytes() == (bag.parent / name).read_bytes()
    assert (watched.result.reason, watched.notes) == (plain.result.reason, plain.notes)


def test_the_command_records_one_session_into_a_new_folder(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bone_file, scan = tmp_path / 'bone.gsdf', tmp_path / 'scan'
    save_field(bone_field(), bone_file)
    with BagWriter(scan) as writer:
        for stamp, position in zip(recording().stamps, recording().positions):
            writer.write_point('/probe/tip', stamp, position, 'tracker')
    shutil.copytree(scan, tmp_path / 'other')
    options = ['--model', str(bone_file), '--mcap', str(tmp_path / 'out')]
    (tmp_path / 'out').mkdir()
    assert main(['replay', str(scan), *options]) == 2
    assert 'exists already; remove it' in capsys.readouterr().err
    assert main(['replay', str(scan), str(tmp_path / 'other'), *options]) == 2
    assert '--mcap records one session' in capsys.readouterr().err
    (tmp_path / 'out').rmdir()
    assert main(['replay', str(scan), *options]) in (0, 1)
    assert next(messages_of(tmp_path / 'out'))[0].name == 'tf2_msgs/msg/TFMessage'
