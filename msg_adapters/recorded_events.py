# SPDX-License-Identifier: Apache-2.0
"""
Read what an operator did from the topic ``~/events`` of a recorded node, and put it in its place.

The recorder receives the topics in another order than the node. Each event names the last sample
that the node had received before it, so the samples and events are brought into the node's order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.operator_event import TOPIC, OperatorEvent
from gsdf_registration.common.result import InputError
from msg_adapters.service_events import introspected_nodes

STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'


def events_source(types: dict[str, str], wanted: str | None) -> str:
    """
    Return the topic with the events of the node; empty if there is none.

    Without such a topic, return the node whose services were recorded, see `service_events`.

    Parameters
    ----------
    types : dict of str to str
        Type of each topic.
    wanted : str, optional
        The topic or the node; empty: none. The default is the only topic that ends with /events,
        or else the only node.

    Raises
    ------
    InputError
        If the topic is missing, or several could be meant.

    """
    topics = sorted(name for name, kind in types.items()
                    if kind == STATUS and name.endswith(f'/{TOPIC}'))
    nodes = introspected_nodes(types)
    if wanted is None:
        found = topics or nodes
        if len(found) > 1:
            raise InputError(f'the recording holds the events of several nodes: '
                             f'{", ".join(found)}; choose one with --events, or none with '
                             '--events none')
        return found[0] if found else ''
    if wanted and types.get(wanted) != STATUS and wanted not in nodes:
        raise InputError(f'the recording has no events on {wanted}; it has '
                         f'{", ".join(topics + nodes) or "no events"}')
    return wanted


def decoded_events(messages: Sequence[Any]) -> list[OperatorEvent]:
    """Return the events of DiagnosticStatus messages by number, each once."""
    events: dict[int, OperatorEvent] = {}
    for message in messages:
        try:
            event = OperatorEvent.from_values({each.key: each.value for each in message.values},
                                              message.message)
        except (KeyError, ValueError, TypeError):
            raise InputError('the recording has an event that cannot be read; replay its points '
                             'alone with --events none') from None
        events[event.number] = event
    return [events[number] for number in sorted(events)]


def settings_of(events: Sequence[OperatorEvent]) -> dict[str, Any]:
    """Return the settings of the node at its first event that has any, by dotted name."""
    return next((event.request['settings'] for event in events
                 if isinstance(event.request.get('settings'), dict)), {})


@dataclass
class Order:
    """
    The order of samples and events as the node received them.

    rows : (n,) int, indices of the messages in that order
    before : for each event, number of messages before it
    notes : sentences on events whose place is not known exactly
    """

    rows: NDArray[np.int64]
    before: list[int]
    notes: list[str] = field(default_factory=list)


def node_order(topics: Sequence[str], stamps: Sequence[float],
               events: Sequence[OperatorEvent]) -> Order:
    """
    Return the order in which the node received messages, from the last ones before each event.

    Parameters
    ----------
    topics : sequence of n str
        Topic of each message as recorded. Those that no event names, as /tf, keep their place.
    stamps : sequence of n float
        Of the headers, s.
    events : sequence of OperatorEvent
        In order.

    """
    n, order = len(topics), Order(np.arange(len(topics)), [])
    # number of the first event before which the node had received a message
    epoch = np.full(n, len(events), dtype=np.int64)
    named = {topic for event in events for topic in event.last}
    rows_of = {topic: np.array([i for i, name in enumerate(topics) if name == topic], dtype=int)
               for topic in sorted(named)}
    seen = dict.fromkeys(named, 0)          # messages of each topic before the present event
    counted: dict[str, int] = {}            # by the node
    lost = 0
    for number, event in enumerate(events):
        for topic, (count, stamp) in event.last.items():
            rows, first = rows_of[topic], seen[topic]
            after = _place(np.array([stamps[i] for i in rows[first:]]), stamp,
                           count - counted.get(topic, 0))
            epoch[rows[first:first + after]] = number
            if topic in counted:
                lost += abs(count - counted[topic] - after)
            else:       # the others came before the node was started
                epoch[rows[:max(after - count, 0)]] = 0
            counted[topic], seen[topic] = count, first + after
        if event.begins_session:    # the samples before it do not matter
            lost = 0
    # a message of another topic comes after those recorded before it
    other = np.array([topic not in named for topic in topics], dtype=bool)
    latest = np.maximum.accumulate(np.where(other, -1, epoch)) if n else epoch
    epoch = np.where(other, np.maximum(latest, 0), epoch)
    order.rows = np.argsort(epoch, kind='stable')
    order.before = np.searchsorted(epoch[order.rows], np.arange(len(events)), 'right').tolist()
    if lost:
        order.notes.append(f'the recording and the node do not have the same samples: {lost} of '
                           'them reached only one of the two, so the replay may differ')
    return order


def _place(stamps: NDArray[np.float64], last: float, expected: int) -> int:
    """Return how many of the ``stamps`` (m,) the node had received; ``expected`` by its count."""
    found = np.flatnonzero(stamps == last)
    if len(found):
        return int(found[np.argmin(np.abs(found + 1 - expected))]) + 1
    later = np.flatnonzero(stamps > last)   # the sample is not in the recording
    return int(later[0]) if len(later) else len(stamps)
