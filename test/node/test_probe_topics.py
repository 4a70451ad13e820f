# SPDX-License-Identifier: Apache-2.0
"""Test which message type is received on a topic of the probe."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from gsdf_registration.node.probe_topics import MESSAGES, type_to_receive
from msg_adapters.motion import POINT, POSE

TRANSFORM = 'geometry_msgs/msg/TransformStamped'
TEXT = 'std_msgs/msg/String'


class Graph:
    """A graph with publishers of these types on one topic."""

    def __init__(self, *types: str) -> None:
        self.types = types

    def get_publishers_info_by_topic(self, topic_name: str) -> list[Any]:
        assert topic_name == '/remapped'
        return [SimpleNamespace(topic_type=kind) for kind in self.types]

    def resolve_topic_name(self, topic: str) -> str:
        return '/remapped'


@pytest.mark.parametrize('published, probe_type, current, received', [
    ((), 'auto', '', POINT),                    # before there is a publisher
    ((), 'pose', '', POSE),
    ((TRANSFORM,), 'auto', POINT, TRANSFORM),   # a publisher that appears later decides
    ((POSE,), 'auto', TRANSFORM, POSE),         # and one that replaces it
    ((), 'auto', TRANSFORM, TRANSFORM),         # while it is away, nothing changes
    ((POSE, POINT), 'auto', POINT, POINT),
    ((POSE, POINT), 'auto', '', POSE),
    ((TEXT,), 'auto', POINT, POINT),
    ((POSE, POINT), 'point', POSE, POINT),      # the setting decides
    ((POSE,), 'point', POINT, POINT),
    ((POINT, TRANSFORM), 'pose', POINT, TRANSFORM),
    ((POINT,), 'pose', POINT, POSE)])
def test_receives_what_is_published_and_allowed(published: tuple[str, ...], probe_type: str,
                                                current: str, received: str) -> None:
    assert type_to_receive(Graph(*published), 'tip', probe_type, current) == received
    assert received in MESSAGES
