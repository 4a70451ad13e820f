# SPDX-License-Identifier: Apache-2.0
"""Read the probe tip, the reference array and frames from rosbag2 recordings, without ROS."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from gsdf_registration.common.result import InputError
from msg_adapters import stamps
from msg_adapters.bag_storage import BagFiles, Raw, Topic
from msg_adapters.motion import INVALID_TRANSFORM, TOOL_POSES, to_matrix, tool_pose
from msg_adapters.recording import RecordedTransform, Recording

POINT = 'geometry_msgs/msg/PointStamped'
POSE = 'geometry_msgs/msg/PoseStamped'
TF = 'tf2_msgs/msg/TFMessage'
FRAMES = {'/tf': False, '/tf_static': True}     # whether a transform is valid for all times
TIP_TOPIC = '/probe/tip'
# the stationary tip at landmarks, not points of the scan
LANDMARK_TOPIC = '/probe/landmarks'
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
             reference: str = '', frames: bool = False) -> Recording:
    """
    Read positions from a rosbag2 recording (mcap or sqlite3 storage) in the order received.

    Parameters
    ----------
    path : path
        Directory of the bag, or one of its storage files.
    topics : sequence of str, optional
        PointStamped topics, or topics with poses of a tool, see `TOOL_POSES`. The default is
        /probe/tip, or the only PointStamped topic other than /probe/landmarks, or the only topic
        with poses other than ``reference``.
    reference : str, optional
        Topic with the poses of the reference array, for `Recording.transforms`.
    frames : bool, optional
        Whether `Recording.transforms` also contains those of /tf and /tf_static.

    Returns
    -------
    Recording
        In m and s; the stamps are those of the headers, not the times of reception.

    Raises
    ------
    InputError
        If the bag is missing, damaged or empty, or the topics are missing, ambiguous or of another
        type.

    """
    bag = BagFiles(path)
    types = {topic.name: topic.msgtype for topic in bag.topics()}
    names = _select_topics(bag.path, types, topics, reference)
    if reference and types.get(reference) not in TOOL_POSES:
        raise InputError(f'{path} has no poses of the reference array, PoseStamped on {reference} '
                         f'(reference.topic); it has {_listed(types)}')
    tf_topics = [name for name in FRAMES if frames and types.get(name) == TF]
    messages = bag.messages([*names, *([reference] if reference else []),
                             *tf_topics])
    points = [raw for raw in messages if raw.topic in names]
    if not points:
        raise InputError(f'{path} has no messages on {", ".join(names)}')
    times, frame_ids, positions, tools = _decoded(bag.path, points)
    return Recording(
        positions=positions, stamps=times, frame_ids=frame_ids, source_names=names,
        sources=np.array([names.index(raw.topic) for raw in points], np.int32), tools=tools,
        transforms=_transforms(bag.path, messages, names), notes=tuple(bag.notes))


def _select_topics(path: Path, types: dict[str, str], wanted: Sequence[str] | None,
                   reference: str) -> list[str]:
    """Return the topics to read; raise `InputError` with the available ones if there are none."""
    available = _listed(types)
    if wanted is None:
        points = [name for name, msgtype in types.items()
                  if msgtype == POINT and name != LANDMARK_TOPIC]
        tools = [name for name, msgtype in types.items()
                 if msgtype in TOOL_POSES and name != reference]
        names = [TIP_TOPIC] if TIP_TOPIC in points + tools else points or tools
        if len(names) != 1:
            raise InputError(
                f'{path} has {len(names) or "no"} topics that could be the probe; choose one of '
                f'its topics: {available}')
        return names
    names = list(dict.fromkeys(wanted))
    bad = [name for name in names if types.get(name) not in (POINT, *TOOL_POSES)]
    if bad or not names:
        raise InputError(f'{path} has no topic {", ".join(bad)} with positions (PointStamped) or '
                         f'poses of the probe; it has {available}')
    return names


def _listed(types: dict[str, str]) -> str:
    return ', '.join(f'{name} ({msgtype})' for name, msgtype in types.items()) or 'no topics'


def _decoded(path: Path, messages: list[Raw]
             ) -> tuple[np.ndarray, list[str], np.ndarray, np.ndarray | None]:
    """
    Return stamps (n,) s, frame ids, positions (n, 3) m and poses (n, 7) of serialized messages.

    A pose is NaN where a position was recorded; None if all are positions.
    """
    times = np.zeros(len(messages))
    positions = np.zeros((len(messages), 3))
    tools = np.full((len(messages), 7), np.nan)
    frames = []
    for i, raw in enumerate(messages):
        message = decode_message(path, i, raw)
        times[i] = stamps.to_seconds(message.header.stamp.sec, message.header.stamp.nanosec)
        if raw.msgtype == POINT:
            positions[i] = message.point.x, message.point.y, message.point.z
        else:
            tools[i] = tool_pose(message, raw.msgtype)
            positions[i] = tools[i, :3]
        frames.append(message.header.frame_id)
    has_tools = any(raw.msgtype != POINT for raw in messages)
    return times, frames, positions, tools if has_tools else None


def decode_message(path: Path, i: int, raw: Raw) -> Any:
    """Deserialize message number ``i`` (from 0); raise `InputError` if it is damaged."""
    try:
        return TYPES.deserialize_cdr(raw.data, raw.msgtype)
    except Exception:  # damaged bytes can cause any exception in the decoder
        raise InputError(
            f'{path} is damaged: message {i + 1} on {raw.topic} cannot be decoded') from None


def _transforms(path: Path, messages: list[Raw], points: Sequence[str]) -> list[RecordedTransform]:
    """Return the transforms in the messages, with the number of ``points`` before each."""
    transforms, after = [], 0
    for i, raw in enumerate(messages):
        if raw.topic in points:
            after += 1
        elif raw.topic in FRAMES:
            for each in decode_message(path, i, raw).transforms:
                motion = each.transform
                transforms.append(_transform(after, each.header, motion.translation,
                                             motion.rotation, each.child_frame_id,
                                             FRAMES[raw.topic]))
        else:
            message = decode_message(path, i, raw)
            transforms.append(_transform(after, message.header,
                                         *TOOL_POSES[raw.msgtype](message)))
    return transforms


def _transform(after: int, header: Any, position: Any, orientation: Any, child: str = '',
               fixed: bool = False) -> RecordedTransform:
    """Return a transform; its matrix is `INVALID_TRANSFORM` if it is not a rigid motion."""
    try:
        T = to_matrix(position, orientation)
    except InputError:
        T = INVALID_TRANSFORM
    stamp = stamps.to_seconds(header.stamp.sec, header.stamp.nanosec)
    return RecordedTransform(after, stamp, T, header.frame_id, child, fixed)
