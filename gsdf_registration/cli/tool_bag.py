# SPDX-License-Identifier: Apache-2.0
"""Write the tools of imported recordings to a bag, one topic of poses a tool."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from gsdf_registration.common.rigid import Array
    from msg_adapters.tracked_tool import TrackedTool


class ToolTopic(NamedTuple):
    """Topic of a tool and frame of its poses."""

    topic: str
    frame_id: str


class _Message(NamedTuple):
    """A pose (4, 4) or, without an orientation, a position (3,) of a tool, m."""

    stamp: float
    to: ToolTopic
    value: Array


def write_tools(output: str, tools: Sequence[TrackedTool], topics: Mapping[str, ToolTopic]) -> str:
    """
    Write the poses in the order of their stamps; tools without orientations become PointStamped.

    Parameters
    ----------
    output : directory of the new bag
    tools : with stamps; several can have the same label
    topics : by label

    Returns
    -------
    str
        What was written: a line for the bag and one for each tool.

    Raises
    ------
    InputError
        If no sample has a valid pose, or the bag cannot be written.

    """
    from msg_adapters.bag_writer import BagWriter
    dropped = {label: Counter[str]() for label in topics}
    messages: list[_Message] = []
    for tool in tools:
        dropped[tool.label].update(tool.dropped)
        messages += _messages(tool, topics[tool.label], dropped[tool.label])
    if not messages:
        raise InputError(f'nothing is written to {output}: no sample has a valid pose')
    messages.sort(key=lambda message: message.stamp)
    with BagWriter(output) as bag:
        for message in messages:
            write = bag.write_pose if message.value.ndim == 2 else bag.write_point
            write(message.to.topic, message.stamp, message.value, message.to.frame_id)
    return _summary(output, messages, topics, dropped)


def _messages(tool: TrackedTool, to: ToolTopic, dropped: Counter[str]) -> list[_Message]:
    """Return the messages of a tool, and count its invalid poses."""
    import numpy as np

    from msg_adapters.tool_poses import to_poses
    if tool.stamps is None:
        return []
    if tool.quaternions is None:
        return [_Message(stamp, to, position)
                for stamp, position in zip(tool.stamps.tolist(), tool.positions)]
    poses, invalid = to_poses(tool.positions, tool.quaternions)
    dropped.update(invalid)
    return [_Message(stamp, to, T) for stamp, T in zip(tool.stamps.tolist(), poses)
            if np.isfinite(T).all()]


def _summary(output: str, messages: list[_Message], topics: Mapping[str, ToolTopic],
             dropped: Mapping[str, Counter[str]]) -> str:
    from gsdf_registration.cli.summary import counts_by_cause
    written = Counter(message.to.topic for message in messages)
    lines = [f'{output}: {format_count(len(topics), "tool")}, '
             f'{format_count(len(messages), "sample")} in '
             f'{messages[-1].stamp - messages[0].stamp:.1f} s']
    for label, to in topics.items():
        lost = counts_by_cause(dict(+dropped[label]))
        lines.append(f'{to.topic}: {format_count(written[to.topic], "sample")} of {label}'
                     + (f'; left out: {lost}' if lost else ''))
    return '\n'.join(lines)
