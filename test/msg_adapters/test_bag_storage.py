# SPDX-License-Identifier: Apache-2.0
"""Every kind of storage file is read, and of a damaged one whatever is left."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from gsdf_registration.common.result import InputError
from msg_adapters.bag import list_topics, read_bag
from msg_adapters.bag_writer import BagWriter

TYPES = get_typestore(Stores.ROS2_JAZZY)
NOETIC = get_typestore(Stores.ROS1_NOETIC)
POINT = 'geometry_msgs/msg/PointStamped'
N = 5000        # messages, more than a block of a compressor


def point(i: int) -> bytes:
    """Return point number ``i``, stamped 1 + i / 100 s, as CDR."""
    t = TYPES.types
    stamp = t['builtin_interfaces/msg/Time'](*divmod(10**9 + i * 10**7, 10**9))
    rng = np.random.default_rng(i)      # so that compression does not make one block of it
    return bytes(TYPES.serialize_cdr(t[POINT](
        t['std_msgs/msg/Header'](stamp, 'tracker'),
        t['geometry_msgs/msg/Point'](float(i), *rng.normal(size=2))), POINT))


POINTS = [point(i) for i in range(N)]


def mcap(path: Path, begin: int = 0, end: int = N, compress=bytes, **options) -> Path:
    with path.open('wb') as file:
        writer = McapWriter(file, chunk_size=100_000, **options)
        writer.start('ros2')
        schema = writer.register_schema(
            POINT, 'ros2msg', TYPES.generate_msgdef(POINT, ros_version=2)[0].encode())
        channel = writer.register_channel('/probe/tip', 'cdr', schema)
        for i in range(begin, end):
            writer.add_message(channel, 2 * 10**9 + i, compress(POINTS[i]), 0)
        writer.finish()
    return path


def sqlite(path: Path, compress=bytes) -> Path:
    with sqlite3.connect(path) as file:
        file.execute('CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, '
                     'serialization_format TEXT, offered_qos_profiles TEXT)')
        file.execute('CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, '
                     'timestamp INTEGER, data BLOB)')
        file.execute('INSERT INTO topics VALUES (1, "/probe/tip", ?, "cdr", "")', [POINT])
        file.executemany('INSERT INTO messages VALUES (?, 1, ?, ?)',
                         [(i + 1, 10**9 + i, compress(data)) for i, data in enumerate(POINTS)])
    file.close()
    return path


def ros1(path: Path, compression=None) -> Path:
    writer = Ros1Writer(path)
    if compression:
        writer.set_compression(compression)
    t = NOETIC.types
    with writer:
        tip = writer.add_connection('/probe/tip', POINT, typestore=NOETIC)
        other = writer.add_connection('/text', 'std_msgs/msg/String', typestore=NOETIC)
        for i in range(N):
            stamp = t['builtin_interfaces/msg/Time'](*divmod(10**9 + i * 10**7, 10**9))
            writer.write(tip, 10**9 + i, NOETIC.serialize_ros1(t[POINT](
                t['std_msgs/msg/Header'](i, stamp, 'tracker'),
                t['geometry_msgs/msg/Point'](float(i), 0.5, 0.5)), POINT))
        writer.write(other, 3 * 10**9, NOETIC.serialize_ros1(
            t['std_msgs/msg/String']('hello'), 'std_msgs/msg/String'))
    return path


def assert_whole(path: Path) -> None:
    points = read_bag(path)
    assert points.complete and points.notes == () and set(points.frame_ids) == {'tracker'}
    assert points.positions[:, 0].tolist() == list(range(N))
    np.testing.assert_allclose(points.stamps, 1.0 + np.arange(N) / 100.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize('options', [
    {}, {'compression': CompressionType.NONE}, {'compression': CompressionType.LZ4},
    {'use_chunking': False}, {'index_types': IndexType.NONE, 'use_statistics': False},
    {'use_chunking': False, 'index_types': IndexType.NONE, 'repeat_channels': False,
     'repeat_schemas': False, 'use_statistics': False, 'use_summary_offsets': False},
    {'compress': zstandard.compress}, {'compress': lz4.frame.compress}],
    ids=['zstd', 'plain', 'lz4', 'unchunked', 'unindexed', 'bare', 'zstd message', 'lz4 message'])
def test_reads_every_kind_of_mcap(tmp_path: Path, options: dict) -> None:
    assert_whole(mcap(tmp_path / 'run.mcap', **options))


@pytest.mark.parametrize('compress', [bytes, zstandard.compress, lz4.frame.compress])
def test_reads_sqlite_files(tmp_path: Path, compress) -> None:
    assert_whole(sqlite(tmp_path / 'run.db3', compress))


@pytest.mark.parametrize(('suffix', 'compress'), [
    ('zstd', zstandard.compress), ('lz4', lz4.frame.compress)])
def test_reads_compressed_files(tmp_path: Path, suffix: str, compress) -> None:
    for plain in (mcap(tmp_path / 'a.mcap', compression=CompressionType.NONE),
                  sqlite(tmp_path / 'b.db3')):
        packed = plain.with_name(f'{plain.name}.{suffix}')
        packed.write_bytes(compress(plain.read_bytes()))
        plain.unlink()
        assert_whole(packed)
        packed.write_bytes(packed.read_bytes()[:-40_000])
        try:
            cut = read_bag(packed)
        except InputError as error:     # SQLite does not open such a file
            assert str(packed) in error.message and plain.suffix == '.db3'
        else:
            assert not cut.complete and str(packed) in cut.notes[0]
            assert 0 < len(cut) < N


@pytest.mark.parametrize('compression', [None, *Ros1Writer.CompressionFormat])
def test_reads_ros1_bags(tmp_path: Path, compression) -> None:
    path = ros1(tmp_path / 'run.bag', compression)
    assert_whole(path)
    assert [(topic.name, topic.messages) for topic in list_topics(path)] == [
        ('/probe/tip', N), ('/text', 1)]
    content = path.read_bytes()
    for share in (0.05, 0.5, 0.9):
        cut = tmp_path / 'cut.bag.active'
        cut.write_bytes(content[:int(share * len(content))])
        try:
            points = read_bag(cut)
        except InputError as error:     # one block of bzip2 has 900 kB
            assert compression is not None and 'no readable messages' in error.message
            continue
        assert not points.complete and 'at byte' in points.notes[0]
        assert points.positions[:, 0].tolist() == list(range(len(points)))
        if compression is None:
            assert len(points) > 0.9 * share * N


def test_reads_split_bags_with_metadata_and_says_which_part_is_missing(tmp_path: Path) -> None:
    parts = [f'run_{i}.mcap' for i in range(11)]
    edges = np.linspace(0, N, 12).astype(int)
    for name, begin, end in zip(parts, edges[:-1], edges[1:]):
        mcap(tmp_path / name, begin, end)
    names = ''.join(f'  - {name}\n' for name in parts)
    (tmp_path / 'metadata.yaml').write_text(        # as after a reindex
        'rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: ""\n'
        f'  relative_file_paths:\n{names}')
    assert_whole(tmp_path)
    (tmp_path / parts[4]).unlink()
    points = read_bag(tmp_path)
    assert not points.complete and len(points) == N - (edges[5] - edges[4])
    assert 'run_4.mcap' in points.notes[0] and 'missing' in points.notes[0]
    (tmp_path / parts[5]).write_bytes(b'no bag')
    assert any('run_5.mcap' in note for note in read_bag(tmp_path).notes)


@pytest.mark.parametrize('compression', list(CompressionType))
@pytest.mark.parametrize('share', [0.3, 0.77, 0.9999])
def test_a_cut_file_yields_its_whole_messages(tmp_path: Path, compression: CompressionType,
                                              share: float) -> None:
    path = mcap(tmp_path / 'run.mcap', compression=compression)
    content = path.read_bytes()
    path.write_bytes(content[:int(share * len(content))])
    points = read_bag(path)
    assert points.positions[:, 0].tolist() == list(range(len(points)))
    assert not points.complete and 'was killed' in points.notes[0]
    assert f'byte {int(share * len(content))}' in points.notes[0]
    if compression is CompressionType.NONE and share < 0.9:
        # the last chunk is cut, and all but its last message is there
        assert len(points) == pytest.approx(share * N, rel=0.1)
        assert len(points) % 1000 != 0


def test_the_messages_of_a_cut_chunk_are_read(tmp_path: Path) -> None:
    path = mcap(tmp_path / 'run.mcap', end=500, compression=CompressionType.NONE)
    content = path.read_bytes()
    path.write_bytes(content[:content.index(POINTS[123]) + len(POINTS[123])])
    assert len(read_bag(path)) == 124
    path.write_bytes(content[:content.index(POINTS[123]) + len(POINTS[123]) - 1])
    assert len(read_bag(path)) == 123


def test_a_damaged_chunk_is_left_out_and_its_place_is_reported(tmp_path: Path) -> None:
    path = mcap(tmp_path / 'run.mcap', compression=CompressionType.NONE)
    content = bytearray(path.read_bytes())
    place = content.index(POINTS[2500])
    content[place + 30] ^= 1        # in a coordinate
    path.write_bytes(content)
    points = read_bag(path)
    assert not points.complete and 0 < len(points) < N
    assert 2500.0 not in points.positions[:, 0] and 10.0 in points.positions[:, 0]
    note, _ = points.notes      # and the gap that it leaves
    assert 'checksum does not match' in note and 'chunk at byte' in note and 'covers' in note


def test_what_the_writer_writes_carries_checksums_and_survives_a_kill(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as bag:
        for i in range(300):
            bag.write_point('/probe/tip', 1.0 + i / 100.0, [i, 0.0, 0.0], 'tracker')
        bag.flush()
        killed = (tmp_path / 'run' / 'run.mcap').read_bytes()
        bag.write_point('/probe/tip', 9.0, [0.0, 0.0, 0.0], 'tracker')
    (tmp_path / 'killed.mcap').write_bytes(killed)
    points = read_bag(tmp_path / 'killed.mcap')
    assert len(points) == 300 and not points.complete
    whole = (tmp_path / 'run' / 'run.mcap').read_bytes()
    (tmp_path / 'bad.mcap').write_bytes(whole[:1000] + bytes([whole[1000] ^ 255]) + whole[1001:])
    assert 'damaged' in read_bag(tmp_path / 'bad.mcap').notes[0]


def test_a_damaged_sqlite_file_yields_what_comes_before_the_damage(tmp_path: Path) -> None:
    path = sqlite(tmp_path / 'run.db3')
    content = bytearray(path.read_bytes())
    middle = len(content) // 2 // 4096 * 4096
    content[middle:middle + 4096] = bytes(4096)
    path.write_bytes(content)
    points = read_bag(path)
    assert not points.complete and 0 < len(points) < N
    assert points.positions[:, 0].tolist() == list(range(len(points)))
    assert 'after the message in row' in points.notes[0]


def test_the_array_that_is_not_used_is_named(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as bag:
        bag.write_point('/probe/tip', 1.0, [1.0, 0.0, 0.0], 'tracker')
        for topic in ('/reference/pose', '/registration/bone_pose'):
            bag.write_pose(topic, 1.0, np.eye(4), 'tracker')
    note, = read_bag(tmp_path / 'run').notes
    assert note == ('the recording holds /reference/pose (PoseStamped): give --reference '
                    '/reference/pose if the bone moved')
    assert not read_bag(tmp_path / 'run', reference='/reference/pose').notes


def test_stamps_that_are_zero_or_out_of_order_and_gaps_are_noted(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'run') as bag:
        for received, stamp in enumerate([0.0, 10.0, 9.99, 10.1, 30.0]):
            bag.write_point('/probe/tip', stamp, [1.0, 0.0, 0.0], 't', received=received)
    notes = '; '.join(read_bag(tmp_path / 'run').notes)
    assert '1 of 5 samples on /probe/tip have the stamp 0' in notes
    assert '1 sample on /probe/tip out of order' in notes
    with BagWriter(tmp_path / 'gap') as bag:
        for stamp in (1.0, 1.1, 21.1):
            bag.write_point('/probe/tip', stamp, [1.0, 0.0, 0.0], 't')
    assert 'the longest 20.0 s' in read_bag(tmp_path / 'gap').notes[0]
