# SPDX-License-Identifier: Apache-2.0
"""The scene topics of the node, and the topics of the shipped layouts."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import Point
from rclpy.qos import DurabilityPolicy
from ros_support import Client, NodeProcess, Tracker
from test_layouts import CENTRE, FOXGLOVE, LATCHED, described_services, rviz_topics
from visualization_msgs.msg import Marker, MarkerArray

from msg_adapters import results

pytestmark = pytest.mark.ros
STILL = np.eye(4)


def positions(points: list[Point]) -> np.ndarray:
    return np.array([[point.x, point.y, point.z] for point in points])


def assert_centred(client: Client, corners: np.ndarray) -> None:
    """Check the frame that the layouts look at, for which late joiners need no registration."""
    messages = pytest.importorskip('tf2_msgs.msg', reason='without it there is no /tf_static')
    sent, = client.receive(messages.TFMessage, '/tf_static', accept=lambda message: (
        message.transforms[0].child_frame_id == CENTRE)).transforms
    assert sent.header.frame_id == 'bone'
    shift, turn = sent.transform.translation, sent.transform.rotation
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    assert np.linalg.norm([shift.x, shift.y, shift.z] - middle) < 0.002
    assert np.linalg.norm(middle) > 0.01        # not at the origin of the model
    assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.0, 1.0)


def test_late_joiner_receives_bone_and_points(tracker: Tracker,
                                              shared_node: NodeProcess) -> None:
    tracker.touch_landmarks(STILL)
    tracker.drag(STILL)
    answer = tracker.client.ask('register')
    assert answer.success, answer.message

    def complete(array: MarkerArray) -> bool:
        return any(marker.ns == 'points' and marker.points for marker in array.markers)
    with Client(shared_node) as display:
        shown = {(marker.ns, marker.id): marker
                 for marker in display.receive(MarkerArray, '~/markers', accept=complete).markers}
        assert_centred(display, positions(shown['bone', 0].points))
    bone, points = shown['bone', 0], shown['points', 0]
    assert {marker.header.frame_id for marker in shown.values()} == {'bone'}
    assert bone.type == Marker.TRIANGLE_LIST and len(bone.colors) == len(bone.points)
    assert 0.1 < np.ptp(positions(bone.points), axis=0).max() < 0.3     # metres
    # most points lie on the drawn bone, whose triangles are a few millimetres wide
    corners = positions(bone.points)
    distances = np.array([np.linalg.norm(corners - point, axis=1).min()
                    for point in positions(points.points)])
    assert np.median(distances) < 0.005
    assert len({(c.r, c.g, c.b) for c in points.colors}) > 10
    # the pose is constrained: nothing to touch next
    assert shown['patch', 0].action == Marker.DELETE


def test_shows_the_place_that_disambiguates_the_pose(tracker: Tracker) -> None:
    client = tracker.client
    assert client.collect(True).success
    tracker.send(tracker.positions[:120], tracker.steps[:120])
    status = client.status(live__reason='ambiguous')
    assert status['touch_next'].startswith('touch the bone')
    assert status['touch_next'] in status['message']

    def marked(array: MarkerArray) -> dict[tuple[str, int], Marker]:
        return {(marker.ns, marker.id): marker for marker in array.markers
                if marker.action == Marker.ADD}
    shown = marked(client.receive(MarkerArray, '~/markers',
                               accept=lambda array: ('patch', 0) in marked(array)))
    assert shown['patch_label', 0].text == '1: disambiguates'
    assert ('patch', 1) not in shown
    if results.available():
        guidance = results.message_types().Guidance
        guided = client.receive(guidance, '~/guidance', accept=lambda each: bool(each.points))
        assert guided.sentence.startswith('touch the bone') and np.isnan(guided.predicted_tre[0])
        place = shown['patch', 0].pose.position
        assert positions(guided.points) == pytest.approx(positions([place]))
        assert np.linalg.norm(positions(guided.normals)) == pytest.approx(1.0)
        assert guided.header.frame_id == shown['patch', 0].header.frame_id
    assert client.ask('clear').success
    if results.available():
        client.receive(guidance, '~/guidance', accept=lambda each: not each.points)
    client.receive(MarkerArray, '~/markers', accept=lambda array: ('patch', 0) not in marked(array))


def test_node_has_every_topic_and_service_of_the_layouts(tracker: Tracker) -> None:
    node = tracker.client.node
    ours = {topic: settings for topic, settings in rviz_topics().items()
            if topic.startswith('/registration/')}
    for topic, settings in ours.items():
        tracker.client.spin_until(lambda topic=topic: node.get_publishers_info_by_topic(topic),
                                  f'{topic} has no publisher')
        publisher, = node.get_publishers_info_by_topic(topic)
        assert (publisher.node_name, publisher.topic_type) == ('registration', settings['message'])
        latched = publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        assert latched is (topic in LATCHED), topic
    for topic in rviz_topics().keys() - ours.keys():
        assert node.get_subscriptions_info_by_topic(topic)
    panels = FOXGLOVE['configById']
    shown = {panels[panel].get('topicPath', '').rpartition('.')[0] or panels[panel]['topicToRender']
            for panel in panels if panel.startswith(('RawMessages', 'Diagnostic'))}
    assert shown <= {topic for topic, _ in node.get_topic_names_and_types()}
    called = {panel['serviceName'] for panel in panels.values() if 'serviceName' in panel}
    if not results.available():
        called = {name for name in called if described_services()[name].startswith('std_srvs/')}
    assert called <= {service for service, _ in node.get_service_names_and_types()}
