# SPDX-License-Identifier: Apache-2.0
"""A killed node resumes its session; a journal that it cannot resume is kept."""

from __future__ import annotations

import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from rclpy.parameter import Parameter
from ros_support import BAG, Client, NodeProcess, Tracker

from gsdf_registration.session.events import Replay
from msg_adapters import ros
from msg_adapters.session_journal import journal_path, read_journal

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]
STILL = np.eye(4)


def kill(node: NodeProcess) -> None:
    node.process.send_signal(signal.SIGKILL)
    node.process.wait()


@pytest.fixture
def resuming(parameters: dict[str, Any], tmp_path: Path) -> dict[str, Any]:
    """Return the parameters of a node that resumes its session and collects automatically."""
    return parameters | {'session.path': tmp_path / 'session.json', 'session.resume': 'true',
                         'collect.automatic': 'true'}


def points_in(journal: Path) -> int:
    """Return the number of points in a journal, which must not be damaged."""
    replay = Replay()
    assert read_journal(journal, replay.apply) == ''
    return len(replay.session['points'])


def test_resumes_the_session_of_a_killed_node(start_node: StartNode, resuming: dict[str, Any],
                                              tmp_path: Path) -> None:
    node = start_node('killed', **resuming)
    with Client(node) as client:
        client.await_state('active')
        assert 'there is no journal' in node.log
        tracker = Tracker(client)
        tracker.await_listener()
        # the journal moves while the topics are known, but nothing is collected
        first = tmp_path / 'first.json'
        assert client.set_parameters(Parameter('session.path', value=str(first))) == ''
        tracker.touch_landmarks(STILL)
        client.collect(True)
        half = len(tracker.positions) // 2
        tracker.send(tracker.positions[:half], tracker.steps[:half])
        client.status(received=str(3 * 50 + half))
        assert client.ask('register').success
        before = client.status(state='registered')
        assert int(before['kept']) > 0.9 * half
        stamp = tracker._stamp
        for path, reason in (('no/s.json', 'cannot be written'), ('s.txt', 'ends with .json'),
                             ('x' * 5000 + '/s.json', 'File name too long'),
                             ('~nosuchuser/s.json', 'no home directory')):
            assert reason in client.set_parameters(Parameter('session.path', value=path))
        journal_path(first).unlink()
        client.collect(True)        # the change at which the loss is noticed
        client.spin_until(lambda: 'is written again' in node.log, 'the journal is not renewed')
        moved = tmp_path / 'moved.json'     # the journal moves, too
        assert client.set_parameters(Parameter('session.path', value=str(moved))) == ''
    kill(node)
    assert not journal_path(resuming['session.path']).exists() and not journal_path(first).exists()

    again = start_node('again', **resuming | {'session.path': moved})
    with Client(again) as client:
        client.await_state('active')
        status = client.status(kept=before['kept'])
        for key in ('received', 'kept', 'strokes', 'landmarks', 'frame_id'):
            assert status[key] == before[key], key
        assert f'resumed from {moved}.journal: {before["kept"]} points' in (
            status['message'])
        assert 'resumed from' in again.log
        tracker = Tracker(client)
        tracker._stamp = stamp
        T = ros.pose_from(client.receive(PoseStamped, '~/bone_pose'))[1]    # from before
        tracker.assert_near_truth(T, STILL)
        tracker.send(tracker.positions[half:], tracker.steps[half:])
        client.spin_until(lambda: int(client.status()['kept']) > 600, 'points were lost')
        answer = client.ask('register')
        assert answer.success, answer.message
        T = ros.pose_from(client.receive(PoseStamped, '~/bone_pose'))[1]
        tracker.assert_near_truth(T, STILL)
        kept = client.status(state='registered')['kept']
    kill(again)
    assert points_in(journal_path(moved)) == int(kept)     # none lost, none twice


def send_forty(client: Client) -> str:
    """Send 40 points to a node that starts; return how many it keeps."""
    client.await_state('active')
    tracker = Tracker(client)
    tracker.await_listener()
    tracker.send(tracker.positions[:40], tracker.steps[:40])
    return client.status(received='40')['kept']


def test_keeps_a_cleared_session_but_does_not_resume_it(start_node: StartNode,
                                                        resuming: dict[str, Any],
                                                        tmp_path: Path) -> None:
    node = start_node('cleared', **resuming)
    with Client(node) as client:
        kept = send_forty(client)
        assert client.ask('clear').success
    kill(node)
    journal = journal_path(tmp_path / 'session.json')
    assert points_in(journal.with_name(f'{journal.name}.1')) == int(kept) > 30
    again = start_node('again', **resuming)
    with Client(again) as client:
        client.await_state('active')
        assert client.status()['kept'] == '0'


def test_keeps_the_journal_of_another_bone(start_node: StartNode, resuming: dict[str, Any],
                                           tmp_path: Path) -> None:
    node = start_node('hip', **resuming)
    with Client(node) as client:
        kept = send_forty(client)
    kill(node)
    other = start_node('femur', **resuming | {'model.path': BAG.parent / 'femur.ply'})
    with Client(other) as client:
        client.await_state('active')
        status = client.status(kept='0')
        assert 'belongs to another bone model' in status['message']
        aside = tmp_path / 'session.json.journal.1'
        assert f'is kept as {aside}' in status['message']
    assert points_in(aside) == int(kept) > 30


def test_loses_no_point_if_the_journal_cannot_be_written(start_node: StartNode,
                                                         resuming: dict[str, Any],
                                                         tmp_path: Path) -> None:
    path = tmp_path / 'none' / 'session.json'
    node = start_node('unwritable', **resuming | {'session.path': path})
    with Client(node) as client:
        client.await_state('active')
        tracker = Tracker(client)
        tracker.await_listener()
        tracker.send(tracker.positions[:50], tracker.steps[:50])
        client.spin_until(lambda: int(client.status()['kept']) > 45, 'points were lost')
        status = client.receive(DiagnosticStatus, '~/status', accept=lambda status: (
            'No such file or directory; points are now lost if the node crashes' in status.message))
        assert status.level == DiagnosticStatus.WARN
    assert node.log.count('cannot be written') == 1
