# SPDX-License-Identifier: Apache-2.0
"""
Write docs/interface.md from the code and from a running node.

Run ``python docs/interface.py`` after a change of a topic, a service, a status value or a
parameter; a test fails until then.
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

from gsdf_registration.clients.domain import private_domain
from gsdf_registration.clients.operator import Operator
from gsdf_registration.common.config import settings
from gsdf_registration.common.result import Reason
from gsdf_registration.common.settings_schema import default_value
from gsdf_registration.node.parameters import parameter_type
from gsdf_registration.node.services import Services
from msg_adapters import results

ROOT = Path(__file__).parents[1]
PAGE = ROOT / 'docs/interface.md'

# Parameters with which the node subscribes to everything it can
PARAMETERS = {'probe.topics': "['/probe/tip']", 'probe.frame_id': 'tracker',
              'reference.topic': '/reference/pose'}
SUBSCRIBED = {
    '/probe/tip': 'each of `probe.topics`, best effort or reliable: positions of the tip, or '
                  'poses of the tool as PoseStamped, PoseWithCovarianceStamped or '
                  'TransformStamped, whichever is published (`probe.type`); for poses see '
                  '`probe.tip`',
    '/reference/pose': 'pose of the reference array: `reference.topic`, if set; points are '
                       'transformed into its frame at their own stamp',
    '/tf': 'for points in a frame other than `probe.frame_id`, if that is set',
    '/tf_static': 'as `/tf`',
    '~/initial_pose': 'approximate pose of the bone in the frame of the points, searched around '
                      'first by `~/register` and by the live pose until a registration is accepted '
                      'or the session is cleared; stamp and covariance are not used; in another '
                      'frame, not finite or without a unit quaternion it is rejected, see '
                      '`~/status`',
}
PUBLISHED = {
    '~/bone_pose': 'the accepted registration, stamped as the newest point used',
    '~/bone_pose_with_covariance': 'the same with its covariance (REP-103 order, m and rad)',
    '~/live_pose': 'the current estimate, for every point once the estimate is reliable, stamped '
                   'as the newest point used',
    '~/tip': 'the tip in the frame of the points, for displays; published while it is subscribed',
    '~/result': 'the accepted registration with its accuracy, strokes and landmarks; `valid` '
                'false: there is no pose, or it is withdrawn, with the reason',
    '~/guidance': 'places to touch next, best first; none: no touch is proposed',
    '~/status': 'state, points kept and rejected by cause, reason, what to do next; on change',
    '/diagnostics': 'the same every second',
    '~/events': 'what the operator did, for replays: one message a service call with its answer, '
                'and one a change of parameters, model or state; the last 2000 are kept for late '
                'joiners; see [recordings](recordings.md)',
    '~/points': 'collected points in the bone frame: x y z residual weight stroke',
    '~/markers': 'the bone coloured by the error (95 %) with the border of the zone, the points '
                 'by residual, the next place to touch',
    '/tf': 'frame of the points → `model.frame_id`, re-sent at `tf.rate`, stamped as it is sent; '
           'never on `/tf_static`',
    '/tf_static': '`model.frame_id` → `bone_centre` (`model.frame_id` with `_centre` added): the '
                  'centre of the box around the bone, which displays follow; sent when a bone is '
                  'loaded and the node is active',
}
# Only with gsdf_registration_msgs
TYPED_TOPICS = ('~/result', '~/guidance')
TYPED_SERVICES = {
    'typed/register': 'as `~/register`, from the initial pose of the request if it is used; '
                      'answers with the result of this attempt',
    'typed/verify': 'as `~/verify`; answers with the distance, the checkpoint and how far it moved',
    'typed/capture_landmark': 'as `~/capture_landmark`; answers with the position, its spread and '
                              'what remains',
    'drop_stroke': 'drop any stroke, as `~/undo` drops the last',
}
STATUS = {
    'stamp': 'time of the message on the clock of the node, s, as text with nine decimals',
    'state': '`no_model`, `idle`, `collecting`, `ready`, `solving`, `registered` or `refused`',
    'received': 'samples received',
    'kept': 'points kept',
    'collecting': '`true` while points are kept, else `false`',
    'strokes': 'strokes that contain points',
    'landmarks': 'captured landmarks',
    'frame_id': 'frame of the points; empty until the first one',
    'reason': 'of the last registration, see below; empty before',
    'progress': 'share of a registration, or of compiling and loading, that is done, 0 to 1, at '
                'most five times a second; empty while none runs',
    'rejected.*': 'samples rejected, by cause',
    'pose': '`none`, or `in` the frame of the accepted registration',
    'withdrawn': 'why the last pose is withdrawn, see [pose_lifetime.md](pose_lifetime.md); empty '
                 'if there was none',
    'calibration': '`calibrate_tip` or `find_joint_centre` while that runs; else empty',
    'calibration.poses': 'poses received since its start; absent while none runs',
    'calibration.angle_deg': 'largest rotation since its start, degrees; absent while none runs',
    'used': 'points used by the accepted registration',
    'inliers': 'points among them that lie on the bone',
    'left_out.*': 'points collected but not used by it, by cause',
    'predicted_tre_m.*': 'expected error at each target, over the bone (`rms`) and its maximum '
                         '(`max`), m',
    'grade': 'of the accepted registration: `A` or `B`, see [accuracy.md](accuracy.md)',
    'zone.*': 'where the pose is accurate: `limit_m`, `distance_m` from the touched points, '
              '`bone_share`, and the 95 % error `touched_p95_m` within 100 mm of them, '
              '`bone_p95_m` on the bone and `p95_m.` at each target, m',
    'sigma_m': 'noise of the points along the surface normal, m',
    'runner_up_ratio': 'cost of the best alternative pose divided by the cost of the pose',
    'weakest_direction': 'the least constrained motion, a sentence',
    'touch_next': 'where to touch next, a sentence',
    'live.points': 'points used by the live pose',
    'live.reason': 'why the live pose cannot be registered yet; empty if it can',
    'live.predicted_tre_m.*': 'as above, of the live pose, m',
    'stroke.*': 'how many points of each stroke lie on the bone, a sentence',
    'landmark_miss_m.*': 'distance of each touched landmark from its place on the registered bone, '
                         'm',
    'landmark.*': 'how each landmark with a standard deviation fits, a sentence',
    'verification': 'summary of all verification points, a sentence; absent without any',
    'verification_m.*': 'signed distance of each verification point from the registered surface, m',
}
REASONS = {
    Reason.CONVERGED: 'success; every other reason is a refusal',
    Reason.TOO_FEW_POINTS: 'drag the probe over the bone for longer',
    Reason.REGION_TOO_SMALL: 'drag the probe over more of the bone',
    Reason.UNDER_CONSTRAINED: 'the points do not constrain the pose; touch where the sentence says',
    Reason.AMBIGUOUS: 'several poses fit; touch where they differ, as the sentence says',
    Reason.TOO_FEW_INLIERS: 'most points are not on this bone: another bone, or a bent probe',
    Reason.MODEL_MISMATCH: 'the points fit no better than on another bone: wrong patient or side; '
                           'or most landmarks contradict them',
    Reason.NOT_CONVERGED: 'the solver did not converge; start from landmarks, or touch more',
    Reason.WRONG_UNIT: 'a length is a thousand times too large or too small: mm taken for m',
    Reason.BAD_INPUT: 'an input cannot be used; the sentence says which',
    Reason.NO_MODEL: 'no bone is loaded; set `model.path`',
}


class Row(NamedTuple):
    """A topic or service of the node."""

    kind: str       # sub, pub or srv
    name: str
    type: str
    quality: str
    meaning: str


def rows(operator: Operator, node: str) -> list[Row]:
    """Return the topics and services of ``node``, from the ROS graph."""
    graph, name = operator.node, node.strip('/')
    operator.spin_until(lambda: (name, '/') in graph.get_node_names_and_namespaces()
                        and subscribed_and_published(operator, node)[0] >= SUBSCRIBED.keys()
                        and subscribed_and_published(operator, node)[1] >= published_topics(),
                        'a topic in docs/interface.py is missing (is tf2_msgs installed?)')
    subscribed = dict(graph.get_subscriber_names_and_types_by_node(name, '/'))
    serving = dict(graph.get_service_names_and_types_by_node(name, '/'))
    published = dict(graph.get_publisher_names_and_types_by_node(name, '/'))
    table = []
    for topic in SUBSCRIBED:
        full = topic.replace('~', node)
        if full in subscribed:
            profile = _profile(graph.get_subscriptions_info_by_topic(full), name)
            table.append(_row('sub', topic, subscribed[full], _quality(profile), SUBSCRIBED[topic]))
    meanings = {name: _first_sentence(handler.__doc__) for name, handler in vars(Services).items()
                if f'{node}/{name}' in serving}
    for service, meaning in (meanings | TYPED_SERVICES).items():
        if f'{node}/{service}' in serving:
            table.append(_row('srv', f'~/{service}', serving[f'{node}/{service}'], '', meaning))
    for topic in PUBLISHED:
        full = topic.replace('~', node)
        if full in published:
            profile = _profile(graph.get_publishers_info_by_topic(full), name)
            table.append(_row('pub', topic, published[full], _quality(profile), PUBLISHED[topic]))
    return table


def published_topics() -> set[str]:
    """Return the topics that the node publishes in this installation."""
    return PUBLISHED.keys() - (() if results.available() else TYPED_TOPICS)


def untyped(text: str) -> str:
    """Return a page without the rows of gsdf_registration_msgs."""
    return '\n'.join(line for line in text.split('\n') if '| gsdf_registration_msgs/' not in line)


def subscribed_and_published(operator: Operator, node: str) -> tuple[set[str], set[str]]:
    """Return the topics of ``node``, without those of every lifecycle node."""
    graph, name = operator.node, node.strip('/')
    common = {'/rosout', '/parameter_events', '/clock', '~/transition_event'}
    subscribed, published = (
        {topic.replace(f'{node}/', '~/') for topic, _ in topics(name, '/')} - common
        for topics in (graph.get_subscriber_names_and_types_by_node,
                       graph.get_publisher_names_and_types_by_node))
    return subscribed, published


def described(value: str) -> str:
    """Return the entry of `STATUS` that describes a status value; empty if there is none."""
    return next((name for name in STATUS
                 if re.fullmatch(re.escape(name).replace(r'\*', '.+'), value)), '')


def page(table: list[Row]) -> str:
    """Return docs/interface.md."""
    return '\n'.join([
        '# The interface of the node', '',
        'Written by `python docs/interface.py` from the code and from a running node. `~` is the '
        "node's name, `/registration`. Metres, radians and seconds throughout (REP-103).", '',
        '## Topics and services', '',
        'Every lifecycle node also has `~/change_state` and related services, and the parameter '
        'services. Every service answers with success and one sentence, in every state of the '
        'node.', '',
        '| kind | name | type | quality | meaning |', '|---|---|---|---|---|',
        *(f'| {row.kind} | `{row.name}` | {row.type} | {row.quality} | {row.meaning} |'
          for row in table), '',
        'Latched: reliable, transient local, depth 1; late subscribers receive the last message.',
        '', 'Topics and services of gsdf_registration_msgs exist if that package is installed. The '
        'others stay the same without it. [pose_lifetime.md](pose_lifetime.md) says which of them '
        'are published after which event, and which time each message carries.',
        '', '## Status', '',
        'The message of `~/status` is for people, the values are for programs:', '',
        '| value | meaning |', '|---|---|',
        *(f'| `{name}` | {meaning} |' for name, meaning in STATUS.items()), '',
        'Reasons:', '', '| reason | what to do |', '|---|---|',
        *(f'| `{reason}` | {meaning} |' for reason, meaning in REASONS.items()), '',
        '## Parameters', '',
        'All parameters have a default; only `model.path` is required. They can be set while the '
        'node runs and take effect at once, except those marked *configure*: these are read when '
        'the node is configured, and a later change is rejected. A change of `model.path`, '
        '`model.unit` or `model.voxel_size` loads the bone beside the running session. Until it is '
        'loaded, and if it cannot be loaded, the current bone stays in use. Points stay; landmarks '
        'and targets belong to one bone: set those of the new bone in the same request, or they '
        'are dropped. The journal follows `session.path`. `collect.automatic` is read at '
        'activation. A request is applied or rejected as a whole, with a sentence. Set names and '
        'positions together, in one request of `~/set_parameters_atomically`:', '',
        '```', *_pair_example(), '```', '',
        '| parameter | type | default | range | meaning |', '|---|---|---|---|---|',
        *_parameters(), ''])


def _row(kind: str, name: str, types: list[str], quality: str, meaning: str) -> Row:
    short = types[0].replace('/msg/', '/').replace('/srv/', '/')
    return Row(kind, name, short, quality, meaning)


def _profile(infos: Sequence[TopicEndpointInfo], node: str) -> QoSProfile:
    """Return the QoS profile of the endpoint of ``node`` on a topic."""
    return next(info for info in infos if info.node_name == node).qos_profile


def _quality(profile: QoSProfile) -> str:
    """Return the reliability of a topic in words."""
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
        default = default_value(setting)
        shown = f'`{default}`' if default != '' else ''
        if isinstance(default, float):
            shown = f'`{default:g}`'
        mark = '; *configure*' if about['fixed'] else ''
        meaning = about['description'].replace('|', '\\|') + (f' [{unit}]' if unit else '') + mark
        yield f'| `{name}` | {kind} | {shown} | {bounds} | {meaning} |'
    yield ('| `autostart` | bool | `True` |  | become active without a lifecycle manager; '
           'read at start only |')
    yield ('| `service_configure_introspection` | string | `disabled` | `disabled`, `metadata`, '
           '`contents` | whether requests and responses are published on '
           '`<service>/_service_event` |')


def main() -> int:
    """Start a node, inspect it and write the page."""
    from gsdf_registration.cli.demo import running
    with private_domain() as environment, tempfile.TemporaryDirectory() as folder:
        os.environ.update(environment)
        given = PARAMETERS | {'session.path': f'{folder}/session.json'}
        words = [word for name, value in given.items() for word in ('-p', f'{name}:={value}')]
        command = [sys.executable, '-m', 'gsdf_registration.node.main', '--ros-args', *words]
        with running(command, 'the node') as node, Operator(
                patience=60.0, alive=lambda: node.poll() is None) as operator:
            operator.spin_until(lambda: operator.state() == 'active', 'the node is not active')
            table = rows(operator, '/registration')
    PAGE.write_text(page(table))
    return 0


if __name__ == '__main__':
    sys.exit(main())
