# SPDX-License-Identifier: Apache-2.0
"""Another program that sends the transform of the bone frame is reported."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from gsdf_registration.common.rigid import exp
from gsdf_registration.node import frame_watch
from gsdf_registration.node.frame_watch import FrameWatch
from msg_adapters import ros

T = exp(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
STAMP = ros.seconds_to_stamp(12.25)


class FakeNode:
    """Keeps the callbacks by topic."""

    def __init__(self) -> None:
        self.callbacks: dict[str, Callable[[bytes], None]] = {}

    def create_subscription(self, msg_type: Any, topic: str, callback: Callable[[bytes], None],
                            qos_profile: Any, *, event_callbacks: Any, raw: bool) -> str:
        assert raw
        self.callbacks[topic] = callback
        return topic

    def destroy_subscription(self, subscription: str) -> None:
        del self.callbacks[subscription]

    def send(self, topic: str, transform: Any) -> None:
        if topic in self.callbacks:
            self.callbacks[topic](serialize_message(frame_watch.TFMessage(transforms=[transform])))


@pytest.fixture
def node() -> FakeNode:
    if frame_watch.TFMessage is None:
        pytest.skip('tf2_msgs is not installed')
    return FakeNode()


@pytest.fixture
def watch(node: FakeNode) -> FrameWatch:
    watch = FrameWatch(node, 'bone')
    watch.start()
    return watch


def test_own_transforms_and_those_of_other_frames_are_no_problem(node: FakeNode,
                                                                 watch: FrameWatch) -> None:
    own = ros.transform_msg(T, 'tracker', 'bone', STAMP)
    watch.sent(own)
    node.send('/tf', own)
    for child in ('probe', 'femur_bone', 'bones'):
        node.send('/tf', ros.transform_msg(T, 'bone', child, STAMP))
    assert watch.problem == ''


@pytest.mark.parametrize('topic', ['/tf', '/tf_static'])
@pytest.mark.parametrize('other', [
    ros.transform_msg(np.eye(4), 'tracker', 'bone', STAMP),     # both use the time of a recording
    ros.transform_msg(T, 'world', 'bone', STAMP),
    ros.transform_msg(T, 'tracker', '/bone', ros.seconds_to_stamp(13.0))])
def test_transforms_of_another_program_are_reported(node: FakeNode, watch: FrameWatch, topic: str,
                                                    other: Any) -> None:
    watch.sent(ros.transform_msg(T, 'tracker', 'bone', STAMP))
    node.send(topic, other)
    assert 'another program sends a transform of bone too' in watch.problem
    assert other.header.frame_id in watch.problem and 'model.frame_id' in watch.problem
    watch.stop()
    assert watch.problem == '' and not node.callbacks


def test_problem_ends_when_the_other_program_stops(node: FakeNode, watch: FrameWatch,
                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    node.send('/tf', ros.transform_msg(T, 'tracker', 'bone', STAMP))
    assert watch.problem
    later = frame_watch.time.monotonic() + 2.0 * frame_watch.LIFETIME
    monkeypatch.setattr(frame_watch.time, 'monotonic', lambda: later)
    assert watch.problem == ''
