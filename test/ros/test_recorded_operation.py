# SPDX-License-Identifier: Apache-2.0
"""What ``gsdf record`` records of an operation, ``gsdf replay`` replays to the bit."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.msg import Transition
from rclpy.parameter import Parameter
from ros_support import ENDS_WITH_TESTS, ROOT, NodeProcess, Tracker, tracked
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import exp
from msg_adapters import ros
from msg_adapters.bag import TYPES, list_topics, read_bag

pytestmark = pytest.mark.ros
STILL = np.eye(4)


class RecorderProcess:
    """``gsdf record`` in a process."""

    def __init__(self, bag: Path, *topics: str) -> None:
        self.bag = bag
        self.process = subprocess.Popen(
            [*ENDS_WITH_TESTS, sys.executable, '-m', 'gsdf_registration.cli.main', 'record',
             *topics, '-o', str(bag)],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def await_topics(self, *topics: str) -> None:
        """Wait until it receives these topics."""
        assert self.process.stdout is not None
        missing = set(topics)
        for line in self.process.stdout:
            missing.discard(line.removeprefix('recording ').split(' ')[0])
            if not missing:
                return
        pytest.fail(f'{", ".join(missing)}: not recorded')

    def await_samples(self, tracker: Tracker) -> None:
        """Send samples until it receives them: a publisher finds a new subscription later."""
        def received() -> bool:
            tracker.send(np.zeros((1, 3)))
            with contextlib.suppress(InputError):       # nothing yet
                return len(read_bag(self.bag)) > 0
            return False
        tracker.client.spin_until(received, 'the recorder receives no sample')

    def await_event(self, tracker: Tracker, events: str, last: Callable[[OperatorEvent], bool],
                    *topics: str) -> None:
        """Wait until it has received the last event, and something on each of the topics."""
        def received() -> bool:
            with contextlib.suppress(InputError):       # nothing yet
                found = read_bag(self.bag, events=events).events
                counts = {each.name: each.messages for each in list_topics(self.bag)}
                return bool(found) and last(found[-1].event) and all(
                    counts.get(topic) for topic in topics)
            return False
        tracker.client.spin_until(received, 'the recorder does not receive the last event')

    def end(self, number: int = signal.SIGINT) -> tuple[int, str, str]:
        """Stop it with a signal; return exit code and output."""
        self.process.send_signal(number)
        out, error = self.process.communicate(timeout=30.0)
        return self.process.returncode, out, error


@pytest.fixture(scope='module')
def shared_node(parameters: dict[str, Any],
                tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeProcess]:
    """Start a node for these tests: late subscribers also receive the events of earlier ones."""
    node = NodeProcess(tmp_path_factory.mktemp('recorded') / 'log', 'recorded', **parameters)
    yield node
    node.stop()


@pytest.fixture(scope='module')
def shared_tracker(shared_node: NodeProcess) -> Iterator[Tracker]:
    with tracked(shared_node) as tracker:
        yield tracker


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Callable[..., RecorderProcess]]:
    running: list[RecorderProcess] = []

    def start(*topics: str) -> RecorderProcess:
        running.append(RecorderProcess(tmp_path / f'bag{len(running)}', *topics))
        return running[-1]
    yield start
    for each in running:
        if each.process.poll() is None:
            each.process.kill()
            each.process.wait()


def replayed(bag: Path, tmp_path: Path, *options: str) -> dict:
    """Return the JSON document of ``gsdf replay``."""
    done = subprocess.run(
        [sys.executable, '-m', 'gsdf_registration.cli.main', 'replay', str(bag), '--model',
         str(ROOT / 'bags/hip.ply'), '--json', str(tmp_path / 'replay.json'), *options],
        cwd=ROOT, capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    return {**json.loads((tmp_path / 'replay.json').read_text()), 'out': done.stdout}


def sent(bag: Path, topic: str) -> list[Any]:
    """Return the messages on a topic of a recording."""
    with AnyReader([bag]) as reader:
        return [TYPES.deserialize_cdr(data, connection.msgtype)
                for connection, _, data in reader.messages(
                    [each for each in reader.connections if each.topic == topic])]


def seconds(message: Any) -> float:
    """Return the stamp of a message, s."""
    return ros.stamp_to_seconds(message.header.stamp)


def assert_same_topics(replayed: Path, recorded: Path, node: str) -> None:
    """Check that ``gsdf replay --mcap`` wrote what the node published."""
    for topic in ('bone_pose', 'bone_pose_with_covariance', 'events'):
        ours, theirs = sent(replayed, f'/registration/{topic}'), sent(recorded, f'{node}/{topic}')
        renamed = str(theirs).replace(f"name='{node}'", "name='/registration'")
        assert theirs and str(ours) == renamed, topic
    tips = set(map(str, sent(replayed, '/registration/tip')))
    begun = seconds(sent(recorded, '/probe/tip')[0])    # it may have received a tip before
    assert {str(each) for each in sent(recorded, f'{node}/tip')
            if seconds(each) >= begun} <= tips      # best effort: some may be lost
    ours, theirs = sent(replayed, '/registration/points'), sent(recorded, f'{node}/points')
    # an assessment of the points that ends later may be published after those of the registration
    assert ours[-1].data.tobytes() in {each.data.tobytes() for each in theirs} - {b''}


def test_an_operation_is_replayed_to_the_bit(shared_node: NodeProcess, tracker: Tracker,
                                             recorder: Callable[..., RecorderProcess],
                                             tmp_path: Path) -> None:
    client, name = tracker.client, shared_node.name
    running = recorder('/probe/tip', f'{name}/*')
    running.await_topics('/probe/tip')
    running.await_samples(tracker)
    assert client.ask('clear').success
    tracker.touch_landmarks(STILL)
    client.collect(True)
    tracker.send(tracker.positions[:250], tracker.steps[:250])
    client.collect(False)       # at once: some points are on the way
    client.collect(True)
    tracker.send(tracker.positions[250:400] + 0.03, tracker.steps[250:400])
    assert client.ask('undo').success       # a stroke that was not on the bone
    # it changes which points are kept
    assert not client.set_parameters(Parameter('gate.min_distance', value=0.001))
    client.collect(True)
    tracker.send(tracker.positions[250:], tracker.steps[250:])
    answer = client.ask('register')         # while points are on the way
    client.collect(False)
    assert answer.success, answer.message

    def verified() -> bool:
        tracker.send(np.tile(tracker.positions[100], (50, 1)))
        return client.ask('verify').message.startswith('the tip is')
    client.spin_until(verified, 'nothing is verified')
    pose = client.receive(PoseWithCovarianceStamped, '~/bone_pose_with_covariance')
    status = client.status(state='registered')
    assert not client.set_parameters(Parameter('gate.min_distance', value=0.0))
    # an event that is missing would be a request that is not replayed
    running.await_event(tracker, f'{name}/events',
                        lambda event: event.request == {'gate.min_distance': 0.0},
                        f'{name}/bone_pose', f'{name}/bone_pose_with_covariance')
    code, out, error = running.end()
    assert code == 0 and 'nobody' not in error, out + error
    events, tips = (next(line for line in out.splitlines() if line.startswith(f'{topic}: '))
                    for topic in (f'{name}/events', '/probe/tip'))
    assert 'lost' not in events + tips and 'written to' in out

    recording = read_bag(running.bag, events=None)
    assert recording.complete and recording.source_names == ['/probe/tip']
    (tmp_path / 'fast.yaml').write_text('live: {enabled: false}')     # it changes no result
    document = replayed(running.bag, tmp_path, '--mcap', str(tmp_path / 'topics'), '--config',
                        str(tmp_path / 'fast.yaml'))
    assert document['recording'] == {'complete': True, 'notes': []}
    T = np.array(document['T_tracker_bone'])
    again = ros.pose_with_covariance_msg(T, document['covariance'], pose.header.frame_id,
                                         pose.header.stamp)
    assert again == pose        # every bit of pose and covariance
    assert_same_topics(tmp_path / 'topics', running.bag, name)
    found = document['points']
    assert [str(found[key]) for key in ('used', 'inliers')] == [status['used'], status['inliers']]
    # the counts add up in JSON, on the console and in the status
    rejected = {f'rejected.{cause}': str(count) for cause, count in document['rejected'].items()}
    left_out = {f'left_out.{cause}': str(count) for cause, count in found['left_out'].items()}
    assert left_out.items() <= status.items() and rejected.keys() <= status.keys()
    assert found['received'] == found['used'] + sum(found['left_out'].values()) + sum(
        document['rejected'].values())
    assert document['rejected']['undone'] > 0
    assert int(status['received']) == int(status['kept']) + sum(
        int(count) for key, count in status.items() if key.startswith('rejected.'))
    assert f'{found["received"]} received, {found["used"]} used' in document['out']


def test_an_operation_is_replayed_from_service_events(
        shared_node: NodeProcess, tracker: Tracker, recorder: Callable[..., RecorderProcess],
        tmp_path: Path) -> None:
    client, name = tracker.client, shared_node.name
    wrong = client.set_parameters(Parameter('service_configure_introspection', value='on'))
    assert wrong == ('service_configure_introspection must be one of disabled, metadata, contents, '
                     'not "on"')
    assert not client.set_parameters(Parameter('service_configure_introspection',
                                               value='contents'))
    places = client.node.create_publisher(PoseWithCovarianceStamped, f'{name}/initial_pose', 10)
    running = recorder('/probe/tip', f'{name}/*')
    running.await_topics('/probe/tip', f'{name}/initial_pose', f'{name}/transition_event', *(
        f'{name}/{service}/_service_event' for service in (
            'clear', 'collect', 'register', 'undo', 'set_parameters_atomically')))
    running.await_samples(tracker)
    tracker.await_taken()       # so that the recorder has samples and requests in the node's order
    assert client.ask('clear').success

    # topics of a recording have no common order: the node and the recorder may receive a sample
    # and an event in another one
    def await_recorded(name_of_last: str) -> None:
        running.await_event(tracker, name, lambda event: event.name == name_of_last)

    def drag(rows: slice) -> None:
        client.collect(True)
        tracker.send(tracker.positions[rows], tracker.steps[rows])
        tracker.await_taken()
        client.collect(False)
    drag(slice(250))
    assert not client.set_parameters(Parameter('gate.min_distance', value=0.001),
                                     Parameter('search.rotations', value=50))
    await_recorded('parameters')
    guess = ros.pose_with_covariance_msg(tracker.truth.T_tracker_bone @ exp(np.full(6, 0.01)),
                                         np.zeros((6, 6)), 'tracker', Time())
    places.publish(guess)
    client.spin_until(lambda: 'initial pose' in client.status()['message'], 'it is not used')
    await_recorded('initial_pose')
    assert client.change(Transition.TRANSITION_DEACTIVATE)
    await_recorded('deactivate')
    tracker.send(tracker.positions[:50] + 0.02)     # not used
    assert not client.ask('register').success
    assert client.change(Transition.TRANSITION_ACTIVATE)
    await_recorded('activate')
    drag(slice(250, None))
    assert client.ask('register').success
    client.collect(True)
    assert client.ask('undo').success       # the pose used it: registered again
    pose = client.receive(PoseWithCovarianceStamped, '~/bone_pose_with_covariance')
    status = client.status(state='registered')
    await_recorded('undo')
    code, out, error = running.end()
    assert code == 0, out + error
    assert not client.set_parameters(Parameter('gate.min_distance', value=0.0),
                                     Parameter('search.rotations', value=200),
                                     Parameter('service_configure_introspection',
                                               value='disabled'))
    config = tmp_path / 'node.yaml'
    config.write_text('registration: {ros__parameters: {collect: {automatic: false}}}')
    document = replayed(running.bag, tmp_path, '--config', str(config), '--events', name)
    notes = document['recording']['notes']
    assert len(notes) == 1, notes
    assert notes[0].startswith(f'what the operator did is read from the service events of {name}')
    T = np.array(document['T_tracker_bone'])
    again = ros.pose_with_covariance_msg(T, document['covariance'], pose.header.frame_id,
                                         pose.header.stamp)
    assert again == pose
    assert str(document['points']['used']) == status['used']
    assert document['rejected']['undone'] == int(status['rejected.undone']) > 0


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGKILL])
def test_a_recorder_that_is_ended_leaves_a_readable_bag(
        number: int, shared_node: NodeProcess, tracker: Tracker,
        recorder: Callable[..., RecorderProcess]) -> None:
    running = recorder('/probe/tip', '/nobody')
    running.await_topics('/probe/tip')
    running.await_samples(tracker)
    tracker.send(tracker.positions[:100])

    def written() -> bool:
        tracker.send(tracker.positions[:1])
        with contextlib.suppress(InputError):       # nothing yet
            return read_bag(running.bag).positions.any(axis=1).sum() >= 100
        return False
    tracker.client.spin_until(written, 'nothing is written to the disk')
    code, _, error = running.end(number)
    points = read_bag(running.bag)
    sent = points.positions[points.positions.any(axis=1)]       # after those that were waited for
    np.testing.assert_array_equal(sent[:100], tracker.positions[:100])
    if number == signal.SIGKILL:
        assert not points.complete and any('killed' in note for note in points.notes)
        return
    assert code == 0 and points.complete and '/nobody: nobody published it' in error
    with Reader(running.bag) as reader:     # rosbags reads index and metadata
        assert reader.message_count == len(points)
    assert [topic.name for topic in list_topics(running.bag)] == ['/probe/tip']


