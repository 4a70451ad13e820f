# SPDX-License-Identifier: Apache-2.0
"""
Read the tools of NDI tracker recordings (CSV, millimetres).

The tracker gives each sample a state; only samples with the state OK (or Enabled, in recordings of
the Combined API) are used. A value that the tracker does not know is -3.7E+28.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter

import numpy as np
from scipy.spatial.transform import Rotation

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from msg_adapters.files import METRES
from msg_adapters.ndi_blocks import NEEDED, Block, BlockFile, is_ndi
from msg_adapters.recording import Recording
from msg_adapters.tracked_tool import TrackedTool

__all__ = ['is_ndi', 'read_ndi', 'read_tool', 'read_tools', 'topic_of']

TRACKED = ('ok', 'enabled')
POSITION = ('Tx', 'Ty', 'Tz')
QUATERNION = ('Qx', 'Qy', 'Qz', 'Q0')
ANGLES = ('Rz', 'Ry', 'Rx')     # deg; the rotation is Rz Ry Rx
UNKNOWN = 1e10                  # larger numbers stand for an unknown value


def read_ndi(path: str | os.PathLike[str], tool: str | None = None,
             rate: float | None = None, poses: bool = False) -> Recording:
    """
    Read the positions of one tool, or its poses.

    Parameters
    ----------
    path : path
        CSV file.
    tool : str, optional
        Part of the port label of the tool; not needed if the file has only one tool.
    rate : float, optional
        Frames per second of the Frame column, Hz, for files without times.
    poses : bool, optional
        Whether `Recording.tools` has the poses; else the positions are those of the tip.

    Returns
    -------
    Recording
        In m and s. Samples whose state is not OK are dropped and counted as 'tracking_state', and
        those without a known position as 'not_finite'. The quality is the Error column. The stamps
        are None if the file has no times.

    Raises
    ------
    InputError
        If the file has another format, a valid line has a value that is not a number, the tool is
        missing or ambiguous, or it was never tracked.

    """
    tracked = read_tool(path, tool, rate)
    tools = None
    notes: tuple[str, ...] = (
        f'the positions of {tracked.label} are taken as those of the tip; give --tip if the tip is '
        'elsewhere on the tool',)
    if poses:
        if tracked.quaternions is None:
            raise InputError(f'{path}: {tracked.label} has no orientation, so a tip (--tip, '
                             'probe.tip) cannot be applied')
        tools, notes = np.hstack([tracked.positions, tracked.quaternions]), ()
    return Recording(positions=tracked.positions, stamps=tracked.stamps, tools=tools, notes=notes,
                     source_names=[tracked.label], quality=tracked.errors, dropped=tracked.dropped)


def read_tool(path: str | os.PathLike[str], wanted: str | None = None,
              rate: float | None = None) -> TrackedTool:
    """Return the samples of one tool; arguments and errors as in `read_ndi`."""
    file = BlockFile(path)
    tool = _tracked(file, _select(file, wanted), rate)
    if not len(tool):
        raise _never_tracked(path, [tool])
    return tool


def read_tools(path: str | os.PathLike[str], wanted: str | None = None,
               rate: float | None = None) -> list[TrackedTool]:
    """Return all tools, or the wanted one, also those never tracked; errors as in `read_ndi`."""
    file = BlockFile(path)
    labels = file.labels if wanted is None else [_select(file, wanted)]
    tools = [_tracked(file, label, rate) for label in labels]
    if not any(len(tool) for tool in tools):
        raise _never_tracked(path, tools)
    return tools


def topic_of(label: str, others: list[str]) -> str:
    """
    Return the CRTK topic of the pose of a tool.

    It is derived from its label without port, serial number and channel, if the name is then
    unique among all labels (``others``): /probe_5d/measured_cp for
    'Port 0x0A: PROBE-5D  s/n:00C0FFEE Channel:0'.
    """
    short = [_name(re.sub(r'^port \w+:|port:\w+|s/n:\S*|channel:\S*', '', each, flags=re.IGNORECASE)
                   ) for each in others]
    name = short[others.index(label)]
    if not name or short.count(name) > 1:
        name = _name(label)
    return f'/{name}/measured_cp'


def _name(label: str) -> str:
    """Return a label as a ROS name, empty if it has no letters and digits."""
    name = re.sub(r'[^a-z0-9]+', '_', label.lower()).strip('_')
    return f'tool_{name}' if name[:1].isdigit() else name


def _select(file: BlockFile, wanted: str | None) -> str:
    """Return the label of the requested tool, or of the only one."""
    found = [label for label in file.labels if wanted is None or wanted.lower() in label.lower()]
    if len(found) != 1:
        what = ('several tools' if wanted is None
                else f'{len(found) or "no"} tools that match {wanted!r}')
        raise InputError(f'{file.path} has {what}; choose one with --tool: '
                         f'{"; ".join(file.labels) or "it has none"}')
    return found[0]


def _tracked(file: BlockFile, label: str, rate: float | None) -> TrackedTool:
    """Return the samples of a tool."""
    columns = file.columns(label)
    if not set(NEEDED) <= set(columns):
        raise InputError(f'{file.path}: {label} does not have all of the columns '
                         f'{", ".join(NEEDED)}')
    turn = next((names for names in (QUATERNION, ANGLES) if set(names) <= set(columns)), ())
    wanted = [*POSITION, *turn, *(['Error'] if 'Error' in columns else [])]
    rows, kept, dropped = [], [], Counter[str]()
    for block in file.blocks[label]:
        if block.cells.get('State', '').replace(' ', '').lower() not in TRACKED:
            dropped['tracking_state'] += 1
            continue
        if block.cut:
            dropped['cut'] += 1
            continue
        row = _numbers(file, label, block, wanted)
        if not all(map(math.isfinite, row[:3])):
            dropped['not_finite'] += 1
            continue
        rows.append(row)
        kept.append(block)
    values = np.array(rows, dtype=np.float64).reshape(len(rows), len(wanted))
    turns = values[:, 3:3 + len(turn)]
    return TrackedTool(
        label, values[:, :3] * METRES['mm'],
        None if not turn else _quaternions(turns) if turn is ANGLES else turns,
        values[:, -1] * METRES['mm'] if 'Error' in columns else None,
        _stamps(file, kept, rate), dict(dropped))


def _numbers(file: BlockFile, label: str, block: Block, names: list[str]) -> list[float]:
    """Return the values of a block; NaN where the tracker does not know them."""
    where = f'{file.path}, line {block.line}'
    if block.excess:
        width = len(file.columns(label)) + 1
        raise InputError(
            f'{where}: has {format_count(width + block.excess, "value")} for {label} where {width} '
            'are expected (numbers need a decimal point)')
    row = []
    for name in names:
        cell = block.cells.get(name, '')
        # the error and the orientation of a sensor may be unknown where its position is known
        value = math.nan if not cell and name not in POSITION else _number(file, cell)
        if value is None:
            raise InputError(f'{where}: the state is OK but {name} is {cell!r}, which is not a '
                             'number (numbers need a decimal point)')
        row.append(value if abs(value) < UNKNOWN else math.nan)
    return row


def _number(file: BlockFile, cell: str) -> float | None:
    """Return the number in a cell, None if there is none."""
    # with commas between the cells, 1,234 can be a thousand as well
    if file.separator != ',' and re.fullmatch(r'[-+]?\d*,\d+([eE][-+]?\d+)?', cell):
        cell = cell.replace(',', '.')
    try:
        return float(cell)
    except ValueError:
        return None


def _stamps(file: BlockFile, blocks: list[Block], rate: float | None) -> Array | None:
    """Return the times, s, from the Time column or from the Frame column and its rate."""
    if any(block.cells.get('Time') or block.cells.get('Seconds') for block in blocks):
        if rate is not None:
            raise InputError(f'{file.path} has times: omit --rate')
        return _column(file, blocks, 'Time', 'the time is empty or not finite, but other lines '
                       'have a time')
    if rate is None:
        return None
    return _column(file, blocks, 'Frame', 'the frame number is missing, but --rate needs it') / rate


def _column(file: BlockFile, blocks: list[Block], name: str, problem: str) -> Array:
    """Return the finite values of a column; ``Time`` can be split into seconds and nanoseconds."""
    values = []
    for block in blocks:
        value = _number(file, block.cells.get(name, ''))
        if value is None and name == 'Time':
            seconds, nanoseconds = (_number(file, block.cells.get(part, ''))
                                    for part in ('Seconds', 'Nanoseconds'))
            value = None if seconds is None else seconds + 1e-9 * (nanoseconds or 0.0)
        if value is None or not math.isfinite(value):
            raise InputError(f'{file.path}, line {block.line}: {problem}')
        values.append(value)
    return np.array(values)


def _quaternions(angles: Array) -> Array:
    """Return the quaternions x y z w (n, 4) of angles Rz Ry Rx (n, 3), deg; NaN if not finite."""
    finite = np.asarray(np.isfinite(angles).all(axis=1))
    quaternions = Rotation.from_euler('ZYX', np.where(finite[:, None], angles, 0.0),
                                      degrees=True).as_quat()
    quaternions[~finite] = np.nan
    return np.asarray(quaternions)


def _never_tracked(path: str | os.PathLike[str], tools: list[TrackedTool]) -> InputError:
    names = ', '.join(tool.label for tool in tools)
    lines = format_count(max(sum(tool.dropped.values()) for tool in tools), 'line')
    return InputError(f'{path}: {names} was never tracked ({lines}, none with State OK and a '
                      'position)')
