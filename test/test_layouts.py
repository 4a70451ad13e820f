# SPDX-License-Identifier: Apache-2.0
"""The layouts for RViz and Foxglove: valid files that show the topics of the node."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gsdf_registration.common.config import Config
from gsdf_registration.common.naming import centre_frame
from msg_adapters import markers

ROOT = Path(__file__).parents[1]
CONFIG, PAGE = ROOT / 'config', ROOT / 'docs/interface.md'
RED = '#b3120f'
RVIZ = yaml.safe_load((CONFIG / 'registration.rviz').read_text())['Visualization Manager']
FOXGLOVE = json.loads((CONFIG / 'foxglove_layout.json').read_text())
# topics of the node that a layout shows
LATCHED = {'/registration/markers', '/registration/points'}
VOLATILE = {'/registration/live_pose', '/registration/tip'}
CENTRE = centre_frame(Config().bone_frame)      # the frame that both layouts look at
MESSAGES = {'MarkerArray': 'visualization_msgs/msg/MarkerArray',
            'PointCloud2': 'sensor_msgs/msg/PointCloud2',
            'PoseWithCovariance': 'geometry_msgs/msg/PoseWithCovarianceStamped',
            'PointStamped': 'geometry_msgs/msg/PointStamped'}


def rviz_topics() -> dict[str, dict[str, str]]:
    """Return the topics that RViz subscribes to, with settings and the message type."""
    return {display['Topic']['Value']: {
        **display['Topic'], 'message': MESSAGES[display['Class'].partition('/')[2]]}
        for display in RVIZ['Displays'] if 'Topic' in display}


def test_rviz_shows_all_topics_and_looks_at_the_centre_of_the_bone() -> None:
    assert rviz_topics().keys() == LATCHED | VOLATILE
    assert RVIZ['Global Options']['Fixed Frame'] == CENTRE
    view = RVIZ['Views']['Current']
    assert view['Target Frame'] == '<Fixed Frame>'
    assert view['Focal Point'] == {'X': 0, 'Y': 0, 'Z': 0}
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


def test_rviz_draws_no_covariance_before_there_is_a_pose() -> None:
    """Until the first message, RViz draws it as a ball of 1 m that hides the bone."""
    poses = [display for display in RVIZ['Displays'] if 'Covariance' in display]
    assert [pose['Name'] for pose in poses] == ['Live pose']
    assert not any(pose['Covariance']['Value'] for pose in poses)


def test_rviz_hides_the_axes_inside_the_bone() -> None:
    frames = next(each for each in RVIZ['Displays'] if each['Name'] == 'TF')
    hidden = re.compile(frames['Filter (blacklist)'])
    assert all(hidden.search(centre_frame(bone)) for bone in (Config().bone_frame, 'femur_bone'))
    assert not any(map(hidden.search, (Config().bone_frame, 'tracker')))
    assert not frames['Show Names']     # white before a light background


def test_rviz_enables_the_namespaces_of_the_markers() -> None:
    scene = next(display for display in RVIZ['Displays'] if display['Name'] == 'Scene')
    none = np.zeros((0, 3))
    names = {marker.ns for marker in [*markers.bone(none, none, none), *markers.points(none, none),
                                      *markers.border(np.zeros((0, 2, 3)), np.zeros(3)),
                                      *markers.patches(none, none, 0.0, [], np.zeros(3))]}
    assert scene['Namespaces'] == dict.fromkeys(names, True)


def panels(layout: Any) -> list[str]:
    """Return the panels of a Foxglove layout in order, with those in tabs."""
    if isinstance(layout, str):
        tabs = FOXGLOVE['configById'][layout].get('tabs', [])
        return [layout, *(panel for tab in tabs for panel in panels(tab['layout']))]
    assert layout['direction'] in ('row', 'column') and 0 < layout['splitPercentage'] < 100
    return panels(layout['first']) + panels(layout['second'])


def described_services() -> dict[str, str]:
    """Return the type of every service of the node, from docs/interface.md, which is tested."""
    rows = re.findall(r'^\| srv \| `~/(\S+)` \| (\S+) ', PAGE.read_text(), re.MULTILINE)
    return {f'/registration/{name}': kind for name, kind in rows}


def test_foxglove_has_a_button_for_every_service() -> None:
    calls = [panel for panel in FOXGLOVE['configById'].values() if 'serviceName' in panel]
    services = described_services()
    assert len(services) > 10 and {call['serviceName'] for call in calls} == services.keys()
    assert len({(call['serviceName'], call['requestPayload']) for call in calls}) == len(calls)
    fields = {'std_srvs/Trigger': set(), 'std_srvs/SetBool': {'data'}}
    for call in calls:
        name, kind = call['serviceName'], services[call['serviceName']]
        request = fields.get(kind) if kind in fields else request_fields(kind)
        assert json.loads(call['requestPayload']).keys() <= request, name
        assert call['buttonText'] and call['buttonTooltip'] and call['timeoutSeconds'] >= 10
        drops_points = name.endswith(('/load', '/clear', '/drop_stroke'))
        assert (call.get('buttonColor') == RED) is drops_points, name
    pressed = [call['requestPayload'] for call in calls if call['serviceName'].endswith('/collect')]
    assert [json.loads(payload) for payload in pressed] == [{'data': True}, {'data': False}]


def test_foxglove_shows_the_buttons_without_scrolling() -> None:
    """A panel of a service is a request, a response and, below both, the button."""
    calls = {key for key, panel in FOXGLOVE['configById'].items() if 'serviceName' in panel}
    assert all(FOXGLOVE['configById'][call]['layout'] == 'horizontal' for call in calls)
    bottom = FOXGLOVE['layout']
    assert (bottom['direction'], bottom['second']) == ('column', 'Tab!services')
    assert 22 <= 100 - bottom['splitPercentage'] <= 33      # 200 px of a window of 900
    for tab in FOXGLOVE['configById']['Tab!services']['tabs']:
        widths = shares(tab['layout'])      # in one row
        assert len(widths) <= 6 and max(widths) - min(widths) < 2, tab['title']


def shares(layout: Any) -> list[float]:
    """Return the widths of the panels in a row, in percent."""
    if isinstance(layout, str):
        return [100]
    assert layout['direction'] == 'row'
    first = layout['splitPercentage']
    return [*(width * first / 100 for width in shares(layout['first'])),
            *(width * (100 - first) / 100 for width in shares(layout['second']))]


def test_the_panels_have_the_same_titles_in_lichtblick() -> None:
    for panel in FOXGLOVE['configById'].values():
        assert panel.get('lichtblickPanelTitle') == panel.get('foxglovePanelTitle')


def request_fields(kind: str) -> set[str]:
    """Return the fields of the request of a service of gsdf_registration_msgs."""
    package, name = kind.split('/')
    request = (ROOT / package / f'srv/{name}.srv').read_text().split('---')[0]
    return set(re.findall(r'^[a-z]\S* +(\w+)', request, re.MULTILINE | re.IGNORECASE))


def test_foxglove_shows_all_topics_and_looks_at_the_centre_of_the_bone() -> None:
    placed = panels(FOXGLOVE['layout'])
    assert sorted(placed) == sorted(FOXGLOVE['configById'])
    scene = FOXGLOVE['configById']['3D!scene']
    assert (scene['followTf'], scene['followMode']) == (CENTRE, 'follow-pose')
    assert scene['cameraState']['target'] == scene['cameraState']['targetOffset'] == [0, 0, 0]
    # the 3D panel does not draw PointStamped
    assert scene['topics'].keys() == {'/registration/bone_pose_with_covariance',
                                      *LATCHED, *VOLATILE} - {'/registration/tip'}
    assert scene['topics']['/registration/markers']['visible']
    # before a registration no transform leads to the frame of the live pose: the panel would report
    # an error as long as points are collected
    assert not scene['topics']['/registration/live_pose']['visible']
    assert not scene['transforms'][f'frame:{CENTRE}']['visible']    # its axes are inside the bone


def test_sizes_suit_a_bone() -> None:
    """A bone is about 0.3 m long, the markers on it a few millimetres; all sizes are in m."""
    sizes = [value for display in RVIZ['Displays'] for key, value in display.items()
             if key in ('Axes Length', 'Axes Radius', 'Radius', 'Size (m)', 'Shaft Length')]
    assert sizes and max(sizes) <= 0.1
    view, camera = RVIZ['Views']['Current'], FOXGLOVE['configById']['3D!scene']['cameraState']
    for distance, near in ((view['Distance'], view['Near Clip Distance']),
                           (camera['distance'], camera['near'])):
        # a whole femur, 0.46 m, fits in the view, 45 degrees high in both
        assert 0.46 < 2.0 * distance * np.tan(np.pi / 8.0) < 0.7 and near <= 0.02
