# SPDX-License-Identifier: Apache-2.0
"""The example clients, with a real node and with one that loses an answer."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.task import Future
from ros_support import ROOT, Tracker
from std_srvs.srv import Trigger

from gsdf_registration.clients.operator import Operator
from gsdf_registration.common.result import Reason, RegistrationResult, Zone
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.node.qos import LATCHED, RESULT
from msg_adapters import results, ros

pytestmark = pytest.mark.ros


class Example:
    """An example client as a process, with its output in a file."""

    def __init__(self, file: Any, name: str, *arguments: str) -> None:
        self._file = file
        with file.open('w') as out:
            self.process = subprocess.Popen([sys.executable, ROOT / 'examples' / name, *arguments],
                                            stdout=out, stderr=out)

    @property
    def output(self) -> str:
        return str(self._file.read_text())

    def exit_status(self, spin: Callable[[], None] = lambda: time.sleep(0.01)) -> int:
        """Wait for the end of the process; return its exit status."""
        end = time.monotonic() + 30.0
        while self.process.poll() is None:
            assert time.monotonic() < end, self.output
            spin()
        assert 'Traceback' not in self.output, self.output
        return int(self.process.returncode)


@pytest.fixture
def start_example(tmp_path: Any) -> Iterator[Callable[..., Example]]:
    started: list[Example] = []

    def start(*arguments: str) -> Example:
        started.append(Example(tmp_path / f'example_{len(started)}', *arguments))
        return started[-1]
    yield start
    for each in started:
        each.process.kill()
        each.process.wait()


@pytest.fixture
def fake() -> Iterator[Operator]:
    """Return a helper whose node takes the place of a registration node."""
    with Operator(patience=30.0) as helper:
        yield helper


def test_operator_registers_and_a_second_run_prints_the_pose(
        tracker: Tracker, start_example: Callable[..., Example]) -> None:
    operator = start_example('operator_client.py')
    tracker.drag(np.eye(4))
    assert operator.exit_status() == 0
    assert 'enough points: register now' in operator.output
    again = start_example('operator_client.py')
    assert again.exit_status() == 0
    x, y, z = (float(value) for value in re.findall(r'[xyz]=([-\d.e]+)', operator.output)[:3])
    assert np.linalg.norm([x, y, z] - tracker.truth.T_tracker_bone[:3, 3]) < 2e-3, operator.output
    assert again.output.splitlines()[-1] == operator.output.splitlines()[-1]


@pytest.mark.parametrize('stop', [signal.SIGTERM, signal.SIGINT])
def test_operator_ends_without_a_traceback_at_a_signal(
        tracker: Tracker, start_example: Callable[..., Example], stop: signal.Signals) -> None:
    operator = start_example('operator_client.py')
    tracker.client.spin_until(lambda: 'collecting' in operator.output, 'no status is printed')
    operator.process.send_signal(stop)
    assert operator.exit_status() == 130


def test_operator_says_that_there_is_no_such_node(start_example: Callable[..., Example]) -> None:
    operator = start_example('operator_client.py', '/nobody', '--limit', '0.5')
    assert operator.exit_status() == 1
    assert operator.output == ('no node /nobody within 0.5 s: is it started, and in this ROS '
                               'domain?\n')


def test_operator_repeats_a_request_whose_answer_is_lost(
        fake: Operator, start_example: Callable[..., Example]) -> None:
    calls: list[int] = []
    node = fake.node
    status = node.create_publisher(DiagnosticStatus, '/fake/status', LATCHED)
    pose = node.create_publisher(PoseStamped, '/fake/bone_pose', LATCHED)

    async def register(_: Any, response: Trigger.Response) -> Trigger.Response:
        calls.append(1)
        if len(calls) == 1:
            await Future()      # no answer
        pose.publish(PoseStamped())
        response.success, response.message = True, 'registered'
        return response
    node.create_service(Trigger, '/fake/register', register,
                        callback_group=ReentrantCallbackGroup())
    status.publish(ros.diagnostic_status('fake', DiagnosticStatus.OK, 'register now',
                                         {'state': 'ready', 'pose': 'none'}))
    operator = start_example('operator_client.py', '/fake', '--limit', '3.0')
    fake.spin_until(lambda: operator.process.poll() is not None, 'the client does not end')
    assert operator.exit_status() == 0 and len(calls) == 2
    assert 'no answer within 3 s' in operator.output and 'registered' in operator.output


@pytest.mark.skipif(not results.available(), reason='gsdf_registration_msgs is not built')
def test_robot_moves_only_while_the_pose_is_valid_and_accurate(
        fake: Operator, start_example: Callable[..., Example]) -> None:
    from gsdf_registration_msgs.msg import RegistrationResult as ResultMessage

    header = results.ResultHeader(ros.seconds_to_stamp(1.0), 'tracker', 'bone', 'a1', 7)
    publisher = fake.node.create_publisher(ResultMessage, '/fake/result', RESULT)
    robot = start_example('robot_client.py', '/fake', '--max-tre', '0.001', '--grades', 'A')
    fake.spin_until(lambda: publisher.get_subscription_count() > 0, 'the robot does not subscribe')
    asked, = fake.node.get_subscriptions_info_by_topic('/fake/result')
    offered = RESULT.liveliness_lease_duration      # a node that is killed is noticed
    assert offered <= asked.qos_profile.liveliness_lease_duration <= Duration(seconds=5.0)

    def found(tre: float, grade: str = 'A') -> ResultMessage:
        return results.result_msg(RegistrationResult(
            Reason.CONVERGED, 'registered', np.eye(4), np.eye(6),
            predicted_tre_m={'cup': 2e-4, 'neck': tre, 'rms': 2e-3, 'max': 9e-3},
            zone=Zone(2e-3, 0.1, {'A': 1.0, 'B': 0.5}[grade], {'cup': 4e-4, 'neck': 2.0 * tre},
                      1e-3, 9e-3)), header)

    for message, printed in (
            (results.withdrawal_msg(Withdrawal.CLEARED, 'not yet', header), 'waiting: not yet'),
            (found(5e-4), 'start: registration 7'),
            (results.withdrawal_msg(Withdrawal.CLEARED, 'cleared', header), 'stop: cleared'),
            (found(2e-3), 'waiting: predicted error 2.00 mm at neck'),
            (found(float('nan')), 'waiting: predicted error nan mm at neck'),
            (found(5e-4, 'B'), 'waiting: grade "B"'),
            (found(5e-4, 'A'), 'start: registration 7')):
        before = len(robot.output)
        publisher.publish(message)
        fake.spin_until(lambda printed=printed, before=before: printed in robot.output[before:],
                        f'not printed: {printed}')
    fake.node.destroy_publisher(publisher)
    fake.spin_until(lambda: 'stop: the registration node is gone' in robot.output,
                    'the robot goes on without the node')
    robot.process.send_signal(signal.SIGTERM)
    assert robot.exit_status() == 0
