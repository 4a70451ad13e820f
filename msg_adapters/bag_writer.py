# SPDX-License-Identifier: Apache-2.0
"""Write rosbag2 recordings of the probe tip and of the reference array, without ROS."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, quaternion_from_rotation
from msg_adapters import stamps
from msg_adapters.bag import POINT, POSE, TYPES

if TYPE_CHECKING:
    from typing_extensions import Self


class BagWriter:
    """
    A context manager that writes PointStamped and PoseStamped messages to a new rosbag2 (mcap).

    Equal calls write equal bytes. If the block raises an exception, the bag is removed.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Prepare a bag at ``path``; raise `InputError` if the path exists."""
        self.path = Path(path)
        if self.path.exists():
            raise InputError(f'{path} exists already; remove it or choose another path')
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
        """Write index and metadata, or remove the bag after an exception."""
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
                   received: float | None = None) -> None:
        """Append a pose ``T`` (4, 4), m, in ``frame_id``; see `write_point`."""
        rotation = TYPES.types['geometry_msgs/msg/Quaternion'](*quaternion_from_rotation(T[:3, :3]))
        pose = TYPES.types['geometry_msgs/msg/Pose'](_point(T[:3, 3]), rotation)
        self._write(topic, POSE, pose, stamp, frame_id, received)

    def _write(self, topic: str, msgtype: str, body: Any, stamp: float, frame_id: str,
               received: float | None) -> None:
        """Append a message that consists of a header and ``body``."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, msgtype, typestore=TYPES)
        time = stamps.to_nanoseconds(stamp)
        message = TYPES.types[msgtype](_header(time, frame_id), body)
        logged = time if received is None else stamps.to_nanoseconds(received)
        self._writer.write(self._connections[topic], logged, TYPES.serialize_cdr(message, msgtype))


def _header(nanoseconds: int, frame_id: str) -> Any:
    types = TYPES.types
    time = types['builtin_interfaces/msg/Time'](*stamps.split(nanoseconds))
    return types['std_msgs/msg/Header'](time, frame_id)


def _point(position: Sequence[float] | np.ndarray) -> Any:
    return TYPES.types['geometry_msgs/msg/Point'](*(float(value) for value in position))
