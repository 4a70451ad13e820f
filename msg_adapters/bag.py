# SPDX-License-Identifier: Apache-2.0
"""Read and write rosbag2 recordings of the probe's tip, without ROS."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from gsdf_registration.result import InputError
from msg_adapters import stamps
from msg_adapters.bag_storage import BagFiles, Raw, Topic
from msg_adapters.recording import Recording

if TYPE_CHECKING:
    from typing_extensions import Self

POINT = 'geometry_msgs/msg/PointStamped'
TIP_TOPIC = '/probe/tip'
# the tip resting on landmarks: no points of the surface scan
LANDMARK_TOPIC = '/probe/landmarks'
TYPES = get_typestore(Stores.ROS2_JAZZY)

# where each message type that can be read keeps the position
POSITION: dict[str, Callable[[Any], Any]] = {
    POINT: lambda message: message.point,
    'geometry_msgs/msg/PoseStamped': lambda message: message.pose.position,
    'geometry_msgs/msg/TransformStamped': lambda message: message.transform.translation,
}


def list_topics(path: str | os.PathLike[str]) -> list[Topic]:
    """
    Return the topics of a bag: name, message type, number of messages.

    Raises
    ------
    InputError
        If the bag is missing or cannot be read.

    """
    return BagFiles(path).topics()


def read_bag(path: str | os.PathLike[str], topics: Sequence[str] | None = None) -> Recording:
    """
    Read the positions in a rosbag2 recording (mcap or sqlite3 storage) in the order received.

    Parameters
    ----------
    path : path
        The bag's directory, or one of its storage files.
    topics : sequence of str, optional
        PointStamped, PoseStamped or TransformStamped topics; by default /probe/tip, or else the
        only PointStamped topic besides /probe/landmarks.

    Returns
    -------
    Recording
        m and s; stamps are those of the message headers, not the times of reception.

    Raises
    ------
    InputError
        If the bag is missing, damaged or empty, or the topics are not there, not clear, or of
        another type.

    """
    bag = BagFiles(path)
    types = {topic.name: topic.msgtype for topic in bag.topics()}
    names = _chosen(bag.path, types, topics)
    messages = bag.messages(names)
    if not messages:
        raise InputError(f'{path} has no messages on {", ".join(names)}')
    times, frames, positions = _decoded(bag.path, messages)
    return Recording(
        positions=positions, stamps=times, frame_ids=frames, source_names=names,
        sources=np.array([names.index(raw.topic) for raw in messages], np.int32),
        notes=tuple(bag.notes))


def _chosen(path: Path, types: dict[str, str], wanted: Sequence[str] | None) -> list[str]:
    """Return the topics to be read, or raise `InputError` with what there is."""
    there = ', '.join(f'{name} ({msgtype})' for name, msgtype in types.items()) or 'no topics'
    if wanted is None:
        points = [
            name for name, msgtype in types.items() if msgtype == POINT and name != LANDMARK_TOPIC
        ]
        names = [TIP_TOPIC] if TIP_TOPIC in points else points
        if len(names) != 1:
            raise InputError(
                f'{path} has {len(names) or "no"} PointStamped topics that could be the tip: '
                f'choose one; it has {there}')
        return names
    names = list(dict.fromkeys(wanted))
    bad = [name for name in names if types.get(name) not in POSITION]
    if bad or not names:
        raise InputError(
            f'{path} has no topic {", ".join(bad)} of type PointStamped, PoseStamped or '
            f'TransformStamped: it has {there}')
    return names


def _decoded(path: Path, messages: list[Raw]) -> tuple[np.ndarray, list[str], np.ndarray]:
    """Return stamps (n,) s, frame ids and positions (n, 3) m of serialized messages."""
    times = np.zeros(len(messages))
    positions = np.zeros((len(messages), 3))
    frames = []
    for i, raw in enumerate(messages):
        try:
            message: Any = TYPES.deserialize_cdr(raw.data, raw.msgtype)
        except Exception:  # damaged bytes lead the decoder to any exception
            raise InputError(
                f'{path} is damaged: message {i + 1} on {raw.topic} cannot be decoded') from None
        position = POSITION[raw.msgtype](message)
        times[i] = stamps.to_seconds(message.header.stamp.sec, message.header.stamp.nanosec)
        positions[i] = position.x, position.y, position.z
        frames.append(message.header.frame_id)
    return times, frames, positions


class BagWriter:
    """
    Write positions as PointStamped into a new rosbag2 directory (mcap).

    A context manager; the same calls give the same bytes, and if the block is left by an exception
    no bag is left behind.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Prepare a bag at ``path``; `InputError` if something is there already."""
        self.path = Path(path)
        if self.path.exists():
            raise InputError(f'{path} exists already: remove it or write to another place')
        self._writer = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._connections: dict[str, Connection] = {}

    def __enter__(self) -> Self:
        """Create the directory."""
        try:
            self._writer.open()
        except OSError as error:
            raise InputError(f'{self.path} cannot be written: {error.strerror}') from None
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Write index and metadata, or remove what was begun."""
        if kind is None:
            self._writer.close()
        else:
            self._writer.abort()
            shutil.rmtree(self.path)

    def write_point(self,
                    topic: str,
                    stamp: float,
                    position: Sequence[float] | np.ndarray,
                    frame_id: str,
                    received: float | None = None) -> None:
        """
        Append one point.

        Parameters
        ----------
        topic : str
            Name of the topic.
        stamp : float
            Of the header, s.
        position : (3,) float
            In ``frame_id``, m.
        frame_id : str
            Of the header.
        received : float, optional
            Time of reception, s, which orders the messages of a bag; by default the stamp.

        """
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, POINT, typestore=TYPES)
        time = stamps.to_nanoseconds(stamp)
        message = _point_message(time, position, frame_id)
        logged = time if received is None else stamps.to_nanoseconds(received)
        self._writer.write(self._connections[topic], logged, TYPES.serialize_cdr(message, POINT))


def _point_message(nanoseconds: int, position: Sequence[float] | np.ndarray, frame_id: str) -> Any:
    """Return a PointStamped as rosbags knows it."""
    types = TYPES.types
    sec, nanosec = stamps.split(nanoseconds)
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](sec, nanosec),
                                          frame_id)
    return types[POINT](header,
                        types['geometry_msgs/msg/Point'](*(float(value) for value in position)))
