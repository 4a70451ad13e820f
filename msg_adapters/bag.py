# SPDX-License-Identifier: Apache-2.0
"""Read probe tip, reference array, frames and events from recordings of ROS, without ROS."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.result import InputError
from msg_adapters import stamps
from msg_adapters.bag_storage import BagFiles, Raw, Topic
from msg_adapters.motion import (
    INVALID_TRANSFORM,
    POINT,
    TOOL_POSES,
    to_matrix,
    tool_pose,
)
from msg_adapters.recorded_events import (
    STATUS,
    Order,
    decoded_events,
    events_source,
    node_order,
    settings_of,
)
from msg_adapters.recording import RecordedEvent, RecordedTransform, Recording
from msg_adapters.recording_notes import stamp_notes
from msg_adapters.service_events import TYPES_OF_EVENTS, read_service_events, service_topics

TF = 'tf2_msgs/msg/TFMessage'
FRAMES = {'/tf': False, '/tf_static': True}     # whether a transform is valid for all times
TIP_TOPIC = '/probe/tip'
# the stationary tip at landmarks, not points of the scan
LANDMARK_TOPIC = '/probe/landmarks'
# poses that a node of this package publishes or receives: no tools
OUTPUTS = ('bone_pose', 'bone_pose_with_covariance', 'live_pose', 'initial_pose')
TYPES = get_typestore(Stores.ROS2_JAZZY)


def list_topics(path: str | os.PathLike[str]) -> list[Topic]:
    """
    Return the topics of a bag with message type and number of messages.

    Raises
    ------
    InputError
        If the bag is missing or cannot be read.

    """
    return BagFiles(path).topics()


def read_bag(path: str | os.PathLike[str], topics: Sequence[str] | None = None,
             reference: str = '', frames: bool = False, events: str | None = '') -> Recording:
    """
    Read positions from a recording (rosbag2 with mcap or sqlite3, or ROS 1) as they were received.

    Parameters
    ----------
    path : path
        Directory of the bag, or one of its storage files.
    topics : sequence of str, optional
        PointStamped topics, or topics with poses of a tool, see `TOOL_POSES`. The default is
        /probe/tip, or the only PointStamped topic other than /probe/landmarks, or the only topic
        with poses other than ``reference`` and those that a node publishes.
    reference : str, optional
        Topic with the poses of the reference array, for `Recording.transforms`.
    frames : bool, optional
        Whether `Recording.transforms` also contains those of /tf and /tf_static.
    events : str, optional
        Topic or node with what the operator did, see `events_source`; None: the only one. The
        default is none. The topics of the probe and of the reference array are then those of the
        node, unless they are given.

    Returns
    -------
    Recording
        In m and s; the stamps are those of the headers, not the times of reception. With events
        the points are in the order in which the node received them.

    Raises
    ------
    InputError
        If the bag is missing, damaged or empty, or the topics are missing, ambiguous or of another
        type.

    """
    bag = BagFiles(path, (POINT, *TOOL_POSES, TF, STATUS, *TYPES_OF_EVENTS))
    types = {topic.name: topic.msgtype for topic in bag.topics()}
    source = events_source(types, events)
    services = None if not source or source in types else read_service_events(
        bag.messages(service_topics(source)), source)
    operator = _events(bag, source) if services is None else services.events
    used = settings_of(operator)
    if topics is None and set(used.get('probe.topics', ())) & set(types):
        topics = [name for name in used['probe.topics'] if name in types]
    reference = reference or used.get('reference.topic', '')
    names = _select_topics(bag.path, types, topics, reference)
    if reference and types.get(reference) not in TOOL_POSES:
        raise InputError(f'{path} has no poses of the reference array, PoseStamped on {reference} '
                         f'(reference.topic); it has {_listed(types)}')
    frames = frames or bool(used.get('probe.frame_id'))
    tf_topics = [name for name in FRAMES if frames and types.get(name) == TF]
    messages = bag.messages([*names, *([reference] if reference else []), *tf_topics])
    decoded = [decode_message(bag.path, i, raw) for i, raw in enumerate(messages)]
    if services is None:
        order = node_order([raw.topic for raw in messages], [_stamp(each) for each in decoded],
                           operator)
    else:
        order = Order(np.arange(len(messages)), np.searchsorted(
            [raw.received for raw in messages], services.received).tolist(), services.notes)
    messages = [messages[i] for i in order.rows]
    decoded = [decoded[i] for i in order.rows]
    is_point = [raw.topic in names for raw in messages]
    points = [raw for raw, use in zip(messages, is_point) if use]
    if not points:
        raise InputError(f'{path} has no messages on {", ".join(names)}')
    times, frame_ids, positions, tools = _arrays(
        points, [each for each, use in zip(decoded, is_point) if use])
    transforms, transforms_before = _transforms(messages, decoded, names)
    points_before = np.concatenate([[0], np.cumsum(is_point)])
    recording = Recording(
        positions=positions, stamps=times, frame_ids=frame_ids, source_names=names,
        sources=np.array([names.index(raw.topic) for raw in points], np.int32), tools=tools,
        transforms=transforms, complete=bag.complete,
        events=[RecordedEvent(int(points_before[row]), transforms_before[row], event)
                for row, event in zip(order.before, operator)])
    recording.notes = (*bag.notes, *order.notes, *stamp_notes(recording),
                       *_unused_array(types, names, reference))
    return recording


def _events(bag: BagFiles, topic: str) -> list[OperatorEvent]:
    """Return the events on a topic; none if it is empty."""
    if not topic:
        return []
    return decoded_events([decode_message(bag.path, i, raw)
                           for i, raw in enumerate(bag.messages([topic]))])


def _unused_array(types: dict[str, str], names: Sequence[str], reference: str) -> list[str]:
    """Return a sentence if the bag holds poses of an array that are not used."""
    others = [] if reference else [name for name, msgtype in types.items()
                                   if msgtype in TOOL_POSES and name not in names
                                   and not _is_output(name)]
    return [f'the recording holds {name} ({types[name].rpartition("/")[2]}): give --reference '
            f'{name} if the bone moved' for name in others]


def _is_output(topic: str) -> bool:
    """Return whether a node of this package publishes or receives the topic."""
    return topic.rpartition('/')[2] in OUTPUTS


def _select_topics(path: Path, types: dict[str, str], wanted: Sequence[str] | None,
                   reference: str) -> list[str]:
    """Return the topics to read; raise `InputError` with the available ones if there are none."""
    if wanted is None:
        points = [name for name, msgtype in types.items()
                  if msgtype == POINT and name != LANDMARK_TOPIC]
        tools = [name for name, msgtype in types.items()
                 if msgtype in TOOL_POSES and name != reference and not _is_output(name)]
        names = [TIP_TOPIC] if TIP_TOPIC in points + tools else points or tools
        if len(names) > 1:
            raise InputError(f'{path} has {len(names)} topics that could be the probe; choose with '
                             f'--topic: {_listed({name: types[name] for name in names})}')
        if not names:
            raise InputError(f'{path} has no topic with positions (PointStamped) or poses of a '
                             f'probe; it has {_listed(types)}; give --topic to choose one')
        return names
    names = list(dict.fromkeys(wanted))
    bad = [name for name in names if types.get(name) not in (POINT, *TOOL_POSES)]
    if bad or not names:
        raise InputError(f'{path} has no topic {", ".join(bad)} with positions (PointStamped) or '
                         f'poses of the probe; it has {_listed(types)}')
    return names


def _listed(types: dict[str, str]) -> str:
    return ', '.join(f'{name} ({msgtype})' for name, msgtype in types.items()) or 'no topics'


def _arrays(messages: list[Raw], decoded: list[Any]
            ) -> tuple[np.ndarray, list[str], np.ndarray, np.ndarray | None]:
    """
    Return stamps (n,) s, frame ids, positions (n, 3) m and poses (n, 7) of messages.

    A pose is NaN where a position was recorded; None if all are positions.
    """
    times = np.array([_stamp(message) for message in decoded])
    positions = np.zeros((len(messages), 3))
    tools = np.full((len(messages), 7), np.nan)
    for i, (raw, message) in enumerate(zip(messages, decoded)):
        if raw.msgtype == POINT:
            positions[i] = message.point.x, message.point.y, message.point.z
        else:
            tools[i] = tool_pose(message, raw.msgtype)
            positions[i] = tools[i, :3]
    has_tools = any(raw.msgtype != POINT for raw in messages)
    frames = [message.header.frame_id for message in decoded]
    return times, frames, positions, tools if has_tools else None


def _stamp(message: Any) -> float:
    """Return the stamp of the header, s; 0 if there is none, as in /tf."""
    if not hasattr(message, 'header'):
        return 0.0
    return stamps.to_seconds(message.header.stamp.sec, message.header.stamp.nanosec)


def decode_message(path: Path, i: int, raw: Raw) -> Any:
    """Deserialize message number ``i`` (from 0); raise `InputError` if it is damaged."""
    try:
        return TYPES.deserialize_cdr(raw.data, raw.msgtype)
    except Exception:  # damaged bytes can cause any exception in the decoder
        raise InputError(
            f'{path} is damaged: message {i + 1} on {raw.topic} cannot be decoded') from None


def _transforms(messages: list[Raw], decoded: list[Any], points: Sequence[str]
                ) -> tuple[list[RecordedTransform], list[int]]:
    """
    Return the transforms in the messages, with the number of ``points`` before each.

    The second list has the number of transforms before each message, and in all.
    """
    transforms, after, before = list[RecordedTransform](), 0, [0]
    for raw, message in zip(messages, decoded):
        if raw.topic in points:
            after += 1
        elif raw.topic in FRAMES:
            for each in message.transforms:
                motion = each.transform
                transforms.append(_transform(after, each.header, motion.translation,
                                             motion.rotation, each.child_frame_id,
                                             FRAMES[raw.topic]))
        else:
            transforms.append(_transform(after, message.header,
                                         *TOOL_POSES[raw.msgtype](message)))
        before.append(len(transforms))
    return transforms, before


def _transform(after: int, header: Any, position: Any, orientation: Any, child: str = '',
               fixed: bool = False) -> RecordedTransform:
    """Return a transform; its matrix is `INVALID_TRANSFORM` if it is not a rigid motion."""
    try:
        T = to_matrix(position, orientation)
    except InputError:
        T = INVALID_TRANSFORM
    stamp = stamps.to_seconds(header.stamp.sec, header.stamp.nanosec)
    return RecordedTransform(after, stamp, T, header.frame_id, child, fixed)
