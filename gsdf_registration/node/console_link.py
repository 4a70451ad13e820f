# SPDX-License-Identifier: Apache-2.0
"""The connection of the console with a registration node: its topics, services and settings."""

from __future__ import annotations

import threading
import time
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped, PoseWithCovarianceStamped
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Empty
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from gsdf_registration.clients.service_client import ServiceClient
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.node.qos import LATCHED
from gsdf_registration.visualization.console_panel import Limits, Tracker
from gsdf_registration.visualization.console_scene import LandmarkPlaces
from msg_adapters import results
from msg_adapters.marker_cdr import from_bytes
from msg_adapters.ros import pose_from

if TYPE_CHECKING:
    from gsdf_registration.visualization.console_page import ConsolePage

PATIENCE = 60.0     # s, for the answer of a service: a search may take that long
DISCOVERY = 5.0     # s, for a service to appear and to discover the console
POLL = 0.02         # s, between two looks whether it has
PERIOD = 0.5        # s, between two looks at the connection and the tracker
# settings of the node that are shown beside values
SETTINGS = ('limits.max_sigma', 'limits.max_error', 'limits.verification', 'landmarks.names',
            'landmarks.positions')
PEDALS = {'stroke': 'collect', 'undo': 'undo', 'register': 'register'}      # parameter -> action


class ConsoleLink:
    """
    Shows on the page what the node publishes, and calls its services.

    Attributes
    ----------
    node : rclpy.node.Node
        To be spun by one executor.

    """

    def __init__(self, target: str) -> None:
        self._target = target.rstrip('/')
        self.node = Node('registration_console')
        self._clients: dict[str, ServiceClient] = {}
        self._values: dict[str, str] | None = None
        # pose of the points in the bone frame: as registered, and as estimated until then
        self._registered: Array | None = None
        self._estimated: Array | None = None
        self._arrivals = Arrivals()
        self._asked_settings = False

    def connect(self, page: ConsolePage, pedals: bool) -> None:
        """Show the node on ``page`` from now on; ``pedals``: whether they press buttons."""
        self._page = page
        self._drawing = Drawing(page)
        subscribe = self.node.create_subscription
        subscribe(DiagnosticStatus, f'{self._target}/status', self._on_status, LATCHED)
        subscribe(MarkerArray, f'{self._target}/markers', self._drawing.show, LATCHED, raw=True)
        subscribe(PoseStamped, f'{self._target}/bone_pose', self._on_pose, LATCHED)
        subscribe(PoseWithCovarianceStamped, f'{self._target}/live_pose', self._on_live_pose,
                  qos_profile_sensor_data)
        subscribe(PointStamped, f'{self._target}/tip', self._on_tip, qos_profile_sensor_data)
        for pedal, action in PEDALS.items() if pedals else ():
            topic = self.node.declare_parameter(f'pedal.{pedal}', '').value
            if topic:
                subscribe(Empty, topic, partial(self._on_pedal, action), 10)
        self.node.create_timer(PERIOD, self._look)

    def stop(self) -> None:
        """Destroy the ROS node."""
        self.node.destroy_node()

    # ---- what the node publishes

    def _on_status(self, status: DiagnosticStatus) -> None:
        self._values = {each.key: each.value for each in status.values}
        if self._values.get('pose') == 'none':
            self._registered = None
        if self._values.get('kept') == '0':
            self._estimated = None
        self._page.show_status(self._values, status.message)

    def _on_pose(self, message: PoseStamped) -> None:
        try:
            self._registered = inverse(pose_from(message)[1])
        except InputError:      # the pose is withdrawn
            self._registered = None

    def _on_live_pose(self, message: PoseWithCovarianceStamped) -> None:
        self._estimated = inverse(pose_from(
            PoseStamped(header=message.header, pose=message.pose.pose))[1])

    def _on_tip(self, message: PointStamped) -> None:
        self._arrivals.add(time.monotonic())
        tip, pose = message.point, self._registered
        if pose is None:
            pose = self._estimated
        self._page.show_tip(None if pose is None else transform(
            pose, np.array([[tip.x, tip.y, tip.z]]))[0])

    def _look(self) -> None:
        """Check the connection, the tracker and the settings of the node."""
        connected = self.node.count_publishers(f'{self._target}/status') > 0
        if not connected and self._values is not None:
            self._values, self._asked_settings = None, False
            self._registered = self._estimated = None
            self._page.show_status(None)
        if connected and not self._asked_settings:
            self._ask_settings()
        self._page.show_tracker(self._arrivals.summary(time.monotonic()))

    def _ask_settings(self) -> None:
        client = self._client(GetParameters, 'get_parameters')
        if client.is_ready():
            self._asked_settings = True
            client.send(GetParameters.Request(names=list(SETTINGS))).add_done_callback(
                self._on_settings)

    def _on_settings(self, future: Any) -> None:
        sigma, error, verification, names, positions = future.result().values
        self._page.show_settings(
            Limits(sigma.double_value, error.double_value, verification.double_value),
            LandmarkPlaces(tuple(names.string_array_value),
                           tuple(zip(*[iter(positions.double_array_value)] * 3))))

    # ---- what the page asks for; called by threads of the page

    def run(self, action: str) -> tuple[bool, str]:
        """Call the service of a button; return success and a sentence."""
        if action == 'collect':
            collecting = self._values is not None and self._values.get('collecting') == 'true'
            return self._call(SetBool, action, SetBool.Request(data=not collecting))
        return self._call(Trigger, action, Trigger.Request())

    def drop_stroke(self, number: int) -> tuple[bool, str]:
        """Drop a stroke; return success and a sentence."""
        if not results.available():
            return False, ('gsdf_registration_msgs is not installed: only the last stroke can be '
                           'dropped, with Undo stroke')
        kind = results.service_types().DropStroke
        return self._call(kind, 'drop_stroke', kind.Request(stroke=number))

    def _on_pedal(self, action: str, _: Any) -> None:
        # the answer arrives through the executor, which must not wait for it
        threading.Thread(target=lambda: self._page.show_answer(*self.run(action)),
                         daemon=True).start()

    def _client(self, kind: Any, service: str) -> ServiceClient:
        if service not in self._clients:
            self._clients[service] = ServiceClient(self.node, kind, self._target, service)
        return self._clients[service]

    def _call(self, kind: Any, service: str, request: Any) -> tuple[bool, str]:
        """Call a service of the node and wait for its answer."""
        client, end = self._client(kind, service), time.monotonic() + DISCOVERY
        while not client.is_ready():
            if time.monotonic() > end:
                return False, f'the service {self._target}/{service} is not available'
            time.sleep(POLL)
        answered = threading.Event()
        future = client.send(request)
        future.add_done_callback(lambda _: answered.set())
        if not answered.wait(PATIENCE):
            return False, f'{self._target}/{service} did not answer within {PATIENCE:.0f} s'
        response = future.result()
        return response.success, response.message


class Drawing:
    """Draws the newest markers in a thread of its own: a bone takes longer than a tip may wait."""

    def __init__(self, page: ConsolePage) -> None:
        self._page = page
        self._newest: bytes | None = None
        self._arrived = threading.Event()
        threading.Thread(target=self._draw, name='drawing', daemon=True).start()

    def show(self, message: bytes) -> None:
        """Draw a serialized MarkerArray soon."""
        self._newest = message
        self._arrived.set()

    def _draw(self) -> None:
        while True:
            self._arrived.wait()
            self._arrived.clear()
            message, self._newest = self._newest, None
            if message is not None:
                self._page.show_markers(from_bytes(message))


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
