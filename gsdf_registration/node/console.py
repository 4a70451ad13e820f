# SPDX-License-Identifier: Apache-2.0
"""
The process of the operator's console: a web page for a running registration node.

It uses only the ROS interface of the node, so it may run on another machine, restart, or be opened
twice.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from gsdf_registration.common.command_line import positive_number
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.visualization.console_panel import Limits, Tracker
from msg_adapters.marker_cdr import from_bytes
from msg_adapters.ros import pose_from

if TYPE_CHECKING:
    from diagnostic_msgs.msg import DiagnosticStatus
    from geometry_msgs.msg import PointStamped, PoseStamped

LOOPBACK = ('127.0.0.1', 'localhost', '::1')
PATIENCE = 60.0     # s, for the answer of a service: a search may take that long
DISCOVERY = 2.0     # s, for a service to appear
PERIOD = 0.5        # s, between two looks at the connection and the tracker
# settings of the node that are shown beside values
SETTINGS = ('limits.max_sigma', 'limits.verification', 'landmarks.names')
PEDALS = {'stroke': 'collect', 'undo': 'undo', 'register': 'register'}      # parameter -> action


def main(args: list[str] | None = None) -> int:
    """Run the console until SIGINT or SIGTERM; return 2 if it cannot start."""
    from rclpy.utilities import remove_ros_args
    options = _parse(remove_ros_args(sys.argv if args is None else ['', *args])[1:])
    try:
        return _run(options, args)
    except InputError as error:
        print(f'registration_console: {error.message}', file=sys.stderr)
        return 2


def _parse(args: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='registration_console',
        description='Serve a page for the operator of a running registration node.')
    parser.add_argument('--node', default='/registration', metavar='NAME',
                        help='name of the node (default: /registration)')
    parser.add_argument('--host', default='127.0.0.1', metavar='ADDRESS',
                        help='address to serve the page on; any but 127.0.0.1 needs --token '
                        '(default: 127.0.0.1)')
    parser.add_argument('--port', type=positive_number, default=8080, metavar='N',
                        help='port of the page (default: 8080)')
    parser.add_argument('--token', default='', metavar='SECRET',
                        help='the page is shown only to those who open it with ?token=SECRET')
    parser.add_argument('--view-only', action='store_true', help='show no buttons')
    parser.add_argument('--model-axes', choices=('lps', 'ras'), default='lps',
                        help='axes of the bone model, for the views A P L R S I (default: lps)')
    return parser.parse_args(args)


def _run(options: argparse.Namespace, args: list[str] | None) -> int:
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    rclpy.init(args=args)
    console = None
    try:
        console = Console(options)
        executor = SingleThreadedExecutor()
        executor.add_node(console.node)
        signal.signal(signal.SIGTERM, lambda *_: rclpy.try_shutdown())
        print(f'registration_console: open {console.url}', flush=True)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if console is not None:
            console.stop()
        rclpy.try_shutdown()
    return 0


class Console:
    """
    Connects the page to the topics and services of the node.

    Raises
    ------
    InputError
        If the page cannot be served.

    """

    def __init__(self, options: argparse.Namespace) -> None:
        from rclpy.node import Node

        self._target = options.node.rstrip('/')
        self.node = Node('registration_console')
        self._clients: dict[str, Any] = {}
        self._status: Any = None
        self._T_bone_points: Array | None = None
        self._arrivals = Arrivals()
        self._asked_settings = False
        self._serve(options)
        self._subscribe(options.view_only)
        self.node.create_timer(PERIOD, self._look)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f'http://{self._host}:{self._port}'

    def stop(self) -> None:
        """Stop the page and destroy the ROS node."""
        if self._gate is not None:
            self._gate.stop()
        self._page.stop()
        self.node.destroy_node()

    def _serve(self, options: argparse.Namespace) -> None:
        """Serve the page; with a token, behind a gate."""
        from gsdf_registration.visualization.console_page import ConsolePage
        from gsdf_registration.visualization.web_access import Gate, free_port

        if options.host not in LOOPBACK and not options.token:
            raise InputError(f'--host {options.host} shows the page to other machines: give a '
                             '--token too')
        gated = bool(options.token)
        self._page = ConsolePage(
            self._run, self._drop_stroke, host='127.0.0.1' if gated else options.host,
            port=free_port() if gated else options.port, view_only=options.view_only,
            ras=options.model_axes == 'ras')
        self._host, self._port, self._gate = options.host, self._page.port, None
        if gated:
            self._gate = Gate(options.host, options.port, options.token, self._page.port)
            self._port = self._gate.port

    def _subscribe(self, view_only: bool) -> None:
        from diagnostic_msgs.msg import DiagnosticStatus
        from geometry_msgs.msg import PointStamped, PoseStamped
        from rclpy.qos import qos_profile_sensor_data
        from std_msgs.msg import Empty
        from visualization_msgs.msg import MarkerArray

        from gsdf_registration.node.qos import LATCHED

        subscribe = self.node.create_subscription
        self._statuses = subscribe(DiagnosticStatus, f'{self._target}/status', self._on_status,
                                   LATCHED)
        subscribe(MarkerArray, f'{self._target}/markers', self._on_markers, LATCHED, raw=True)
        subscribe(PoseStamped, f'{self._target}/bone_pose', self._on_pose, LATCHED)
        subscribe(PointStamped, f'{self._target}/tip', self._on_tip, qos_profile_sensor_data)
        for pedal, action in () if view_only else PEDALS.items():
            topic = self.node.declare_parameter(f'pedal.{pedal}', '').value
            if topic:
                subscribe(Empty, topic, partial(self._on_pedal, action), 10)

    # ---- what the node publishes

    def _on_status(self, status: DiagnosticStatus) -> None:
        self._status = status
        values = {each.key: each.value for each in status.values}
        if values.get('pose') == 'none':
            self._T_bone_points = None
        self._page.show_status(values, status.message)
        self._page.show_progress(*progress_of(status.message, values))

    def _on_markers(self, message: bytes) -> None:
        self._page.show_markers(from_bytes(message))

    def _on_pose(self, message: PoseStamped) -> None:
        try:
            self._T_bone_points = inverse(pose_from(message)[1])
        except InputError:      # the pose is withdrawn
            self._T_bone_points = None

    def _on_tip(self, message: PointStamped) -> None:
        self._arrivals.add(time.monotonic())
        tip = message.point
        self._page.show_tip(None if self._T_bone_points is None else transform(
            self._T_bone_points, np.array([[tip.x, tip.y, tip.z]]))[0])

    def _look(self) -> None:
        """Check the connection, the tracker and the settings of the node."""
        connected = self.node.count_publishers(f'{self._target}/status') > 0
        if not connected and self._status is not None:
            self._status, self._asked_settings = None, False
            self._page.show_status(None)
        if connected and not self._asked_settings:
            self._ask_settings()
        self._page.show_tracker(self._arrivals.summary(time.monotonic()))

    def _ask_settings(self) -> None:
        from rcl_interfaces.srv import GetParameters
        client = self._client(GetParameters, 'get_parameters')
        if client.service_is_ready():
            self._asked_settings = True
            client.call_async(GetParameters.Request(names=list(SETTINGS))).add_done_callback(
                self._on_settings)

    def _on_settings(self, future: Any) -> None:
        sigma, verification, names = future.result().values
        self._page.show_settings(Limits(sigma.double_value, verification.double_value),
                                 names.string_array_value)

    # ---- what the page asks for; called by threads of the page

    def _run(self, action: str) -> tuple[bool, str]:
        from std_srvs.srv import SetBool, Trigger
        if action == 'collect':
            collecting = self._status is not None and any(
                each.key == 'state' and each.value == 'collecting' for each in self._status.values)
            return self._call(SetBool, action, SetBool.Request(data=not collecting))
        return self._call(Trigger, action, Trigger.Request())

    def _drop_stroke(self, number: int) -> tuple[bool, str]:
        from msg_adapters import results
        if not results.available():
            return False, ('gsdf_registration_msgs is not installed: only the last stroke can be '
                           'dropped, with Undo stroke')
        kind = results.service_types().DropStroke
        return self._call(kind, 'drop_stroke', kind.Request(stroke=number))

    def _on_pedal(self, action: str, _: Any) -> None:
        # the answer arrives through the executor, which must not wait for it
        threading.Thread(target=lambda: self._page.show_answer(*self._run(action)),
                         daemon=True).start()

    def _client(self, kind: Any, service: str) -> Any:
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, f'{self._target}/{service}')
        return self._clients[service]

    def _call(self, kind: Any, service: str, request: Any) -> tuple[bool, str]:
        """Call a service of the node and wait for its answer."""
        client = self._client(kind, service)
        if not client.wait_for_service(DISCOVERY):
            return False, f'the service {self._target}/{service} is not available'
        answered = threading.Event()
        future = client.call_async(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(PATIENCE):
            return False, f'{self._target}/{service} did not answer within {PATIENCE:.0f} s'
        response = future.result()
        return response.success, response.message


class Arrivals:
    """When samples of the probe arrived, s."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=200)

    def add(self, now: float) -> None:
        """Record that a sample arrived."""
        self._times.append(now)

    def summary(self, now: float) -> Tracker:
        """Return the rate within the last second and the time since the last sample."""
        if not self._times:
            return Tracker()
        lately = sum(now - each <= 1.0 for each in tuple(self._times))
        return Tracker(float(lately), now - self._times[-1])


def progress_of(message: str, values: Mapping[str, str]) -> tuple[float | None, str]:
    """Return how far a search or a compilation is, 0 to 1, and the sentence on it."""
    if 'progress' not in values:
        return None, ''
    return float(values['progress']), message


if __name__ == '__main__':
    sys.exit(main())
