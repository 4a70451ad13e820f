# SPDX-License-Identifier: Apache-2.0
"""What RViz and Foxglove are to show: files they can read, of topics that the node offers."""

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
# private topics of DESIGN that are to be seen, and how they are kept for who comes late
LATCHED = {'/registration/markers', '/registration/points',
           '/registration/bone_pose_with_covariance'}
PASSING = {'/registration/live_pose', *Config().probe.topics}
MESSAGES = {'MarkerArray': 'visualization_msgs/msg/MarkerArray',
            'PointCloud2': 'sensor_msgs/msg/PointCloud2',
            'PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped',
            'PointStamped': 'geometry_msgs/msg/PointStamped'}


def rviz_topics() -> dict[str, dict[str, str]]:
    """Return what RViz listens to, with the settings, and the message of the display."""
    return {display['Topic']['Value']: {
        **display['Topic'], 'message': MESSAGES[display['Class'].partition('/')[2]]}
        for display in RVIZ['Displays'] if 'Topic' in display}


def test_rviz_shows_all_there_is_to_be_seen_in_the_frame_of_the_bone() -> None:
    assert rviz_topics().keys() == LATCHED | PASSING
    assert RVIZ['Global Options']['Fixed Frame'] == Config().model.frame_id
    assert 'rviz_default_plugins/TF' in {display['Class'] for display in RVIZ['Displays']}
    assert all(display['Enabled'] is display['Value'] for display in RVIZ['Displays'])
    shown = {display['Name'] for display in RVIZ['Displays'] if display['Enabled']}
    assert {'Scene', 'Live pose', 'TF'} <= shown


def test_rviz_hears_what_was_said_before_it_came() -> None:
    for topic, settings in rviz_topics().items():
        durability = 'Transient Local' if topic in LATCHED else 'Volatile'
        reliability = 'Reliable' if topic in LATCHED else 'Best Effort'
        assert settings['Durability Policy'] == durability, topic
        assert settings['Reliability Policy'] == reliability, topic


def test_rviz_knows_the_namespaces_of_the_markers() -> None:
    scene = next(display for display in RVIZ['Displays'] if display['Name'] == 'Scene')
    none = np.zeros((0, 3))
    names = {marker.ns for marker in [*markers.bone(none, none, none), *markers.points(none, none),
                                      *markers.patches(none, none, 0.0, [], np.zeros(3))]}
    assert scene['Namespaces'] == dict.fromkeys(names, True)


def panels(layout: Any) -> list[str]:
    """Return the panels of a Foxglove layout in their places."""
    if isinstance(layout, str):
        return [layout]
    assert layout['direction'] in ('row', 'column') and 0 < layout['splitPercentage'] < 100
    return panels(layout['first']) + panels(layout['second'])


def test_foxglove_shows_all_there_is_to_be_seen_in_the_frame_of_the_bone() -> None:
    placed = panels(FOXGLOVE['layout'])
    assert sorted(placed) == sorted(FOXGLOVE['configById'])
    scene = FOXGLOVE['configById']['3D!scene']
    assert scene['followTf'] == Config().model.frame_id
    # its 3D panel draws no PointStamped
    assert scene['topics'].keys() == (LATCHED | PASSING) - set(Config().probe.topics)
    assert scene['topics']['/registration/markers']['visible']
    assert scene['topics']['/registration/live_pose']['visible']


def test_nothing_is_of_the_size_of_a_room() -> None:
    """Metres: a bone is some 0.3 m long, what stands on it a few millimetres."""
    sizes = [value for display in RVIZ['Displays'] for key, value in display.items()
             if key in ('Axes Length', 'Axes Radius', 'Radius', 'Size (m)', 'Shaft Length')]
    assert sizes and max(sizes) <= 0.1
    view, camera = RVIZ['Views']['Current'], FOXGLOVE['configById']['3D!scene']['cameraState']
    assert 0.2 < view['Distance'] < 1.0 and view['Near Clip Distance'] <= 0.02
    assert 0.2 < camera['distance'] < 1.0 and camera['near'] <= 0.02
