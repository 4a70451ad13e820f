# SPDX-License-Identifier: Apache-2.0
"""Read delimited text with comments, blank lines, and columns in any order and case."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from msg_adapters.files import read_text


@dataclass(frozen=True)
class Table:
    """
    The cells of a text file.

    columns : lower-case name -> index; empty if the file has no header
    rows : stripped cells of each line with values
    lines : line number of each row, from 1
    """

    path: str
    columns: dict[str, int]
    rows: list[list[str]]
    lines: list[int]

    def first_of(self, *names: str) -> str | None:
        """Return the first of ``names`` that is a column, or None."""
        return next((name for name in names if name in self.columns), None)

    def text(self, name: str) -> list[str]:
        """Return the cells of a column."""
        return [row[self.columns[name]] for row in self.rows]

    def numbers(self, *columns: str | int) -> Array:
        """
        Return columns, by name or index, as (n, k) float64; an empty cell is NaN.

        Raises
        ------
        InputError
            If a cell is not a number; the message names the line.

        """
        indices = [self.columns[c] if isinstance(c, str) else c for c in columns]
        cells = [[row[j] or 'nan' for j in indices] for row in self.rows]
        try:
            return np.array(cells, dtype=np.float64).reshape(len(cells), len(indices))
        except ValueError:
            line, cell = next((line, cell) for line, row in zip(self.lines, cells)
                              for cell in row if not _is_number(cell))
        hint = '; use a decimal point' if re.fullmatch(r'-?\d+,\d+', cell) else ''
        raise InputError(f'{self.path}, line {line}: {cell!r} is not a number{hint}')


def read_table(path: str | os.PathLike[str], wanted: Iterable[str] = ()) -> Table:
    """
    Read text that is separated by commas, semicolons, tabs or blanks.

    The header is the first line, if it has a cell that is not a number. Blank lines and lines that
    begin with ``#`` are skipped, except that a comment with all ``wanted`` names is a header, as
    written by numpy.savetxt.

    Raises
    ------
    InputError
        If the file cannot be read, or a line has another number of cells than the first.

    """
    wanted = set(wanted)
    columns: dict[str, int] = {}
    rows: list[list[str]] = []
    lines: list[int] = []
    separator = None
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        text = line.strip()
        comment = text.startswith('#')
        text = text.lstrip('# \t') if comment else text
        if not text:
            continue
        separator = separator or _separator(text)
        cells = _cells(text, separator)
        if comment:
            # a comment can have another separator than the data
            names = [name.lower() for name in _cells(text, _separator(text))]
            if not rows and not columns and wanted and wanted <= set(names):
                columns = _header(path, number, names)
            separator = separator if rows or columns else None
        elif not rows and not columns and not all(_is_number(cell or 'nan') for cell in cells):
            columns = _header(path, number, [name.lower() for name in cells])
        else:
            width = len(columns) or (len(rows[0]) if rows else len(cells))
            rows.append(_fitted(path, number, cells, width))
            lines.append(number)
    return Table(str(path), columns, rows, lines)


def _header(path: str | os.PathLike[str], number: int, names: list[str]) -> dict[str, int]:
    """Return name -> index of the cells of a header."""
    while names and not names[-1]:
        names.pop()  # a separator at the end of the line
    duplicate = next((name for name in names if names.count(name) > 1), None)
    if duplicate is not None:
        raise InputError(f'{path}, line {number}: the column {duplicate!r} is not unique')
    return {name: i for i, name in enumerate(names)}


def _fitted(path: str | os.PathLike[str], number: int, cells: list[str], width: int) -> list[str]:
    """Return the first ``width`` cells; raise `InputError` if there are fewer or more."""
    if len(cells) < width or any(cells[width:]):
        raise InputError(
            f'{path}, line {number}: has {format_count(len(cells), "value")} where {width} are '
            'expected')
    return cells[:width]


def _separator(text: str) -> str:
    """Return the separator of a line: the first of ; tab , that it contains, else a blank."""
    return next((mark for mark in ';\t,' if mark in text), ' ')


def _cells(text: str, separator: str) -> list[str]:
    """Split a line into stripped cells without quotes."""
    if separator == ' ':
        return text.split()
    return [cell.strip()
            for cell in next(csv.reader([text], delimiter=separator, skipinitialspace=True))]


def _is_number(cell: str) -> bool:
    """Return whether a cell is a number, including NaN and infinity."""
    try:
        float(cell)
    except ValueError:
        return False
    return True
