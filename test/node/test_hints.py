# SPDX-License-Identifier: Apache-2.0
"""Hints on faults of the wiring, with a graph that is made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile

from gsdf_registration.common.config import Config
from gsdf_registration.node import hints
from gsdf_registration.node.hints import Arrivals, Hint, Hints, input_hints
from gsdf_registration.node.qos import OFFERED
from gsdf_registration.node.transforms import STATIC

POINT, POSE = 'geometry_msgs/msg/PointStamped', 'geometry_msgs/msg/PoseStamped'
VOLATILE = QoSProfile(depth=5)
LATE_JOINER = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def endpoint(topic_type: str = POINT, qos: QoSProfile = VOLATILE) -> Any:
    return SimpleNamespace(topic_type=topic_type, qos_profile=qos, node_name='tracker',
                           node_namespace='/or')


class Graph:
    """A graph with these publishers, subscriptions and nodes."""

    def __init__(self, publishers: dict[str, list[Any]] | None = None,
                 subscriptions: dict[str, list[Any]] | None = None, nodes: int = 1) -> None:
        self.publishers = publishers or {}
        self.subscriptions = subscriptions or {}
        self.nodes = nodes

    def get_publishers_info_by_topic(self, topic_name: str) -> list[Any]:
        return self.publishers.get(topic_name, [])

    def get_subscriptions_info_by_topic(self, topic_name: str) -> list[Any]:
        return self.subscriptions.get(topic_name, [])

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [('registration', '/')] * self.nodes + [('registration', '/tibia')]

    def get_fully_qualified_name(self) -> str:
        return '/registration'

    def resolve_topic_name(self, topic: str) -> str:
        return topic.replace('~', '/registration')


class Log:
    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def warning(self, text: str) -> None:
        self.lines.append(('warning', text))

    def info(self, text: str) -> None:
        self.lines.append(('info', text))


def sentences(graph: Graph, config: Config = Config(), waiting: bool = False) -> list[str]:
    return [hint.sentence for hint in input_hints(graph, config, Arrivals(), waiting)]


def test_says_nothing_of_a_tracker_that_is_wired_well() -> None:
    assert sentences(Graph({'/probe/tip': [endpoint()]})) == []


def test_reports_a_publisher_of_another_type() -> None:
    (hint,) = sentences(Graph({'/probe/tip': [endpoint('std_msgs/msg/String')]}))
    assert hint.startswith('/probe/tip is published as std_msgs/String by /or/tracker; '
                           'probe.topics needs geometry_msgs/PointStamped or')
    positions = Config.from_flat({'probe.type': 'point'})
    assert sentences(Graph({'/probe/tip': [endpoint(POSE)]}), positions) == [
        '/probe/tip is published as geometry_msgs/PoseStamped by /or/tracker; probe.type point '
        'needs geometry_msgs/PointStamped']
    assert sentences(Graph({'/probe/tip': [endpoint(POSE)]})) == []
    config = Config.from_flat({'reference.topic': '/array'})
    assert 'reference.topic needs geometry_msgs/PoseStamped' in sentences(
        Graph({'/array': [endpoint(POINT)]}), config)[0]


def test_reports_a_topic_with_two_types_that_could_be_the_probe() -> None:
    assert sentences(Graph({'/probe/tip': [endpoint(), endpoint(POSE)]})) == [
        '/probe/tip is published as geometry_msgs/PointStamped and as geometry_msgs/PoseStamped, '
        'and only one is received: give each its own topic']


def test_reports_that_no_point_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    assert sentences(Graph(), waiting=True) == []       # at first
    monkeypatch.setattr(hints, 'SILENCE', -1.0)
    assert sentences(Graph(), waiting=True) == [
        'nothing publishes /probe/tip: start the tracker, or set probe.topics']
    assert sentences(Graph(), waiting=False) == []
    assert 'is the probe in view' in sentences(Graph({'/probe/tip': [endpoint()]}), waiting=True)[0]


def test_reports_lost_messages_for_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr(hints.time, 'monotonic', lambda: clock[0])
    arrivals = Arrivals()
    assert arrivals.hints() == []
    arrivals.lose(['/probe/tip'])
    arrivals.lose([])
    clock[0] = 50.0
    (hint,) = arrivals.hints()
    assert hint.warning and hint.sentence.startswith('messages on /probe/tip were lost before')
    clock[0] = 70.0
    assert arrivals.hints() == []
    arrivals.lose(['/probe/tip'])
    arrivals.restart()
    assert arrivals.hints() == []


@pytest.mark.parametrize('behind, words', [
    (60 * 365.25 * 86400.0, 'more than a year behind'), (-100.0, 'more than a minute ahead of'),
    (11.0, 'more than 10 s behind')])
def test_reports_stamps_far_from_the_clock_of_the_node(behind: float, words: str) -> None:
    arrivals = Arrivals()
    arrivals.add('/probe/tip', 1e9, 1e9 + behind)
    (hint,) = arrivals.hints()
    assert words in hint.sentence and not hint.warning
    arrivals.add('/probe/tip', 1e9, 1e9 + 1.0)
    assert arrivals.hints() == []


def test_reports_a_subscription_that_cannot_receive() -> None:
    graph = Graph(subscriptions={'/registration/live_pose': [endpoint(qos=LATE_JOINER)],
                                 '/registration/bone_pose': [endpoint(qos=LATE_JOINER)]})
    (hint,) = hints.output_hints(graph, OFFERED)
    assert hint.sentence == ('/or/tracker cannot receive /registration/live_pose: incompatible '
                             'QoS: volatile publisher and transient local subscription')


def test_reports_static_transforms_that_cannot_be_received() -> None:
    graph = Graph({'/tf_static': [endpoint('tf2_msgs/msg/TFMessage', VOLATILE)]})
    (hint,) = hints.frame_hints(graph)
    assert 'nothing is received on /tf_static from /or/tracker' in hint.sentence
    assert hints.frame_hints(Graph({'/tf_static': [endpoint(qos=STATIC)]})) == []


def test_reports_another_node_of_the_same_name() -> None:
    assert hints.name_hints(Graph()) == []
    assert hints.name_hints(Graph(nodes=2))[0].sentence.startswith(
        '2 nodes are named /registration')


def test_logs_each_hint_once_until_it_is_gone() -> None:
    log, fault = Log(), Hint('the clock stands still')
    shown = Hints(Graph(), log, {})
    for more in ([fault], [fault], [], [fault]):
        shown.renew(Config(), None, False, more)
    assert log.lines == [('warning', fault.sentence)] * 2
    assert shown.warning and shown.sentence == fault.sentence
    shown.renew(Config(), None, False, [])
    assert not shown.warning and shown.sentence == ''
