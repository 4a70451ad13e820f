# SPDX-License-Identifier: Apache-2.0
"""Test reading and writing of rosbag2 recordings."""

from __future__ import annotations

import shutil
from functools import partial

import numpy as np
import pytest
from refusals import refusal
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import exp
from msg_adapters.bag import list_topics, read_bag
from msg_adapters.bag_writer import BagWriter

refused = partial(refusal, read_bag)

TYPES = get_typestore(Stores.ROS2_JAZZY)
POINT = 'geometry_msgs/msg/PointStamped'
STORAGES = [StoragePlugin.MCAP, StoragePlugin.SQLITE3]


def new(kind, *values):
    return TYPES.types[kind](*values)


def header(nanoseconds, frame_id='tracker'):
    time = new('builtin_interfaces/msg/Time', *divmod(nanoseconds, 10**9))
    return new('std_msgs/msg/Header', time, frame_id)


def point(nanoseconds, x, y, z, frame_id='tracker'):
    return new(POINT, header(nanoseconds, frame_id), new('geometry_msgs/msg/Point', x, y, z))


def record(path, messages, storage=StoragePlugin.MCAP, compressed=None):
    """Write a bag with (topic, type, log time, message)."""
    writer = Writer(path, version=9, storage_plugin=storage)
    if compressed:
        writer.set_compression(compressed, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, kind, logged, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(connections[topic], logged, TYPES.serialize_cdr(message, kind))
    return path


def points_on(topic, count, start=10**9, step=12_500_000):
    return [(topic, POINT, start + i * step + 3_000_000,
             point(start + i * step, float(i), 0.5, -i / 7)) for i in range(count)]


def storage_file(path):
    return next(file for file in path.iterdir() if file.suffix in ('.mcap', '.db3'))


@pytest.mark.parametrize('storage', STORAGES)
def test_reads_20000_points_exactly(tmp_path, storage):
    path = record(tmp_path / 'run', points_on('/probe/tip', 20_000), storage)
    for source in (path, storage_file(path)):
        points = read_bag(source)
        assert len(points) == 20_000
        steps = np.arange(20_000)
        wanted = np.column_stack([steps, np.full(20_000, 0.5), -steps / 7])
        np.testing.assert_array_equal(points.positions, wanted)
        # the stamps of the headers, not the times of reception 3 ms later
        np.testing.assert_allclose(points.stamps, 1.0 + steps * 0.0125, rtol=0, atol=1e-9)
        assert set(points.frame_ids) == {'tracker'} and points.source_names == ['/probe/tip']
        assert points.notes == () and points.strokes is None and points.quality is None


@pytest.mark.parametrize('mode',
                         [CompressionMode.MESSAGE, CompressionMode.FILE, CompressionMode.STORAGE])
def test_reads_compressed_bags(tmp_path, mode):
    path = record(tmp_path / 'run', points_on('/probe/tip', 50), compressed=mode)
    assert len(read_bag(path)) == 50


@pytest.mark.parametrize('storage', STORAGES)
def test_reads_points_and_poses_of_a_tool(tmp_path, storage):
    pose = new('geometry_msgs/msg/Pose', new('geometry_msgs/msg/Point', 1.0, 2.0, 3.0),
               new('geometry_msgs/msg/Quaternion', 0.0, 0.6, 0.0, 0.8))
    motion = new('geometry_msgs/msg/Transform', new('geometry_msgs/msg/Vector3', 4.0, 5.0, 6.0),
                 new('geometry_msgs/msg/Quaternion', 0.0, 0.0, 0.0, 1.0))
    uncertain = new('geometry_msgs/msg/PoseWithCovariance', pose, np.zeros(36))
    path = record(tmp_path / 'run', [
        ('/pose', 'geometry_msgs/msg/PoseStamped', 2,
         new('geometry_msgs/msg/PoseStamped', header(20, 'a'), pose)),
        ('/motion', 'geometry_msgs/msg/TransformStamped', 1,
         new('geometry_msgs/msg/TransformStamped', header(30, 'b'), 'tool', motion)),
        ('/uncertain', 'geometry_msgs/msg/PoseWithCovarianceStamped', 5,
         new('geometry_msgs/msg/PoseWithCovarianceStamped', header(50, 'd'), uncertain)),
        ('/point', POINT, 3, point(10, 7.0, 8.0, 9.0, 'c')),
        ('/text', 'std_msgs/msg/String', 4, new('std_msgs/msg/String', 'hello'))], storage)
    points = read_bag(path, ['/point'])
    assert points.positions.tolist() == [[7, 8, 9]] and points.frame_ids == ['c']
    assert points.tools is None
    every = read_bag(path, ['/point', '/pose', '/motion', '/uncertain'])
    assert every.positions.tolist() == [[4, 5, 6], [1, 2, 3], [7, 8, 9], [1, 2, 3]]
    assert every.frame_ids == ['b', 'a', 'c', 'd']
    assert every.tools[[0, 1, 3]].tolist() == [[4, 5, 6, 0, 0, 0, 1], [1, 2, 3, 0, 0.6, 0, 0.8],
                                               [1, 2, 3, 0, 0.6, 0, 0.8]]
    assert np.isnan(every.tools[2]).all()
    assert [(topic.name, topic.messages) for topic in list_topics(path)] == [
        ('/motion', 1), ('/point', 1), ('/pose', 1), ('/text', 1), ('/uncertain', 1)]
    assert read_bag(path).source_names == ['/point']        # the only PointStamped topic
    assert '/text' in refused(path, ['/text'])


def test_the_only_tool_is_the_probe_if_there_are_no_points(tmp_path):
    path = record(tmp_path / 'run', [
        (topic, 'geometry_msgs/msg/PoseStamped', 1,
         new('geometry_msgs/msg/PoseStamped', header(20, 'a'), pose_of(x)))
        for topic, x in (('/probe/measured_cp', 1.0), ('/array/measured_cp', 2.0))])
    assert '2 topics that could be the probe; choose with --topic' in refused(path)
    points = read_bag(path, reference='/array/measured_cp')
    assert points.source_names == ['/probe/measured_cp'] and points.positions[0, 0] == 1.0


def pose_of(x, w=1.0):
    return new('geometry_msgs/msg/Pose', new('geometry_msgs/msg/Point', x, 0.0, 0.0),
               new('geometry_msgs/msg/Quaternion', 0.0, 0.0, 0.0, w))


def transforms(nanoseconds, *children):
    header_ = header(nanoseconds, 'world')
    motion = new('geometry_msgs/msg/Transform', new('geometry_msgs/msg/Vector3', 1.0, 2.0, 3.0),
                 new('geometry_msgs/msg/Quaternion', 0.0, 0.0, 0.0, 1.0))
    return new('tf2_msgs/msg/TFMessage', [
        new('geometry_msgs/msg/TransformStamped', header_, child, motion) for child in children])


@pytest.mark.parametrize('storage', STORAGES)
def test_transforms_keep_their_place_between_the_points(tmp_path, storage):
    pose, tf = 'geometry_msgs/msg/PoseStamped', 'tf2_msgs/msg/TFMessage'
    path = record(tmp_path / 'run', [
        ('/tf_static', tf, 1, transforms(0, 'a', 'b')),
        ('/array', pose, 2, new(pose, header(10**9), pose_of(1.0))),
        ('/tip', POINT, 3, point(2 * 10**9, 7.0, 8.0, 9.0)),
        ('/array', pose, 4, new(pose, header(3 * 10**9), pose_of(2.0, w=0.0))),
        ('/tf', tf, 5, transforms(4 * 10**9, 'c')),
        ('/tip', POINT, 6, point(5 * 10**9, 7.0, 8.0, 9.0))], storage)
    points = read_bag(path, reference='/array', frames=True)
    assert len(points) == 2 and points.source_names == ['/tip']
    assert [(each.after, each.stamp, each.parent, each.child, each.fixed)
            for each in points.transforms] == [
        (0, 0.0, 'world', 'a', True), (0, 0.0, 'world', 'b', True), (0, 1.0, 'tracker', '', False),
        (1, 3.0, 'tracker', '', False), (1, 4.0, 'world', 'c', False)]
    assert points.transforms[1].T_parent_child[:3, 3].tolist() == [1, 2, 3]
    assert points.transforms[2].T_parent_child[:3, 3].tolist() == [1, 0, 0]
    assert np.isnan(points.transforms[3].T_parent_child).all()     # the orientation is not valid
    assert [each.child for each in read_bag(path, reference='/array').transforms] == ['', '']
    assert not read_bag(path).transforms
    assert '/array' in refused(path, None, '/elsewhere') and 'reference.topic' in refused(
        path, None, '/tip')


def test_selects_the_topic_of_the_tip(tmp_path):
    tip, other, marks = (points_on(name, 2)
                         for name in ('/probe/tip', '/other', '/probe/landmarks'))
    assert read_bag(record(tmp_path / 'a', tip + other + marks)).source_names == ['/probe/tip']
    assert read_bag(record(tmp_path / 'b', other + marks)).source_names == ['/other']
    assert len(read_bag(tmp_path / 'b', ['/probe/landmarks', '/other', '/other'])) == 4
    message = refused(record(tmp_path / 'c', other + points_on('/another', 1)))
    assert '/other' in message and '/another' in message and POINT in message
    assert '/probe/landmarks' in refused(record(tmp_path / 'd', marks))
    assert '/tip' in refused(tmp_path / 'a', ['/tip']) and '/probe/tip' in refused(
        tmp_path / 'a', ['/tip'])
    assert refused(tmp_path / 'a', [])


def test_keeps_points_that_are_not_finite(tmp_path):
    path = record(tmp_path / 'run',
                  [('/probe/tip', POINT, 1, point(1, float('nan'), 0.0, float('inf')))])
    assert not np.isfinite(read_bag(path).positions).all()


def test_rejects_a_path_that_is_not_a_bag(tmp_path):
    assert 'does not exist' in refused(tmp_path / 'none')
    (tmp_path / 'empty').mkdir()
    assert 'is not a bag' in refused(tmp_path / 'empty')
    (tmp_path / 'points.csv').write_text('x,y,z\n')
    assert 'is not a bag' in refused(tmp_path / 'points.csv')
    for suffix in ('mcap', 'db3'):
        (tmp_path / f'zero.{suffix}').write_bytes(b'')
        (tmp_path / f'junk.{suffix}').write_bytes(b'no bag at all\n' * 20)
        assert str(tmp_path) in refused(tmp_path / f'zero.{suffix}')
        assert str(tmp_path) in refused(tmp_path / f'junk.{suffix}')
    with BagWriter(tmp_path / 'nothing'):
        pass
    assert 'topic' in refused(tmp_path / 'nothing')


@pytest.mark.parametrize('storage', STORAGES)
def test_reads_the_storage_files_beside_damaged_metadata(tmp_path, storage):
    path = record(tmp_path / 'run', points_on('/probe/tip', 20), storage)
    good = (path / 'metadata.yaml').read_text()
    for bad in ('', 'rosbag2_bagfile_information: 5\n', good[:100], good.replace('run', 'gone'),
                '\t{'):
        (path / 'metadata.yaml').write_text(bad)
        points = read_bag(path)
        assert len(points) == 20 and 'metadata.yaml' in points.notes[0]
    (path / 'metadata.yaml').unlink()
    points = read_bag(path)
    assert len(points) == 20 and 'no metadata.yaml' in points.notes[0] and points.complete


def test_reads_the_parts_of_a_split_bag_without_metadata_in_order(tmp_path):
    (tmp_path / 'run').mkdir()
    for part in range(11):
        piece = record(tmp_path / f'piece{part}', points_on('/probe/tip', 3, start=part * 10**9))
        shutil.copy(storage_file(piece), tmp_path / 'run' / f'run_{part}.mcap')
    stamps = read_bag(tmp_path / 'run').stamps
    assert len(stamps) == 33 and (np.diff(stamps) > 0).all()


@pytest.mark.parametrize('storage', STORAGES)
def test_damaged_bytes_raise_only_input_errors(tmp_path, storage):
    path = record(tmp_path / 'run', points_on('/probe/tip', 100), storage)
    file = storage_file(path)
    content = file.read_bytes()
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(150):
        damaged = bytearray(content)
        for place in rng.integers(0, len(content), 3):
            damaged[place] ^= int(rng.integers(1, 256))
        file.write_bytes(damaged)
        for source in (path, file):
            try:
                assert len(read_bag(source)) <= 100
            except InputError as error:
                assert '\n' not in error.message
                refused += 1
    assert refused


def test_reads_what_was_written(tmp_path):
    rng = np.random.default_rng(1)
    positions, stamps = rng.normal(size=(500, 3)), 1.75e9 + np.cumsum(rng.uniform(0.005, 0.02, 500))
    with BagWriter(tmp_path / 'run') as bag:
        for stamp, position in zip(stamps, positions):
            bag.write_point('/probe/tip', stamp, position, 'tracker')
        bag.write_point('/probe/landmarks', stamps[0], [1, 2, 3], 'tracker')
        bag.write_pose('/array', 1.5, exp([0.1, 0.2, 0.3, 4.0, 5.0, 6.0]), 'tracker')
    pose, = read_bag(tmp_path / 'run', reference='/array').transforms
    assert (pose.stamp, pose.parent, pose.child) == (1.5, 'tracker', '')
    np.testing.assert_allclose(pose.T_parent_child, exp([0.1, 0.2, 0.3, 4.0, 5.0, 6.0]), atol=1e-12)
    points = read_bag(tmp_path / 'run')
    np.testing.assert_array_equal(points.positions, positions)
    np.testing.assert_array_equal(points.stamps, stamps)
    assert read_bag(tmp_path / 'run', ['/probe/landmarks']).positions.tolist() == [[1, 2, 3]]


def test_order_of_reception_is_independent_of_the_stamps(tmp_path):
    with BagWriter(tmp_path / 'run') as bag:
        for received, stamp in enumerate([3.0, 1.0, 2.0]):
            bag.write_point('/probe/tip', stamp, [0, 0, 0], 'tracker', received=float(received))
    assert read_bag(tmp_path / 'run').stamps.tolist() == [3, 1, 2]


def test_equal_points_write_equal_bytes(tmp_path):
    contents = []
    for _ in range(2):
        with BagWriter(tmp_path / 'run') as bag:
            for i in range(100):
                bag.write_point('/probe/tip', 1.0 + i / 80, [i, 0, 0], 'tracker')
        contents.append({file.name: file.read_bytes() for file in (tmp_path / 'run').iterdir()})
        shutil.rmtree(tmp_path / 'run')
    assert contents[0] == contents[1] and set(contents[0]) == {'run.mcap', 'metadata.yaml'}


def test_writer_removes_the_bag_on_failure_and_overwrites_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), BagWriter(tmp_path / 'run') as bag:
        bag.write_point('/probe/tip', 1.0, [0, 0, 0], 'tracker')
        raise ZeroDivisionError
    assert not (tmp_path / 'run').exists()
    (tmp_path / 'run').mkdir()
    with pytest.raises(InputError, match='exists already'):
        BagWriter(tmp_path / 'run')
    (tmp_path / 'file').write_text('')
    with pytest.raises(InputError, match='cannot be written'), BagWriter(tmp_path / 'file' / 'run'):
        pass
