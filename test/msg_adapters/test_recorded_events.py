# SPDX-License-Identifier: Apache-2.0
"""Samples and events are brought into the order in which the node received them."""

from __future__ import annotations

import pytest

from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.result import InputError
from msg_adapters.recorded_events import decoded_events, events_source, node_order

STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'


def event(number: int, **last: tuple[int, float]) -> OperatorEvent:
    return OperatorEvent(number, 'collect', 0.0, last=last)


def test_values_and_events_correspond() -> None:
    given = OperatorEvent(7, 'drop_stroke', 1.7e9 + 0.1, False, 'no "stroke"', {'stroke': 3}, False,
                          'refused', 12, {'/probe/tip': (5, 1.7e9 / 3.0)})
    assert OperatorEvent.from_values(given.values(), given.message) == given


def test_several_topics_follow_the_order_of_the_node() -> None:
    # recorded: all samples of a before those of b; the node had two of a and three of b at first
    topics, stamps = ['a'] * 4 + ['b'] * 4, [1.0, 2.0, 3.0, 4.0, 1.5, 2.5, 3.5, 4.5]
    order = node_order(topics, stamps, [event(1, a=(2, 2.0), b=(3, 3.5)),
                                        event(2, a=(3, 3.0), b=(3, 3.5))])
    assert order.rows.tolist() == [0, 1, 4, 5, 6, 2, 3, 7]
    assert order.before == [5, 6] and not order.notes


def test_stamps_that_occur_twice_are_told_apart_by_their_number() -> None:
    stamps = [1.0, 2.0, 1.0, 2.0, 1.0, 2.0]     # a looped playback
    order = node_order(['a'] * 6, stamps, [event(1, a=(1, 1.0)), event(2, a=(4, 2.0)),
                                           event(3, a=(5, 1.0))])
    assert order.before == [1, 4, 5] and not order.notes


def test_samples_that_are_missing_are_counted() -> None:
    order = node_order(['a'] * 3, [1.0, 2.0, 5.0], [event(1, a=(1, 1.0)), event(2, a=(4, 4.0))])
    assert order.before == [1, 2] and '2 of them reached only one' in order.notes[0]


def test_the_only_topic_with_events_is_found() -> None:
    types = {'/a/events': STATUS, '/a/status': STATUS, '/b/events': 'std_msgs/msg/String'}
    assert events_source(types, None) == '/a/events'
    assert events_source({}, None) == '' == events_source(types, '')
    with pytest.raises(InputError, match='no events on /x; it has /a/events'):
        events_source(types, '/x')
    with pytest.raises(InputError, match='--events none'):
        events_source({**types, '/c/events': STATUS}, None)


def test_a_message_that_is_no_event_is_refused() -> None:
    class Message:
        values, message = (), ''
    with pytest.raises(InputError, match='cannot be read'):
        decoded_events([Message()])
