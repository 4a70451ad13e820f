# SPDX-License-Identifier: Apache-2.0
"""
Read tracker recordings of the NDI Track software (CSV, millimetres).

Each line is a frame: the number of tools, then a block for each tool that starts with its label,
``Port ...,Frame,Time [sec],Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers`` (or Q0,Qx,Qy,Qz instead of
the angles). Optical trackers append State,Tx,Ty,Tz of every marker. The length of a block can
change from line to line, so that blocks are found by their labels.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from msg_adapters.files import METRES, read_text
from msg_adapters.recording import Recording

NEEDED = ('State', 'Tx', 'Ty', 'Tz')


class _Tool(NamedTuple):
    """The block of a tool: label, start, name -> offset, number of columns of its markers."""

    label: str
    start: int
    columns: dict[str, int]
    extra: int


class _Sample(NamedTuple):
    """The values of a valid line, in the unit of the file, and its cells by column."""

    position: list[float]
    error: float
    time: float | None
    line: int
    cells: dict[str, str]


class TrackedTool(NamedTuple):
    """
    The samples of a tool with State OK.

    label : port label
    columns : names of the columns of its block
    samples : at least one
    stamps : (n,) float64, s, or None if no sample has a time
    lost : number of lines without State OK
    """

    label: str
    columns: Collection[str]
    samples: list[_Sample]
    stamps: Array | None
    lost: int

    def positions(self) -> Array:
        """Return the positions (n, 3), m."""
        return np.array([sample.position for sample in self.samples]) * METRES['mm']


def is_ndi(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is an NDI tracker CSV, judged by its header."""
    return _is_header(_cells(read_text(path).lstrip().partition('\n')[0]))


def read_ndi(path: str | os.PathLike[str], tool: str | None = None) -> Recording:
    """
    Read the positions of one tool.

    Parameters
    ----------
    path : path
        CSV file.
    tool : str, optional
        Part of the port label of the tool; not needed if the file has only one tool.

    Returns
    -------
    Recording
        In m and s. Samples whose State is not OK are dropped and counted as 'tracking_state'. The
        quality is the Error column. The stamps are None if the file has no times.

    Raises
    ------
    InputError
        If the file has another format, a valid line has a value that is not a number, the tool is
        missing or ambiguous, or it was never tracked.

    """
    tracked = read_tool(path, tool)
    errors = np.array([sample.error for sample in tracked.samples]) * METRES['mm']
    return Recording(positions=tracked.positions(), stamps=tracked.stamps,
                     source_names=[tracked.label],
                     quality=errors if 'Error' in tracked.columns else None,
                     dropped={'tracking_state': tracked.lost} if tracked.lost else {})


def read_tool(path: str | os.PathLike[str], wanted: str | None = None) -> TrackedTool:
    """Return the valid samples of one tool; arguments and errors as in `read_ndi`."""
    text = enumerate(read_text(path).splitlines(), start=1)
    lines = [(number, _cells(line)) for number, line in text if line.strip()]
    if not lines or not _is_header(lines[0][1]):
        raise InputError(
            f'{path} is not an NDI tracker CSV: its header is not Tools,...,{",".join(NEEDED)}')
    tools = _tools(lines[0][1])
    tool = _select_tool(path, tools, wanted)
    labels = {each.label for each in tools}
    samples, lost = [], 0
    for number, cells in lines[1:]:
        block = _block(cells, tool, labels)
        state = tool.columns['State']
        if len(block) <= state or block[state].upper() != 'OK':
            lost += 1
        else:
            samples.append(_sample(f'{path}, line {number}', number, block, tool))
    if not samples:
        raise InputError(
            f'{path}: {tool.label} was never tracked '
            f'({format_count(lost, "line")}, none with State OK)')
    return TrackedTool(tool.label, tool.columns, samples, _stamps(path, samples), lost)


def _cells(line: str) -> list[str]:
    """Return the stripped cells of a line."""
    return [cell.strip() for cell in next(csv.reader([line.strip()]), [''])]


def _is_header(cells: list[str]) -> bool:
    """Return whether a line is the header of an NDI tracker CSV."""
    return cells[0] == 'Tools' and set(NEEDED) <= set(cells)


def _tools(header: list[str]) -> list[_Tool]:
    """Return the tools of a header; the label of a block precedes its Frame column."""
    starts = [i - 1 for i, name in enumerate(header) if name == 'Frame' and i > 0] or [0]
    tools = []
    for start, end in zip(starts, [*starts[1:], len(header)]):
        names = ['Time' if name.startswith('Time') else name for name in header[start:end]]
        # the first of repeated names belongs to the tool, the others to its markers
        columns = {name: names.index(name) for name in names if name}
        tools.append(_Tool(header[start], start, columns, len(names) - len(columns)))
    return tools


def _select_tool(path: str | os.PathLike[str], tools: list[_Tool], wanted: str | None) -> _Tool:
    """Return the requested tool, or the only one."""
    found = [tool for tool in tools if wanted is None or wanted.lower() in tool.label.lower()]
    if len(found) != 1:
        what = ('several tools' if wanted is None
                else f'{len(found) or "no"} tools that match {wanted!r}')
        raise InputError(
            f'{path} has {what}; choose one of {"; ".join(tool.label for tool in tools)}')
    if not set(NEEDED) <= set(found[0].columns):
        raise InputError(f'{path}: {found[0].label} does not have all of the columns '
                         f'{", ".join(NEEDED)}')
    return found[0]


def _block(cells: list[str], tool: _Tool, labels: set[str]) -> list[str]:
    """Return the cells of a tool in a line, empty if the line has only other tools."""
    starts = [i for i, cell in enumerate(cells) if cell in labels]
    if not starts:
        return cells[tool.start:]
    start = next((i for i in starts if cells[i] == tool.label), len(cells))
    return cells[start:next((i for i in starts if i > start), len(cells))]


def _sample(where: str, number: int, block: list[str], tool: _Tool) -> _Sample:
    """Return the numbers of a block with State OK."""
    width = len(tool.columns)
    while len(block) > width and not block[-1]:
        block = block[:-1]
    extra = len(block) - width
    # markers have four cells each; anything else, such as decimal commas, shifts the columns
    if extra not in (*range(0, tool.extra, 4), tool.extra):
        raise InputError(
            f'{where}: has {format_count(len(block), "value")} for {tool.label} where {width} are '
            'expected (numbers need a decimal point)')
    cells = {name: block[i] for name, i in tool.columns.items()}
    time = cells.get('Time', '')
    try:
        position = [float(cells[name]) for name in ('Tx', 'Ty', 'Tz')]
        return _Sample(position, float(cells.get('Error') or 'nan'),
                       float(time) if time else None, number, cells)
    except ValueError:
        raise InputError(f'{where}: State is OK but Time, Tx, Ty, Tz or Error is not a '
                         'number (numbers need a decimal point)') from None


def _stamps(path: str | os.PathLike[str], samples: list[_Sample]) -> Array | None:
    """Return the times, or None if no sample has a time."""
    times = np.array([np.nan if sample.time is None else sample.time for sample in samples])
    if all(sample.time is None for sample in samples):
        return None
    if not np.isfinite(times).all():
        line = samples[int(np.argmin(np.isfinite(times)))].line
        raise InputError(
            f'{path}, line {line}: the time is empty or not finite, but other lines have a time')
    return times
