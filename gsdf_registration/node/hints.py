# SPDX-License-Identifier: Apache-2.0
"""
Hints on faults of the wiring, for an integrator: what is wrong, where, and what to do.

They come from the graph, once a second. Events of the middleware would be checked with every
message, which takes a third of the time to receive a point.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from rclpy.duration import Duration
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.topic_endpoint_info import TopicEndpointInfo

from gsdf_registration.common.config import Config
from gsdf_registration.node.probe_topics import accepted_types
from gsdf_registration.node.qos import POINTS
from gsdf_registration.node.transforms import STATIC

SILENCE = 5.0       # s without a point after which the status says so
FAR = 10.0          # s between the stamps and the clock of the node
LOST_FOR = 60.0     # s for which the status says that messages were lost
ENDLESS = 10**18    # ns


@dataclass(frozen=True)
class Hint:
    """One sentence, and whether somebody must act on it."""

    sentence: str
    warning: bool = True


class Graph(Protocol):
    """The node, as far as the hints use it."""

    def get_publishers_info_by_topic(self, topic_name: str) -> list[TopicEndpointInfo]:
        """Return the publishers of a topic."""

    def get_subscriptions_info_by_topic(self, topic_name: str) -> list[TopicEndpointInfo]:
        """Return the subscriptions of a topic."""

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        """Return all nodes."""

    def get_fully_qualified_name(self) -> str:
        """Return the name of this node with its namespace."""

    def resolve_topic_name(self, topic: str) -> str:
        """Return the name of a topic after remapping."""


class Arrivals:
    """When points arrived, and how far their stamps are from the clock of the node."""

    def __init__(self) -> None:
        self._last = time.monotonic()
        self._behind: dict[str, float] = {}
        self._lost: dict[str, float] = {}   # when messages were lost last

    def restart(self) -> None:
        """Start to wait for the first point."""
        self._last = time.monotonic()
        self._behind.clear()
        self._lost.clear()

    def add(self, topic: str, stamp: float, now: float) -> None:
        """Record a point with ``stamp`` that arrived at ``now``, clock of the node, s."""
        self._last = time.monotonic()
        self._behind[topic] = now - stamp

    def lose(self, topics: Sequence[str]) -> None:
        """Record that messages of these topics were lost."""
        self._lost |= dict.fromkeys(topics, time.monotonic())

    @property
    def silence(self) -> float:
        """The time since the last point, s."""
        return time.monotonic() - self._last

    def hints(self) -> list[Hint]:
        """Return a hint on lost messages, and on stamps far from the clock of the node."""
        now = time.monotonic()
        lost = [topic for topic, last in self._lost.items() if now - last < LOST_FOR]
        topics: dict[str, list[str]] = {}
        for topic, behind in self._behind.items():
            if abs(behind) > FAR:
                side = 'behind' if behind > 0.0 else 'ahead of'
                topics.setdefault(f'{_duration(abs(behind))} {side}', []).append(topic)
        return [Hint(f'messages on {", ".join(lost)} were lost before this node could take them, '
                     'see rejected.lost: publish fewer per second, or run less on this computer'
                     )] * bool(lost) + [
                Hint(f'the stamps on {", ".join(names)} are {where} the clock of this node: '
                     'synchronize the clocks of the computers, or set use_sim_time for a recording',
                     warning=False) for where, names in topics.items()]


def input_hints(graph: Graph, config: Config, arrivals: Arrivals, waiting: bool) -> list[Hint]:
    """
    Return the hints on the topics that the node receives.

    ``waiting``: whether points are expected now.
    """
    probes = [graph.resolve_topic_name(topic) for topic in config.probe.topics]
    publishers = {topic: graph.get_publishers_info_by_topic(topic) for topic in probes}
    kinds = accepted_types(config.probe.type)
    setting = 'probe.topics' if config.probe.type == 'auto' else f'probe.type {config.probe.type}'
    hints = [hint for topic in probes
             for hint in (*_mismatches(topic, publishers[topic], kinds, setting),
                          *_several_types(topic, publishers[topic], kinds))]
    if config.reference.topic:
        topic = graph.resolve_topic_name(config.reference.topic)
        hints += _mismatches(topic, graph.get_publishers_info_by_topic(topic),
                             accepted_types('pose'), 'reference.topic')
    if waiting and arrivals.silence > SILENCE and not hints:
        hints.append(_silence(probes, any(publishers.values())))
    return hints + arrivals.hints()


def frame_hints(graph: Graph) -> list[Hint]:
    """Return the hints on static transforms that the node cannot receive."""
    return [Hint(f'nothing is received on /tf_static from {_node_of(info)}: incompatible QoS: '
                 f'{reason}')
            for info in graph.get_publishers_info_by_topic('/tf_static')
            if (reason := _incompatible(info.qos_profile, STATIC))]


def output_hints(graph: Graph, offered: dict[str, QoSProfile]) -> list[Hint]:
    """Return the hints on subscriptions that cannot receive what the node offers by topic."""
    hints = []
    for topic, qos in offered.items():
        for info in graph.get_subscriptions_info_by_topic(graph.resolve_topic_name(topic)):
            reason = _incompatible(qos, info.qos_profile)
            if reason:
                hints.append(Hint(f'{_node_of(info)} cannot receive '
                                  f'{graph.resolve_topic_name(topic)}: incompatible QoS: {reason}'))
    return hints


def name_hints(graph: Graph) -> list[Hint]:
    """Return a hint if another node has the same name."""
    own = graph.get_fully_qualified_name()
    names = [f'{namespace.rstrip("/")}/{name}'
             for name, namespace in graph.get_node_names_and_namespaces()]
    if names.count(own) < 2:
        return []
    return [Hint(f'{names.count(own)} nodes are named {own}, and their topics and services '
                 'collide: start each in its own namespace, or give it another name')]


class Hints:
    """
    All hints of a node, renewed once a second.

    Parameters
    ----------
    graph : the node
    log : logger of the node
    offered : QoS by name of the topics that the node publishes

    """

    def __init__(self, graph: Graph, log: Any, offered: dict[str, QoSProfile]) -> None:
        self._graph = graph
        self._log = log
        self._offered = offered
        self._current: list[Hint] = []

    def renew(self, config: Config, arrivals: Arrivals | None, collecting: bool,
              more: Sequence[Hint]) -> None:
        """
        Look at the graph, and log the hints that are new.

        ``arrivals``: of an active node. ``more``: further hints.
        """
        before = {hint.sentence for hint in self._current}
        self._current = [*more, *name_hints(self._graph)]
        if arrivals is not None:
            self._current += input_hints(self._graph, config, arrivals, collecting)
            self._current += frame_hints(self._graph)
            self._current += output_hints(self._graph, self._offered)
        for hint in self._current:
            if hint.sentence in before:
                continue
            if hint.warning:    # rclpy identifies a log call by its line, which keeps its level
                self._log.warning(hint.sentence)
            else:
                self._log.info(hint.sentence)

    @property
    def warning(self) -> bool:
        """Whether somebody must act."""
        return any(hint.warning for hint in self._current)

    @property
    def sentence(self) -> str:
        """All hints; empty if there are none."""
        return '; '.join(hint.sentence for hint in self._current)


def _mismatches(topic: str, publishers: Sequence[TopicEndpointInfo], kinds: Sequence[str],
                setting: str) -> list[Hint]:
    """Return the hints on publishers whose type or QoS this node cannot receive."""
    hints = []
    for info in publishers:
        if info.topic_type not in kinds:
            hints.append(Hint(f'{topic} is published as {_short(info.topic_type)} by '
                              f'{_node_of(info)}; {setting} needs '
                              f'{" or ".join(map(_short, kinds))}'))
            continue
        reason = _incompatible(info.qos_profile, POINTS)
        if reason:
            hints.append(Hint(f'nothing is received on {topic} from {_node_of(info)}: '
                              f'incompatible QoS: {reason}'))
    return list(dict.fromkeys(hints))


def _several_types(topic: str, publishers: Sequence[TopicEndpointInfo],
                   kinds: Sequence[str]) -> list[Hint]:
    """Return a hint if a topic has messages of several types, of which one is received."""
    found = sorted({_short(info.topic_type) for info in publishers if info.topic_type in kinds})
    return [Hint(f'{topic} is published as {" and as ".join(found)}, and only one is received: '
                 'give each its own topic')] if len(found) > 1 else []


def _short(topic_type: str) -> str:
    """Return the name of a message type without its folder: geometry_msgs/PointStamped."""
    return topic_type.replace('/msg/', '/')


def _silence(probes: Sequence[str], published: bool) -> Hint:
    topics = ' or '.join(probes)
    if not published:
        return Hint(f'nothing publishes {topics}: start the tracker, or set probe.topics')
    return Hint(f'no point has arrived on {topics} for more than {SILENCE:g} s: is the probe in '
                'view of the tracker?', warning=False)


def _incompatible(offered: QoSProfile, requested: QoSProfile) -> str:
    """Return why a subscription receives nothing from a publisher; empty if it does."""
    compatibility, reason = qos_check_compatible(_decisive(offered), _decisive(requested))
    if compatibility != QoSCompatibility.ERROR:
        return ''
    words = ', '.join(part.strip().removeprefix('ERROR: ') for part in str(reason).split(';')
                      if part.strip())
    return words[:1].lower() + words[1:]


def _decisive(qos: QoSProfile) -> QoSProfile:
    """Return what decides; the graph reports an endless deadline as 292 years, not as none."""
    endless = qos.deadline.nanoseconds > ENDLESS
    return QoSProfile(depth=1, reliability=qos.reliability, durability=qos.durability,
                      deadline=Duration() if endless else qos.deadline)


def type_name(kind: Any) -> str:
    """Return the name of a message type: geometry_msgs/PointStamped."""
    package, _, _ = kind.__module__.partition('.')
    return f'{package}/{kind.__name__}'


def _node_of(info: TopicEndpointInfo) -> str:
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'


def _duration(seconds: float) -> str:
    """Return a duration that stays the same from second to second."""
    for unit, size in (('a year', 31557600.0), ('a day', 86400.0), ('an hour', 3600.0),
                       ('a minute', 60.0)):
        if seconds > size:
            return f'more than {unit}'
    return f'more than {FAR:g} s'
