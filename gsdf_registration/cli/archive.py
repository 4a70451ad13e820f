# SPDX-License-Identifier: Apache-2.0
"""
Find the recordings of an archive: by patterns, by folders, or by a table of cases.

A storage file of a rosbag2 folder stands for the whole folder, so that a recording that was split
is one recording.
"""

from __future__ import annotations

import glob
import os
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError

COLUMNS = ('bag', 'model', 'landmarks', 'config', 'label')      # of a table of cases
SHOWN = 3       # names in a note


@dataclass(frozen=True)
class Case:
    """
    A recording, and what belongs to it in place of the options.

    bag : path
    model, landmarks, config : paths; None: those of the options
    label : of the case; None: that of the options
    """

    bag: str
    model: str | None = None
    landmarks: str | None = None
    config: str | None = None
    label: str | None = None


def find_bags(words: Sequence[str]) -> list[str]:
    """
    Return the recordings that paths, patterns and folders name; those of each are sorted.

    What a pattern or a folder names again is left out. Files that are no recordings are left out
    with a note on standard error.

    Parameters
    ----------
    words : paths of recordings, folders of recordings, or patterns with ``*``, ``?``, ``[...]`` and
        ``**`` for any folders

    Raises
    ------
    InputError
        If a pattern or a folder has no recording.

    """
    found: dict[str, None] = {}
    bags = list[str]()
    for word in words:
        if os.path.lexists(word) and not _is_folder_of_bags(word):
            new = [word]
        else:
            new = [bag for bag in _expanded(word) if bag not in found]
        bags += new
        found |= dict.fromkeys(new)
    return bags


def read_cases(path: str) -> list[Case]:
    """
    Return the cases of a table (CSV), with a line for each recording.

    Columns: ``bag`` (also a pattern or a folder), and any of ``model``, ``landmarks``, ``config``,
    ``label``. Paths are relative to the table. An empty cell stands for the option of that name.

    Raises
    ------
    InputError
        If the table cannot be read, has another column, or names a file that does not exist.

    """
    from msg_adapters.table import read_table
    table = read_table(path)
    unknown = [name for name in table.columns if name not in COLUMNS]
    if unknown or 'bag' not in table.columns:
        wrong = f'has the unknown column "{unknown[0]}"' if unknown else 'has no column "bag"'
        raise InputError(f'{path}, line 1: {wrong}; the columns of a table of cases are '
                         f'{", ".join(COLUMNS)}')
    cases = list[Case]()
    for line, row in zip(table.lines, table.rows):
        cells = {name: row[i] for name, i in table.columns.items() if row[i]}
        for name in set(cells) - {'label'}:
            cells[name] = _path_of(cells[name], name, Path(path).parent, f'{path}, line {line}')
        if 'bag' not in cells:
            raise InputError(f'{path}, line {line}: the column "bag" is empty')
        cases += [Case(bag, cells.get('model'), cells.get('landmarks'), cells.get('config'),
                       cells.get('label')) for bag in find_bags([cells['bag']])]
    if not cases:
        raise InputError(f'{path} has no cases')
    return cases


def _path_of(cell: str, name: str, folder: Path, where: str) -> str:
    """Return the path of a cell; raise `InputError` if there is nothing."""
    if cell.startswith('package://'):
        return cell
    path = str(folder / cell)
    if not os.path.exists(path) and not (name == 'bag' and glob.has_magic(path)):
        raise InputError(f'{where}: the {name} {path} does not exist')
    return path


def _expanded(word: str) -> list[str]:
    """Return the recordings of a pattern or of a folder, sorted."""
    if os.path.isdir(word):
        paths = list(_files_below(word))
    elif glob.has_magic(word):
        paths = glob.glob(word, recursive=True)
    else:
        return [word]       # its reader says that it does not exist
    bags, others = set[str](), list[str]()
    for path in sorted(paths):
        bag = _bag_of(path)
        if bag:
            bags.add(bag)
        elif os.path.isfile(path):
            others.append(path)
    if not bags:
        raise InputError(f'{word}: there is no recording (.mcap, .db3, .bag)')
    if others:
        named = ', '.join(os.path.basename(path) for path in others[:SHOWN])
        print(f'note: {word}: {format_count(len(others), "file")} left out, not a recording: '
              f'{named}{", ..." if len(others) > SHOWN else ""}', file=sys.stderr)
    return sorted(bags)


def _files_below(folder: str) -> Iterator[str]:
    """Yield all files below a folder, and the folders of rosbag2 without any storage file."""
    for root, _, names in os.walk(folder):
        if names == ['metadata.yaml']:
            yield root
        else:
            yield from (os.path.join(root, name) for name in names if not _belongs(root, name))


def _belongs(folder: str, name: str) -> bool:
    """Return whether a file describes a recording, as the metadata or the ground truth."""
    stem = os.path.splitext(name)[0]
    return name == 'metadata.yaml' or (name.endswith('.yaml') and any(
        os.path.exists(os.path.join(folder, stem + ending)) for ending in ('', '.mcap', '.db3')))


def _bag_of(path: str) -> str:
    """Return the recording that a path of an archive belongs to; empty if it is none."""
    from msg_adapters.bag_storage import is_storage
    if os.path.isdir(path):
        named = os.path.exists(os.path.join(path, 'metadata.yaml'))
        return path if named or (_storage_files(path) and not _is_folder_of_bags(path)) else ''
    if not is_storage(Path(path)):
        return ''
    folder, name = os.path.split(path)
    return folder if folder and _is_part(folder, name) else path


def _is_part(folder: str, name: str) -> bool:
    """Return whether a storage file is a part of the rosbag2 recording of its folder."""
    # as the recorder names it; without metadata if it was killed
    if re.match(re.escape(os.path.basename(os.path.abspath(folder))) + r'(_\d+)?\.', name):
        return True
    names = '|'.join(map(re.escape, (name, os.path.splitext(name)[0])))     # the latter: compressed
    try:
        with open(os.path.join(folder, 'metadata.yaml'), encoding='utf-8') as file:
            return re.search(rf'(?<![\w.-])({names})(?![\w.-])', file.read()) is not None
    except (OSError, UnicodeDecodeError):
        return False


def _is_folder_of_bags(path: str) -> bool:
    """Return whether a folder holds recordings, and is none itself."""
    if not os.path.isdir(path) or os.path.exists(os.path.join(path, 'metadata.yaml')):
        return False
    files = _storage_files(path)
    if not files:
        return any(_bag_of(file) for file in _files_below(path))
    return len(files) > 1 and not all(_is_part(path, name) for name in files)


def _storage_files(folder: str) -> list[str]:
    """Return the names of the storage files in a folder."""
    from msg_adapters.bag_storage import is_storage
    with os.scandir(folder) as entries:
        return [entry.name for entry in entries if is_storage(Path(entry.path))]
