# SPDX-License-Identifier: Apache-2.0
"""Helpers of the tests over DDS: node processes, a client, and a tracker with ground truth."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.duration import Duration
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy

from gsdf_registration.clients.operator import Operator
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import angle_between, transform
from msg_adapters import ros
from msg_adapters.bag import read_bag
from msg_adapters.truth import Truth, read_truth

ROOT = Path(__file__).parents[2]
BAG = ROOT / 'bags' / 'hip_optical'
TOPICS = ['/probe/tip', '/probe/landmarks', '/probe/second']
# the command after it is killed when the tests end, also if they are killed
ENDS_WITH_TESTS = ['setpriv', '--pdeathsig', 'KILL'] if shutil.which('setpriv') else []


class NodeProcess:
    """A registration node in a process, with its log in a file."""

    def __init__(self, log: Path, name: str = 'registration', options: Sequence[str] = (),
                 namespace: str = '', **parameters: Any) -> None:
        folder = ROOT
        if namespace:   # with the default session file, in the folder of the log
            folder, options = log.parent, (*options, '-r', f'__ns:=/{namespace}')
        else:           # else its journal would be written to the repository
            parameters = {'session.path': log.with_suffix('.json'), **parameters}
        words = [word for key, value in parameters.items() for word in ('-p', f'{key}:={value}')]
        self.name = f'/{namespace}/{name}'.replace('//', '/')
        self.log_file = log
        with log.open('w') as out:
            self.process = subprocess.Popen(
                [*ENDS_WITH_TESTS, sys.executable, '-m', 'gsdf_registration.node.main',
                 '--ros-args', '-r', f'__node:={name}', *options, *words],
                cwd=folder, stdout=out, stderr=out)

    @property
    def log(self) -> str:
        return self.log_file.read_text()

    def stop(self) -> None:
        self.process.kill()
        self.process.wait()


class Client(Operator):
    """An operator who also triggers lifecycle transitions and reads the status."""

    # on the first start the node compiles its kernels
    def __init__(self, node: NodeProcess, patience: float = 60.0) -> None:
        super().__init__(node.name, patience, alive=lambda: node.process.poll() is None)
        self._log = node.log_file

    def spin_until(self, condition: Callable[[], bool], complaint: str) -> None:
        try:
            super().spin_until(condition, complaint)
        except InputError as error:
            pytest.fail(f'{error.message}; log of the node:\n{self._log.read_text()}')

    def change(self, transition: int) -> bool:
        return bool(self.result(self.begin(transition)).success)

    def begin(self, transition: int) -> Any:
        request = ChangeState.Request()
        request.transition.id = transition
        return self.start(ChangeState, 'change_state', request)

    def set_parameters(self, *parameters: Parameter) -> str:
        """Set all parameters or none; return the reason of a rejection, else an empty string."""
        request = SetParametersAtomically.Request(
            parameters=[each.to_parameter_msg() for each in parameters])
        result = self.result(
            self.start(SetParametersAtomically, 'set_parameters_atomically', request)).result
        return '' if result.successful else str(result.reason)

    def await_state(self, state: str) -> None:
        self.spin_until(lambda: self.state() == state, f'the node is not {state}')

    def status(self, **wanted: str) -> dict[str, str]:
        """Wait for a status with these values (``__`` is a dot), and return all its values."""
        want = {key.replace('__', '.'): value for key, value in wanted.items()}

        def fits(message: DiagnosticStatus) -> bool:
            return want.items() <= values(message).items()
        message = self.receive(DiagnosticStatus, '~/status', accept=fits)
        return {**values(message), 'message': message.message}


def values(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


class Tracker:
    """Publishes tip positions of a recording with ground truth."""

    KIND: Any = PointStamped

    def __init__(self, client: Client, topics: list[str] = TOPICS, bag: Path = BAG) -> None:
        recording = read_bag(bag)
        self.client = client
        self.truth: Truth = read_truth(bag.with_suffix('.yaml'))
        self.positions = recording.positions
        self.steps = np.diff(recording.stamps, prepend=recording.stamps[0]) + 1e-4
        self._stamp = 1000.0
        qos = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
        self._publishers = {
            topic: client.node.create_publisher(self.KIND, topic, qos)
            for topic in topics
        }

    def await_listener(self) -> None:
        """Send points until each topic is connected; points sent before discovery are lost."""
        for topic, publisher in self._publishers.items():
            self.client.spin_until(publisher.get_subscription_count, f'{topic} has no subscription')
            self.client.ask('clear')

            def received(topic: str = topic) -> bool:
                self.send(np.zeros((1, 3)), topic=topic, frame_id='tracker')
                return self.client.status()['received'] != '0'
            self.client.spin_until(received, f'no point is received on {topic}')
        self.await_processed(10)
        self.client.ask('clear')

    def send(self,
             positions: np.ndarray,
             steps: np.ndarray | float = 0.0125,
             topic: str = '/probe/tip',
             frame_id: str = 'tracker') -> None:
        for position, step in zip(positions, np.broadcast_to(steps, len(positions))):
            self._stamp += float(step)
            stamp = ros.seconds_to_stamp(self._stamp)
            self._publishers[topic].publish(self.message(position, frame_id, stamp))
            time.sleep(0.0005)      # no faster than a real tracker

    def message(self, position: np.ndarray, frame_id: str, stamp: Any) -> Any:
        """Return the message for a position (3,) m of the tip."""
        return ros.point_msg(position, frame_id, stamp)

    def await_processed(self, points: int) -> None:
        """Wait until the node has processed this number of points, even if it ignores them."""
        self._await_acknowledged()
        # its executor takes a waiting point of each topic before it serves a request
        for _ in range(points + 1):
            self.client.ask('undo')

    def await_taken(self) -> None:
        """Wait until the node has taken all points that were sent; this changes nothing."""
        self._await_acknowledged()
        for _ in range(2):      # all points that wait are taken before a request is served
            self.client.state()

    def _await_acknowledged(self) -> None:
        for publisher in self._publishers.values():
            assert publisher.wait_for_all_acked(Duration(seconds=10.0))

    def touch_landmarks(self, T_moved: np.ndarray) -> None:
        """Hold the tip at each landmark, and capture it."""
        for place in transform(T_moved, self.truth.landmarks_tracker):
            self.send(np.tile(place, (50, 1)))
            self.client.spin_until(lambda: self.client.ask('capture_landmark').success,
                                   'no landmark is captured')

    def drag(self, T_moved: np.ndarray, topic: str = '/probe/tip') -> None:
        """Collect the recorded points."""
        self.client.collect(True)
        self.send(transform(T_moved, self.positions), self.steps, topic)
        self.client.spin_until(
            lambda: int(self.client.status()['kept']) > 0.95 * len(self.positions),
            'points were lost')
        self.client.collect(False)

    def assert_near_truth(self, T: np.ndarray, T_moved: np.ndarray, limit: float = 1e-3) -> None:
        """Check a pose against ground truth: 1 degree, and ``limit``, m, at the landmarks."""
        T_true = T_moved @ self.truth.T_tracker_bone
        places = self.truth.landmarks_model
        assert np.degrees(angle_between(T[:3, :3], T_true[:3, :3])) < 1.0
        errors = np.linalg.norm(transform(T, places) - transform(T_true, places), axis=1)
        assert errors.max() < limit


@contextmanager
def tracked(node: NodeProcess, **options: Any) -> Iterator[Tracker]:
    """Yield a tracker of ``options`` that the active node listens to."""
    with Client(node) as client:
        client.await_state('active')
        tracker = Tracker(client, **options)
        tracker.await_listener()
        yield tracker
