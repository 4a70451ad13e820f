# SPDX-License-Identifier: Apache-2.0
"""
Write rosbag2 recordings (mcap), without ROS.

Each chunk names its topics and carries a checksum, so what a recorder that was killed has written
can be read, and damage is found, see `mcap_file`.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from mcap.writer import CompressionType, Writer

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, quaternion_from_rotation
from msg_adapters import stamps
from msg_adapters.bag import TYPES
from msg_adapters.motion import POINT, POSE

if TYPE_CHECKING:
    from typing_extensions import Self

CHUNK = 1 << 20     # bytes
# Quality of service of a latched topic, as rosbag2 writes it since Jazzy: with it, a player offers
# late subscribers the last message
FOREVER = {'sec': 9223372036, 'nsec': 854775807}
LATCHED: list[dict[str, Any]] = [{
    'history': 'keep_last', 'depth': 1, 'reliability': 'reliable', 'durability': 'transient_local',
    'deadline': FOREVER, 'lifespan': FOREVER, 'liveliness': 'automatic',
    'liveliness_lease_duration': FOREVER, 'avoid_ros_namespace_conventions': False}]


class BagWriter:
    """
    A context manager that writes messages to a new rosbag2 (mcap).

    Equal calls write equal bytes. If the block raises an exception, the bag is removed.

    Parameters
    ----------
    path : path
    keep : bool
        Whether to complete the bag instead after an exception.
    compressed : bool
        Whether to compress the chunks; the bytes then depend on the version of zstd.

    Attributes
    ----------
    counts : dict of str to int
        Number of messages written to each topic.

    """

    def __init__(self, path: str | os.PathLike[str], keep: bool = False,
                 compressed: bool = True) -> None:
        """Prepare a bag at ``path``; raise `InputError` if the path exists."""
        self.path = Path(path)
        if self.path.exists():
            raise InputError(f'{path} exists already; remove it or choose another path')
        self.counts: dict[str, int] = {}
        self._keep = keep
        self._compression = CompressionType.ZSTD if compressed else CompressionType.NONE
        self._types: dict[str, str] = {}        # of each topic
        self._quality: dict[str, list[dict[str, Any]]] = {}     # of service, likewise
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._first, self._last = 0, 0          # times of reception, ns

    def __enter__(self) -> Self:
        """Create the directory."""
        try:
            self.path.mkdir(parents=True)
            self._file = (self.path / f'{self.path.name}.mcap').open('wb')
        except OSError as error:
            raise InputError(f'{self.path} cannot be written: {error.strerror}') from None
        self._writer = Writer(self._file, chunk_size=CHUNK, compression=self._compression)
        self._writer.start(profile='ros2', library='gsdf_registration')
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Write index and metadata, or remove the bag after an exception."""
        if kind is not None and not self._keep:
            self._file.close()
            shutil.rmtree(self.path)
            return
        self._writer.finish()
        self._file.close()
        (self.path / 'metadata.yaml').write_text(
            _yaml({'rosbag2_bagfile_information': self._metadata()}), encoding='utf-8')

    def flush(self) -> None:
        """Write all messages so far to the disk: they stay whatever happens to the program."""
        self._writer.flush()
        os.fsync(self._file.fileno())

    def add_topic(self, topic: str, msgtype: str, definition: str = '',
                  latched: bool = False) -> None:
        """
        Announce a topic.

        ``definition`` : of its type, if that is no standard message
        ``latched`` : whether late subscribers receive the last message
        """
        if not definition:
            definition = TYPES.generate_msgdef(msgtype, ros_version=2)[0]
        if msgtype not in self._schemas:
            self._schemas[msgtype] = self._writer.register_schema(
                msgtype, 'ros2msg', definition.encode())
        self._types[topic], self.counts[topic] = msgtype, 0
        self._quality[topic] = LATCHED if latched else []
        self._channels[topic] = self._writer.register_channel(
            topic, 'cdr', self._schemas[msgtype],
            {'offered_qos_profiles': _yaml(LATCHED) if latched else ''})

    def write(self, topic: str, received: int, data: bytes) -> None:
        """Append a serialized message (CDR) of an announced topic, ``received`` at this ns."""
        if not any(self.counts.values()):
            self._first = self._last = received
        self._first, self._last = min(self._first, received), max(self._last, received)
        self._writer.add_message(self._channels[topic], received, data, received,
                                 self.counts[topic])
        self.counts[topic] += 1

    def write_point(self,
                    topic: str,
                    stamp: float,
                    position: Sequence[float] | np.ndarray,
                    frame_id: str,
                    received: float | None = None) -> None:
        """
        Append a point.

        Parameters
        ----------
        topic : str
            Topic name.
        stamp : float
            Stamp of the header, s.
        position : (3,) float
            In ``frame_id``, m.
        frame_id : str
            Frame of the header.
        received : float, optional
            Time of reception, s, which defines the order of messages; the default is the stamp.

        """
        self._write(topic, POINT, _point(position), stamp, frame_id, received)

    def write_pose(self, topic: str, stamp: float, T: Array, frame_id: str,
                   received: float | None = None, digits: int = 15) -> None:
        """
        Append a pose ``T`` (4, 4), m, in ``frame_id``; see `write_point`.

        ``digits``: to which the quaternion is rounded.
        """
        quaternion = quaternion_from_rotation(T[:3, :3]).round(digits)
        rotation = TYPES.types['geometry_msgs/msg/Quaternion'](*quaternion.tolist())
        pose = TYPES.types['geometry_msgs/msg/Pose'](_point(T[:3, 3]), rotation)
        self._write(topic, POSE, pose, stamp, frame_id, received)

    def _write(self, topic: str, msgtype: str, body: Any, stamp: float, frame_id: str,
               received: float | None) -> None:
        """Append a message that consists of a header and ``body``."""
        if topic not in self._channels:
            self.add_topic(topic, msgtype)
        time = stamps.to_nanoseconds(stamp)
        message = TYPES.types[msgtype](_header(time, frame_id), body)
        logged = time if received is None else stamps.to_nanoseconds(received)
        self.write(topic, logged, bytes(TYPES.serialize_cdr(message, msgtype)))

    def _metadata(self) -> dict[str, Any]:
        """Return what rosbag2 writes to metadata.yaml, version 9."""
        file = f'{self.path.name}.mcap'
        start = {'nanoseconds_since_epoch': self._first}
        duration = {'nanoseconds': self._last - self._first}
        total = sum(self.counts.values())
        return {
            'version': 9, 'storage_identifier': 'mcap', 'duration': duration,
            'starting_time': start, 'message_count': total,
            'topics_with_message_count': [
                {'topic_metadata': {'name': topic, 'type': kind, 'serialization_format': 'cdr',
                                    'offered_qos_profiles': self._quality[topic],
                                    'type_description_hash': ''},
                 'message_count': self.counts[topic]} for topic, kind in self._types.items()],
            'compression_format': '', 'compression_mode': '', 'relative_file_paths': [file],
            'files': [{'path': file, 'starting_time': start, 'duration': duration,
                       'message_count': total}],
            'custom_data': None, 'ros_distro': 'gsdf_registration'}


class _Plain(yaml.SafeDumper):
    """Writes an object that occurs twice twice, as rosbag2 expects, and not as an alias."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _yaml(document: Any) -> str:
    return str(yaml.dump(document, Dumper=_Plain, sort_keys=False))


def _header(nanoseconds: int, frame_id: str) -> Any:
    types = TYPES.types
    time = types['builtin_interfaces/msg/Time'](*stamps.split(nanoseconds))
    return types['std_msgs/msg/Header'](time, frame_id)


def _point(position: Sequence[float] | np.ndarray) -> Any:
    return TYPES.types['geometry_msgs/msg/Point'](*(float(value) for value in position))
