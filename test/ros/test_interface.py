# SPDX-License-Identifier: Apache-2.0
"""The interface page describes the actual node."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest
from rclpy.parameter import Parameter
from ros_support import ROOT, Client, NodeProcess, Tracker

from gsdf_registration.common.result import Reason
from msg_adapters import results

sys.path.append(str(ROOT / 'docs'))
import interface  # noqa: E402

pytestmark = pytest.mark.ros
StartNode = Callable[..., NodeProcess]


def test_documents_are_up_to_date(start_node: StartNode) -> None:
    pytest.importorskip('tf2_msgs', reason='without it there is no /tf')
    node = start_node('described', **interface.PARAMETERS)
    with Client(node) as client:
        client.await_state('active')
        table = interface.rows(client, node.name)
        subscribed, published = interface.subscribed_and_published(client, node.name)
    assert subscribed == interface.SUBSCRIBED.keys()
    assert published == interface.published_topics()
    advice = 'run python docs/interface.py to update it'
    # without gsdf_registration_msgs its rows are not compared
    shown = str if results.available() else interface.untyped
    assert shown(interface.PAGE.read_text()) == interface.page(table), advice


def test_describes_every_value_of_the_status(tracker: Tracker) -> None:
    sigmas = Parameter('landmarks.sigmas', value=[5e-3] * len(tracker.truth.landmarks_tracker))
    assert tracker.client.set_parameters(sigmas) == ''      # else there is no landmark.*
    tracker.touch_landmarks(np.eye(4))
    tracker.drag(np.eye(4))
    seen = set(tracker.client.status(state='ready'))
    assert tracker.client.ask('register').success
    tracker.send(np.tile(tracker.positions[100] + 0.02, (60, 1)))
    tracker.client.spin_until(lambda: 'tip is' in tracker.client.ask('verify').message,
                              'no verification is possible')
    seen |= set(tracker.client.status())
    assert tracker.client.set_parameters(
        Parameter(sigmas.name, Parameter.Type.DOUBLE_ARRAY, [])) == ''
    assert tracker.client.ask('calibrate_tip').success
    seen |= set(tracker.client.status(calibration='calibrate_tip'))
    assert not tracker.client.ask('calibrate_tip').success      # there are no poses
    seen.remove('message')      # not a key of the values
    assert [value for value in seen if not interface.described(value)] == []
    assert set(map(interface.described, seen)) == interface.STATUS.keys()


def test_describes_every_reason() -> None:
    assert interface.REASONS.keys() == set(Reason)
