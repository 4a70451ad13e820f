# SPDX-License-Identifier: Apache-2.0
"""One request never ends the node: it is answered with one sentence, and the node continues."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from geometry_msgs.msg import PoseArray
from lifecycle_msgs.msg import Transition
from rclpy.parameter import Parameter
from ros_support import Client, NodeProcess, Tracker
from rosgraph_msgs.msg import Clock

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]
STRING, STRINGS = Parameter.Type.STRING, Parameter.Type.STRING_ARRAY
DOUBLES = Parameter.Type.DOUBLE_ARRAY


def assert_alive(client: Client, state: str = 'active') -> None:
    assert client.state() == state


@pytest.mark.parametrize('path, reason', [
    ('x' * 300, 'File name too long'),
    ('x' * 5000, 'File name too long'),
    ('~nosuchuser/x.ply', 'there is no such user'),
    ('nul\\0byte.ply', 'does not exist'),
    ('{fifo}', 'this is not a regular file'),
    ('/dev/zero', 'this is not a regular file'),
    ('package://gsdf_registration/../../secret.stl', 'names a file inside its package'),
], ids=['long', 'very long', 'no user', 'zero', 'fifo', 'device', 'package'])
def test_rejects_paths_that_cannot_be_opened(client: Client, tmp_path: Path, path: str,
                                             reason: str) -> None:
    fifo = tmp_path / 'fifo.stl'
    os.mkfifo(fifo)
    answer = client.set_parameters(Parameter('model.path', STRING, path.format(fifo=fifo)))
    assert reason in answer and 'internal error' not in answer
    assert len(answer) < 400
    assert_alive(client)


@pytest.mark.parametrize('path', ['x' * 300, 'x' * 5000, '~nosuchuser/session.json',
                                  '/dev/null/session.json'])
def test_rejects_session_paths_that_cannot_be_written(client: Client, path: str) -> None:
    answer = client.set_parameters(Parameter('session.path', STRING, path))
    assert answer and 'internal error' not in answer
    assert_alive(client)


@pytest.mark.parametrize('topic', ['/diagnostics', '/rosout', '~/status', '/tf', '/clock'])
def test_rejects_topics_that_the_node_uses_with_another_type(client: Client, topic: str) -> None:
    answer = client.set_parameters(Parameter('probe.topics', STRINGS, [topic]))
    assert 'is a topic with messages of another type' in answer
    assert_alive(client)


def test_rejects_a_transition_that_is_not_possible(client: Client,
                                                   shared_node: NodeProcess) -> None:
    assert not client.change(Transition.TRANSITION_CONFIGURE)
    assert not client.change(99)
    assert 'is not possible: the node is active' in shared_node.log
    assert_alive(client)


def test_holds_names_until_their_positions_arrive(client: Client) -> None:
    names = Parameter('targets.names', STRINGS, ['a', 'b', 'c'])
    positions = Parameter('targets.positions', DOUBLES, [0.1 * i for i in range(9)])
    near = Parameter('guidance.near', STRINGS, ['a'])

    def await_message(said: bool, sentence: str) -> None:
        client.spin_until(lambda: (sentence in client.status()['message']) == said,
                          f'"{sentence}" is {"not" if said else "still"} in the status')
    for order in ([near, names, positions], [positions, names, near]):
        for each in order:
            assert client.set_parameters(each) == ''
            if each is names and order[0] is near:
                await_message(True, 'targets.names has 3 entries, targets.positions has 0 numbers; '
                              'waiting for the other')
                assert 'too few' in client.ask('register').message      # nothing else changes
        await_message(False, 'waiting for')
        assert client.set_parameters(*[Parameter(each.name, each.type_, [])
                                       for each in order]) == ''


def test_hints_at_faults_of_the_wiring(start_node: StartNode) -> None:
    node = start_node('wired', robot_name='meca')
    with Client(node) as client:
        client.await_state('active')
        assert 'ignored parameters that this program does not have: robot_name' in node.log
        assert 'listening on /probe/tip (geometry_msgs/PointStamped)' in node.log
        wrong = client.node.create_publisher(PoseArray, '/probe/tip', 1)
        client.spin_until(
            lambda: '/probe/tip is published as geometry_msgs/PoseArray' in
            client.status()['message'], 'the wrong type is not reported')
        client.node.destroy_publisher(wrong)

        tracker = Tracker(client, topics=['/probe/tip'])
        tracker.await_listener()
        tracker.send(tracker.positions[:30])
        client.status(kept='30')
        client.set_parameters(Parameter('use_sim_time', Parameter.Type.BOOL, True))
        client.spin_until(lambda: 'use_sim_time was changed' in node.log, 'nothing is restarted')
        tracker._stamp = 5.0        # of the simulator
        tracker.send(tracker.positions[:30])
        assert client.status(kept='30')['rejected.not_monotonic'] == '0'
        client.spin_until(lambda: 'no time is received on /clock' in client.status()['message'],
                          'a missing clock is not reported')
        clock = client.node.create_publisher(Clock, '/clock', 10)
        client.spin_until(clock.get_subscription_count, '/clock has no subscription')

        def sent(seconds: int, effect: Callable[[], bool]) -> bool:
            message = Clock()
            message.clock.sec = seconds
            clock.publish(message)
            return effect()
        client.spin_until(lambda: sent(-5, lambda: 'a time below zero' in node.log),
                          'a negative time is not reported')
        client.spin_until(lambda: sent(5, lambda: '/clock' not in client.status()['message']),
                          'the clock is still reported as missing')
        assert_alive(client)
