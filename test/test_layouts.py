# SPDX-License-Identifier: Apache-2.0
"""The layouts for RViz and Foxglove: valid files that show the topics of the node."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gsdf_registration.common.config import Config
from msg_adapters import markers

CONFIG = Path(__file__).parents[1] / 'config'
RVIZ = yaml.safe_load((CONFIG / 'registration.rviz').read_text())['Visualization Manager']
FOXGLOVE = json.loads((CONFIG / 'foxglove_layout.json').read_text())
# topics of the node that a layout shows
LATCHED = {'/registration/markers', '/registration/points',
           '/registration/bone_pose_with_covariance'}
VOLATILE = {'/registration/live_pose', *Config().probe.topics}
MESSAGES = {'MarkerArray': 'visualization_msgs/msg/MarkerArray',
            'PointCloud2': 'sensor_msgs/msg/PointCloud2',
            'PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped',
            'PointStamped': 'geometry_msgs/msg/PointStamped'}


def rviz_topics() -> dict[str, dict[str, str]]:
    """Return the topics that RViz subscribes to, with settings and the message type."""
    return {display['Topic']['Value']: {
        **display['Topic'], 'message': MESSAGES[display['Class'].partition('/')[2]]}
        for display in RVIZ['Displays'] if 'Topic' in display}


def test_rviz_shows_all_topics_in_the_bone_frame() -> None:
    assert rviz_topics().keys() == LATCHED | VOLATILE
    assert RVIZ['Global Options']['Fixed Frame'] == Config().bone_frame
    assert 'rviz_default_plugins/TF' in {display['Class'] for display in RVIZ['Displays']}
    assert all(display['Enabled'] is display['Value'] for display in RVIZ['Displays'])
    shown = {display['Name'] for display in RVIZ['Displays'] if display['Enabled']}
    assert {'Scene', 'Live pose', 'TF'} <= shown


def test_rviz_subscribes_with_the_qos_of_each_topic() -> None:
    for topic, settings in rviz_topics().items():
        durability = 'Transient Local' if topic in LATCHED else 'Volatile'
        reliability = 'Reliable' if topic in LATCHED else 'Best Effort'
        assert settings['Durability Policy'] == durability, topic
        assert settings['Reliability Policy'] == reliability, topic


def test_rviz_enables_the_namespaces_of_the_markers() -> None:
    scene = next(display for display in RVIZ['Displays'] if display['Name'] == 'Scene')
    none = np.zeros((0, 3))
    names = {marker.ns for marker in [*markers.bone(none, none, none), *markers.points(none, none),
                                      *markers.patches(none, none, 0.0, [], np.zeros(3))]}
    assert scene['Namespaces'] == dict.fromkeys(names, True)


def panels(layout: Any) -> list[str]:
    """Return the panels of a Foxglove layout in order."""
    if isinstance(layout, str):
        return [layout]
    assert layout['direction'] in ('row', 'column') and 0 < layout['splitPercentage'] < 100
    return panels(layout['first']) + panels(layout['second'])


def test_foxglove_shows_all_topics_in_the_bone_frame() -> None:
    placed = panels(FOXGLOVE['layout'])
    assert sorted(placed) == sorted(FOXGLOVE['configById'])
    scene = FOXGLOVE['configById']['3D!scene']
    assert scene['followTf'] == Config().bone_frame
    # the 3D panel does not draw PointStamped
    assert scene['topics'].keys() == (LATCHED | VOLATILE) - set(Config().probe.topics)
    assert scene['topics']['/registration/markers']['visible']
    assert scene['topics']['/registration/live_pose']['visible']


def test_sizes_suit_a_bone() -> None:
    """A bone is about 0.3 m long, the markers on it a few millimetres; all sizes are in m."""
    sizes = [value for display in RVIZ['Displays'] for key, value in display.items()
             if key in ('Axes Length', 'Axes Radius', 'Radius', 'Size (m)', 'Shaft Length')]
    assert sizes and max(sizes) <= 0.1
    view, camera = RVIZ['Views']['Current'], FOXGLOVE['configById']['3D!scene']['cameraState']
    assert 0.2 < view['Distance'] < 1.0 and view['Near Clip Distance'] <= 0.02
    assert 0.2 < camera['distance'] < 1.0 and camera['near'] <= 0.02
