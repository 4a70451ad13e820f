# SPDX-License-Identifier: Apache-2.0
"""
Tool transforms over OpenIGTLink, as a PLUS server sends them and Slicer receives them.

A TRANSFORM message is named after its frames, such as StylusToTracker, and has lengths in
millimetres. PLUS states in TransformStatus whether the tool was tracked. Needs pyigtl.
"""

from __future__ import annotations

import contextlib
import queue
import re
import socket
import time
from collections import Counter
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, is_rigid, orthonormalized
from msg_adapters.extras import needed
from msg_adapters.files import METRES

if TYPE_CHECKING:
    from typing_extensions import Self

PORT = 18944            # of a PLUS server
TRACKER = 'tracker'     # frame of a transform that names none
RIGID = 1e-3            # tolerance of the rotation; messages have single precision
NAME_LENGTH = 20        # bytes of a device name in the header of a message


class ToolReading(NamedTuple):
    """
    One pose of a tool.

    device : name of the transform
    stamp : s since 1970, clock of the server
    T_tracker_tool : (4, 4) float64, m
    """

    device: str
    stamp: float
    T_tracker_tool: Array


class ToolStream:
    """
    A context manager that receives the tool transforms of a server.

    It connects again when the server was restarted. Transforms that are not usable are counted in
    `dropped` by device and cause.
    """

    def __init__(self, host: str, port: int = PORT) -> None:
        """Raise `InputError` if pyigtl is not installed."""
        self._pyigtl = needed('pyigtl', 'igtl', 'OpenIGTLink connections')
        self._address = host, port
        self._messages: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._client: Any = None
        self.dropped: Counter[tuple[str, str]] = Counter()

    def __enter__(self) -> Self:
        """Connect, now or as soon as there is a server."""
        self._connect()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Disconnect."""
        self._client.stop()

    @property
    def connected(self) -> bool:
        """Whether there is a connection."""
        return bool(self._client.is_connected())

    def receive(self, timeout: float) -> list[ToolReading]:
        """Return the readings that arrived; wait for the first for at most ``timeout`` seconds."""
        messages = []
        with contextlib.suppress(queue.Empty):
            messages.append(self._messages.get(timeout=timeout))
            while True:
                messages.append(self._messages.get_nowait())
        if not messages and self._closed_by_server():
            self._client.stop()
            self._connect()
        return [reading for reading in map(self._reading, messages) if reading is not None]

    def _connect(self) -> None:
        self._client = self._pyigtl.OpenIGTLinkClient(*self._address, start_now=False)
        # pyigtl keeps only the last message of each device
        self._client.incoming_messages = _Inbox(self._messages)
        self._client.start()

    def _closed_by_server(self) -> bool:
        """Return whether the server is gone, which pyigtl does not notice."""
        try:
            return self._client.socket.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT) == b''
        except (AttributeError, OSError):       # not connected, or nothing to receive
            return False

    def _reading(self, message: Any) -> ToolReading | None:
        """Return the reading of a transform, None for other messages and unusable ones."""
        if not isinstance(message, self._pyigtl.TransformMessage):
            return None
        status = message.metadata.get('TransformStatus', 'OK').strip().upper()
        valid = message.metadata.get('TransformValid', 'true').strip().lower()
        T = np.array(message.matrix, dtype=np.float64)
        if status not in ('', 'OK') or valid in ('false', '0'):
            self.dropped[message.device_name, 'tracking_state'] += 1
        elif not is_rigid(T, RIGID):
            self.dropped[message.device_name, 'not_rigid'] += 1
        else:
            T = orthonormalized(T)
            T[:3, 3] *= METRES['mm']
            return ToolReading(message.device_name, message.timestamp or time.time(), T)
        return None


class _Inbox(dict[str, Any]):
    """Where pyigtl puts its messages: passes each of them on, and keeps none."""

    def __init__(self, messages: queue.SimpleQueue[Any]) -> None:
        super().__init__()
        self._messages = messages

    def __setitem__(self, device: str, message: Any) -> None:
        self._messages.put(message)


class PoseServer:
    """
    A context manager that sends poses to a client, such as Slicer, that connects to it.

    It accepts clients of this machine, or those of a network interface.
    """

    def __init__(self, port: int, interface: str | None = None) -> None:
        """Raise `InputError` if pyigtl is not installed, or the port is in use."""
        pyigtl = needed('pyigtl', 'igtl', 'OpenIGTLink connections')
        self._message = pyigtl.TransformMessage
        try:
            self._server = pyigtl.OpenIGTLinkServer(port=port, local_server=interface is None,
                                                    iface=interface)
        except OSError as error:
            raise InputError(f'port {port} cannot be used: {error.strerror}') from None

    def __enter__(self) -> Self:
        """Do nothing: the server runs already."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Close the connection."""
        self._server.stop()

    def send(self, device: str, stamp: float, T: Array) -> None:
        """Send a pose (4, 4), m; without a client it is forgotten."""
        if not self._server.is_connected():
            return
        matrix = np.array(T)
        matrix[:3, 3] /= METRES['mm']
        self._server.send_message(self._message(matrix, timestamp=stamp, device_name=device),
                                  wait=False)


def frames_of(device: str) -> tuple[str, str]:
    """Return the names of tool and tracker in the name of a transform, as ROS names."""
    found = re.fullmatch(r'(.+?)To([A-Z].*)', device)
    tool, tracker = found.groups() if found else (device, TRACKER)
    return ros_name(tool), ros_name(tracker)


def ros_name(text: str) -> str:
    """Return a text as a ROS name: lower-case words with underscores."""
    words = re.sub(r'(?<=[a-z0-9])(?=[A-Z])', '_', text)
    name = re.sub(r'[^a-z0-9]+', '_', words.lower()).strip('_') or 'tool'
    return f'tool_{name}' if name[0].isdigit() else name
