# SPDX-License-Identifier: Apache-2.0
"""The tip for displays, from positions of the tip and from poses of the tool."""

from __future__ import annotations

from typing import Any

import pytest

from gsdf_registration.common.config import Config
from gsdf_registration.common.samples import Sample
from gsdf_registration.common.tool_pose import ToolPose
from gsdf_registration.node.tip import TipPublisher
from gsdf_registration.session import Session

HALF_TURN_ABOUT_X: ToolPose = (0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0)


class Published(list[Any]):
    """A publisher that keeps its messages; ``subscribers``: how many listen."""

    subscribers = 1

    def publish(self, message: Any) -> None:
        self.append(message)

    def get_subscription_count(self) -> int:
        return self.subscribers


def sent(tip: list[float], sample: Sample, subscribers: int = 1) -> list[tuple[float, ...]]:
    """Return the positions on ``~/tip`` after a sample."""
    published = Published()
    published.subscribers = subscribers
    sink = TipPublisher(published, Session(Config().replaced({'probe.tip': tip})))
    sink.add(sample)
    return [(each.point.x, each.point.y, each.point.z) for each in published]


def test_shows_the_tip_of_a_tool_and_not_its_origin() -> None:
    pose = Sample(1.0, HALF_TURN_ABOUT_X[:3], 'tracker', '/tool', tool=HALF_TURN_ABOUT_X)
    shown, = sent([0.0, 0.01, 0.1], pose)
    assert shown == pytest.approx((0.1, 0.19, 0.2))
    assert sent([], pose) == []         # the tip is not known
    assert sent([0.0, 0.0, 0.1], pose._replace(tool=(*HALF_TURN_ABOUT_X[:3], 0, 0, 0, 0))) == []


def test_shows_a_position_as_it_is_while_somebody_listens() -> None:
    sample = Sample(1.0, (0.1, 0.2, 0.3), 'tracker', '/probe/tip')
    assert sent([], sample) == sent([0.0, 0.0, 0.1], sample) == [(0.1, 0.2, 0.3)]
    assert sent([], sample, subscribers=0) == []
    assert sent([], sample._replace(position=(float('nan'), 0.0, 0.0))) == []
