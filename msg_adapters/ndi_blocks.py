# SPDX-License-Identifier: Apache-2.0
"""
Split the lines of NDI tracker recordings (CSV) into the blocks of their tools.

A line is a frame: the number of tools, then a block for each tool. There are two layouts.

- NDI Track: ``Tools,Port ...,Frame,Time [sec],Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers`` (or
  Q0,Qx,Qy,Qz instead of the angles). The header has a block for each tool; the label of a tool is
  in the header and, in most versions, at the start of its block in each line. Optical trackers
  append State,Tx,Ty,Tz of every marker. The length of a block can change from line to line.
- Combined API of NDI: ``#Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,...,Markers``.
  The header has one block for all tools; a block in a line ends after the number of markers that
  it states.

Cells are separated by commas, semicolons or tabs. With semicolons and tabs, numbers can have a
decimal comma.
"""

from __future__ import annotations

import csv
import itertools
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass

from gsdf_registration.common.result import InputError
from msg_adapters.files import read_text

NEEDED = ('State', 'Tx', 'Ty', 'Tz')
NAMES = {name.lower(): name for name in (
    'Frame', 'Time', 'Face', 'State', 'Q0', 'Qx', 'Qy', 'Qz', 'Rz', 'Ry', 'Rx', 'Tx', 'Ty', 'Tz',
    'Error', 'Markers', 'ToolInfo', 'PortHandle')} | {
        'transformstatus': 'State', 'status': 'State', 'timestamp': 'Time',
        'timespec_s': 'Seconds', 'timespec_ns': 'Nanoseconds', 'qw': 'Q0'}
FIRST = ('tools', 'toolcount', 'number of tools')   # names of the first column
MARKER = 4              # cells of a marker: State, Tx, Ty, Tz
TITLE_LINES = 3         # lines that can precede the header


@dataclass(frozen=True)
class Block:
    """
    The block of a tool in one line.

    line : line number, from 1
    cells : column -> text; without the columns for which the line has no cell
    excess : number of cells beyond those of the tool and of whole markers, negative if some are
        missing
    cut : whether this is the last line, it has no end, and cells are missing
    """

    line: int
    cells: dict[str, str]
    excess: int = 0
    cut: bool = False


@dataclass(frozen=True)
class _Columns:
    """
    The block of a tool in the header.

    label : unique in the file
    written : label as it is in the lines
    start : index of its first cell
    offsets : name of a column -> offset from the start
    extra : number of cells of markers
    """

    label: str
    written: str
    start: int
    offsets: dict[str, int]
    extra: int


class BlockFile:
    """
    The blocks of a file by the label of their tool.

    Parameters
    ----------
    path : path
        CSV file of one of the layouts.

    Raises
    ------
    InputError
        If the file cannot be read or has another format.

    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = path
        # labels of tools may be in the code page of the PC that recorded them
        text = read_text(path, legacy='cp1252')
        lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1)
                 if line.strip()]
        found = _find_header([line for _, line in lines[:TITLE_LINES]])
        if found is None:
            raise InputError(f'{path} is not an NDI tracker CSV: its header is not '
                             f'Tools,...,{",".join(NEEDED)}')
        row, self.separator = found
        header = cells_of(lines[row][1], self.separator)
        self._columns = _tools(header)
        self._lines = lines[row + 1:]
        self._unended = not text.endswith('\n')
        # one block for all tools
        self._shared = any(_canonical(tool.written) == 'ToolInfo' for tool in self._columns)
        self.blocks: dict[str, list[Block]] = {}
        if not self._shared:
            self.blocks = {tool.label: [] for tool in self._columns}
        for number, line in self._lines:
            self._add(number, cells_of(line, self.separator))

    @property
    def labels(self) -> list[str]:
        """The labels of the tools, in the order of the file."""
        return list(self.blocks)

    def columns(self, label: str) -> list[str]:
        """Return the names of the columns of a tool."""
        tool = next((tool for tool in self._columns if tool.label == label), self._columns[0])
        return list(tool.offsets)

    def _add(self, number: int, cells: list[str]) -> None:
        """Store the blocks of a line."""
        last = self._unended and number == self._lines[-1][0]
        split = self._of_shared_header if self._shared else self._of_labels
        for label, tool, block in split(cells):
            self.blocks.setdefault(label, []).append(_block(number, tool, block, last))

    def _of_shared_header(self, cells: list[str]) -> Iterator[tuple[str, _Columns, list[str]]]:
        """Yield label, columns and cells of each tool; a block states its number of markers."""
        tool, start = self._columns[0], 1
        width = len(tool.offsets) + 1
        while start + 1 < len(cells):
            block = cells[start:start + width]
            markers = tool.offsets.get('Markers', width)
            count = block[markers] if markers < len(block) else ''
            end = start + width + MARKER * (int(count) if count.isdigit() else 0)
            port = tool.offsets.get('PortHandle', width)
            label = ' '.join([block[0], *block[port:port + 1]])
            yield label, tool, cells[start:min(end, len(cells))]
            start = end

    def _of_labels(self, cells: list[str]) -> Iterator[tuple[str, _Columns, list[str]]]:
        """Yield label, columns and cells of each tool of which the line has a block."""
        labels = {tool.written for tool in self._columns}
        starts = [i for i, cell in enumerate(cells) if cell in labels]
        ends = [*starts[1:], len(cells)]
        if not starts:      # the lines have no labels: the blocks are where the header has them
            starts = [tool.start for tool in self._columns if tool.start < len(cells)]
            for tool, start, end in zip(self._columns, starts, [*starts[1:], len(cells)]):
                yield tool.label, tool, cells[start:end]
            return
        used: set[str] = set()
        for start, end in zip(starts, ends):
            free = [tool for tool in self._columns
                    if tool.written == cells[start] and tool.label not in used]
            if free:
                used.add(free[0].label)
                yield free[0].label, free[0], cells[start:end]
        for tool in self._columns:
            if tool.label not in used:
                yield tool.label, tool, []


def is_ndi(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is an NDI tracker CSV, judged by its header."""
    lines = (line for line in read_text(path, legacy='cp1252').splitlines() if line.strip())
    return _find_header(list(itertools.islice(lines, TITLE_LINES))) is not None


def cells_of(line: str, separator: str) -> list[str]:
    """Return the stripped cells of a line."""
    try:
        cells = next(csv.reader([line.strip()], delimiter=separator), [''])
    except csv.Error:       # a cell that is too long
        cells = [line]
    return [cell.strip() for cell in cells]


def _find_header(lines: list[str]) -> tuple[int, str] | None:
    """Return index and separator of the header, the first line that has all needed columns."""
    for row, line in enumerate(lines):
        separator = next((mark for mark in ';\t,' if mark in line), ',')
        cells = cells_of(line, separator)
        names = {_canonical(cell) for cell in cells}
        if cells[0].lower().lstrip('#').strip() in FIRST and set(NEEDED) <= names:
            return row, separator
    return None


def _canonical(name: str) -> str:
    """Return the name of a column without unit and spelling, as 'Time' for 'Time [sec]'."""
    bare = re.sub(r'\[.*?\]|\(.*?\)|#', '', name).strip().lower()
    if re.fullmatch(r'marker\d+\.status', bare):
        return 'State'
    return NAMES.get(bare, name)


def _tools(header: list[str]) -> list[_Columns]:
    """Return the tools of a header; the label of a block precedes its Frame column."""
    names = [_canonical(name) for name in header]
    starts = [i - 1 for i, name in enumerate(names) if name == 'Frame' and i > 0] or [0]
    tools: list[_Columns] = []
    for start, end in zip(starts, [*starts[1:], len(header)]):
        # the first of repeated names belongs to the tool, the others to its markers
        offsets: dict[str, int] = {}
        for offset, name in enumerate(names[start + 1:end], start=1):
            if name:
                offsets.setdefault(name, offset)
        written = header[start]
        same = sum(tool.written == written for tool in tools)
        tools.append(_Columns(f'{written} ({same + 1})' if same else written, written, start,
                              offsets, end - start - 1 - len(offsets)))
    return tools


def _block(number: int, tool: _Columns, block: list[str], last: bool) -> Block:
    """Return the block of a tool with its cells by column; ``last``: of a line without an end."""
    width = len(tool.offsets) + 1
    while len(block) > width and not block[-1]:
        block = block[:-1]
    excess = len(block) - width
    # markers have four cells each; anything else, such as decimal commas, shifts the columns
    whole = excess in (*range(0, tool.extra, MARKER), tool.extra) or (
        excess > 0 and _canonical(tool.written) == 'ToolInfo')   # it states its number of markers
    cells = {name: block[offset] for name, offset in tool.offsets.items() if offset < len(block)}
    return Block(number, cells, 0 if whole else excess, last and excess < 0)
