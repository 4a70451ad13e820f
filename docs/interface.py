# SPDX-License-Identifier: Apache-2.0
"""
Writes docs/interface.md, and the table in README.md, from the code and from a running node.

``python docs/interface.py`` after a topic, a service, a value of the status or a setting has
changed; a test fails until then.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from gsdf_registration.clients.domain import own_domain
from gsdf_registration.clients.operator import Operator
from gsdf_registration.common.config import settings
from gsdf_registration.common.result import Reason
from gsdf_registration.common.settings_schema import default_of
from gsdf_registration.node.parameters import parameter_type
from gsdf_registration.node.services import Services

ROOT = Path(__file__).parents[1]
PAGE = ROOT / 'docs/interface.md'
README = ROOT / 'README.md'
BEGIN, END = '<!-- written by docs/interface.py -->', '<!-- end of what it writes -->'

# Parameters of the node that is looked at: those that make it hear all it can hear
PARAMETERS = {'probe.topics': "['/probe/tip']", 'probe.frame_id': 'tracker',
              'reference.topic': '/reference/pose'}
HEARD = {
    '/probe/tip': 'tip of the probe: each of `probe.topics`, best effort or reliable',
    '/reference/pose': 'the array on the bone: `reference.topic`, if set; points are carried into '
                       'its frame at their own stamp',
    '/tf': 'for points in another frame than `probe.frame_id`, if that is set',
    '/tf_static': 'as `/tf`',
}
SAID = {
    '~/bone_pose': 'the last good pose',
    '~/bone_pose_with_covariance': 'the same with its covariance (REP-103 order, m and rad)',
    '~/live_pose': 'the present estimate, for every point that comes in once there is one to be '
                   'trusted; stamped as the point',
    '~/status': 'state, points kept and refused by cause, reason, what to do next; on change',
    '/diagnostics': 'the same every second',
    '~/points': 'collected points in the bone frame: x y z residual weight stroke',
    '~/markers': 'the bone coloured by the error to expect, the points by residual, where to touch',
    '/tf': 'frame of the points → `model.frame_id`, re-sent at `tf.rate`; never on `/tf_static`',
}
STATUS = {
    'state': '`no_model`, `idle`, `collecting`, `ready`, `solving`, `registered` or `refused`',
    'received': 'points that have come in',
    'kept': 'points held',
    'strokes': 'strokes that hold points',
    'landmarks': 'landmarks captured',
    'frame_id': 'frame of the points; empty until the first one',
    'reason': 'of the last registration, see below; empty before',
    'rejected.*': 'points not kept, by cause',
    'pose': '`none`, or `in` the frame of the last good pose',
    'used': 'points that the last good pose was solved from',
    'inliers': 'those of them that bear it',
    'predicted_tre_m.*': 'error to expect at each target, over the bone (`rms`) and at worst '
                         '(`max`), m',
    'sigma_m': 'noise of the points along the surface normal, m',
    'runner_up_ratio': 'how much worse the next-best pose fits',
    'weakest_direction': 'the motion that the points hold least, a sentence',
    'touch_next': 'where a touch would help most, a sentence',
    'live.points': 'points that the live pose was found from',
    'live.reason': 'what the live pose still lacks; empty if nothing',
    'live.predicted_tre_m.*': 'as above, of the live pose, m',
    'stroke.*': 'what each stroke is worth, a sentence',
    'landmark_miss_m.*': 'how far each landmark was touched from its place on the registered bone, '
                         'm',
    'verification': 'all verification points at a glance, a sentence; not there without any',
}
REASONS = {
    Reason.CONVERGED: 'there is a pose; all else is a refusal',
    Reason.TOO_FEW_POINTS: 'drag the probe over the bone for longer',
    Reason.REGION_TOO_SMALL: 'drag it over more of the bone',
    Reason.UNDER_CONSTRAINED: 'the points leave a motion open; touch where the sentence says',
    Reason.AMBIGUOUS: 'several poses fit; touch where they differ, as the sentence says',
    Reason.TOO_FEW_INLIERS: 'most points are not on this bone: another bone, or a bent probe',
    Reason.MODEL_MISMATCH: 'the points fit no better than on another bone: wrong patient or side',
    Reason.NOT_CONVERGED: 'no pose was settled on; start from landmarks, or touch more',
    Reason.WRONG_UNIT: 'a length is a thousand times off: mm taken for m',
    Reason.BAD_INPUT: 'something given cannot be used; the sentence says what',
    Reason.NO_MODEL: 'there is no bone; set `model.path`',
}


class Row(NamedTuple):
    """A topic or service of the node."""

    kind: str       # sub, pub or srv
    name: str
    type: str
    quality: str
    meaning: str


def rows(operator: Operator, node: str) -> list[Row]:
    """Return what ``node`` hears, serves and says, as the ROS graph tells it."""
    graph, name = operator.node, node.strip('/')
    operator.spin_until(lambda: (name, '/') in graph.get_node_names_and_namespaces()
                        and heard_and_said(operator, node)[0] >= HEARD.keys()
                        and heard_and_said(operator, node)[1] >= SAID.keys(),
                        'a topic described in docs/interface.py is not there (is tf2_msgs?)')
    heard = dict(graph.get_subscriber_names_and_types_by_node(name, '/'))
    serving = dict(graph.get_service_names_and_types_by_node(name, '/'))
    said = dict(graph.get_publisher_names_and_types_by_node(name, '/'))
    table = []
    for topic in HEARD:
        if topic in heard:
            profile = _profile(graph.get_subscriptions_info_by_topic(topic), name)
            table.append(_row('sub', topic, heard[topic], _quality(profile), HEARD[topic]))
    for service, handler in vars(Services).items():
        if f'{node}/{service}' in serving:
            table.append(_row('srv', f'~/{service}', serving[f'{node}/{service}'], '',
                              _first_sentence(handler.__doc__)))
    for topic in SAID:
        full = topic.replace('~', node)
        if full in said:
            profile = _profile(graph.get_publishers_info_by_topic(full), name)
            table.append(_row('pub', topic, said[full], _quality(profile), SAID[topic]))
    return table


def heard_and_said(operator: Operator, node: str) -> tuple[set[str], set[str]]:
    """Return the topics that ``node`` hears and says, but for those every lifecycle node has."""
    graph, name = operator.node, node.strip('/')
    common = {'/rosout', '/parameter_events', '/clock', '~/transition_event'}
    heard, said = ({topic.replace(f'{node}/', '~/') for topic, _ in topics(name, '/')} - common
                   for topics in (graph.get_subscriber_names_and_types_by_node,
                                  graph.get_publisher_names_and_types_by_node))
    return heard, said


def described(value: str) -> str:
    """Return the name by which a value of the status is described; empty if nobody has."""
    return next((name for name in STATUS
                 if re.fullmatch(re.escape(name).replace(r'\*', '.+'), value)), '')


def page(table: list[Row]) -> str:
    """Return docs/interface.md."""
    return '\n'.join([
        '# The interface of the node', '',
        'Written by `python docs/interface.py` from the code and from a running node. `~` is the '
        "node's name, `/registration`. Metres, radians and seconds throughout (REP-103).", '',
        '## Topics and services', '',
        'Beside these there is what every lifecycle node has: `~/change_state` and its like, and '
        'the services of parameters. Every service answers with success and one plain sentence, '
        'in every state of the node.', '',
        '| kind | name | type | quality | meaning |', '|---|---|---|---|---|',
        *(f'| {row.kind} | `{row.name}` | {row.type} | {row.quality} | {row.meaning} |'
          for row in table), '',
        'Latched: reliable, transient local, depth 1; one who joins late hears the last message.',
        '', '## Status', '',
        'The message of `~/status` is for people, its values are for programs:', '',
        '| value | meaning |', '|---|---|',
        *(f'| `{name}` | {meaning} |' for name, meaning in STATUS.items()), '',
        'Reasons:', '', '| reason | what to do |', '|---|---|',
        *(f'| `{reason}` | {meaning} |' for reason, meaning in REASONS.items()), '',
        '## Parameters', '',
        'All have a default; you need to give none but `model.path`. All can be set while the node '
        'runs and take effect at once, but for those marked *configure*, which are read when the '
        'node is configured and refused otherwise. A change of `model.path`, `model.unit` or '
        '`model.voxel_size` loads the bone beside the running session: until it is there, and if '
        'it cannot be had, the one in use is kept. Points stay; landmarks and targets are those of '
        'one bone: name those of the other in the same request, or they are dropped. With '
        '`session.path` the journal goes along. `collect.automatic` counts at activation. A '
        'request is carried out as a whole or refused as a whole with a sentence. Names and '
        'positions change together, in one request of `~/set_parameters_atomically`:', '',
        '```', *_pair_example(), '```', '',
        '| parameter | type | default | range | meaning |', '|---|---|---|---|---|',
        *_parameters(), ''])


def readme_table(table: list[Row]) -> str:
    """Return the table in README.md."""
    return '\n'.join(['| kind | name | type | meaning |', '|---|---|---|---|',
                      *(f'| {row.kind} | `{row.name}` | {row.type} | {row.meaning} |'
                        for row in table)])


def with_table(readme: str, table: list[Row]) -> str:
    """Return README.md with its table as it must be."""
    head, _, rest = readme.partition(BEGIN)
    _, _, tail = rest.partition(END)
    return f'{head}{BEGIN}\n{readme_table(table)}\n{END}{tail}'


def _row(kind: str, name: str, types: list[str], quality: str, meaning: str) -> Row:
    short = types[0].replace('/msg/', '/').replace('/srv/', '/')
    return Row(kind, name, short, quality, meaning)


def _profile(infos: Sequence[TopicEndpointInfo], node: str) -> QoSProfile:
    """Return the quality of the endpoint of ``node`` among those of a topic."""
    return next(info for info in infos if info.node_name == node).qos_profile


def _quality(profile: QoSProfile) -> str:
    """Return in words how reliably a topic is carried."""
    reliable = profile.reliability == ReliabilityPolicy.RELIABLE
    if reliable and profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        return 'latched'
    return 'reliable' if reliable else 'best effort'


def _first_sentence(doc: str) -> str:
    """Return the first sentence of a docstring as the meaning of a row."""
    words = ' '.join(doc.split('\n\n')[0].split()).rstrip('.').replace('``', '`')
    return words[0].lower() + words[1:]


def _pair_example() -> Iterator[str]:
    yield 'ros2 service call /registration/set_parameters_atomically \\'
    yield '    rcl_interfaces/srv/SetParametersAtomically "{parameters: ['
    yield '    {name: targets.names, value: {type: 9, string_array_value: [notch]}},'
    yield ('    {name: targets.positions, value: {type: 8, double_array_value: [0.0, 0.01, 0.02]}}'
           ']}"')


def _parameters() -> Iterator[str]:
    for name, setting in settings():
        about = setting.metadata
        kind = parameter_type(setting).name.lower().replace('_array', ' list')
        low, high, unit = about['low'], about['high'], about['unit']
        bounds = '' if low is None else f'{low:g} to {high:g}'
        if about['choices']:
            bounds = ', '.join(f'`{choice}`' for choice in about['choices'])
        default = default_of(setting)
        shown = f'`{default}`' if default != '' else ''
        if isinstance(default, float):
            shown = f'`{default:g}`'
        mark = '; *configure*' if about['fixed'] else ''
        meaning = about['description'].replace('|', '\\|') + (f' [{unit}]' if unit else '') + mark
        yield f'| `{name}` | {kind} | {shown} | {bounds} | {meaning} |'
    yield ('| `autostart` | bool | `True` |  | become active without a lifecycle manager; '
           'given at the start only |')


def main() -> int:
    """Look at a node and write both."""
    from gsdf_registration.cli.demo import running
    with own_domain() as environment, tempfile.TemporaryDirectory() as folder:
        os.environ.update(environment)
        given = PARAMETERS | {'session.path': f'{folder}/session.json'}
        words = [word for name, value in given.items() for word in ('-p', f'{name}:={value}')]
        command = [sys.executable, '-m', 'gsdf_registration.node.main', '--ros-args', *words]
        with running(command, 'the node') as node, Operator(
                patience=60.0, alive=lambda: node.poll() is None) as operator:
            operator.spin_until(lambda: operator.state() == 'active', 'the node is not active')
            table = rows(operator, '/registration')
    PAGE.write_text(page(table))
    README.write_text(with_table(README.read_text(), table))
    return 0


if __name__ == '__main__':
    sys.exit(main())
