# SPDX-License-Identifier: Apache-2.0
"""``gsdf cache``: list or delete the fields that are kept on disk."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from gsdf_registration.common.command_line import example
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'cache', help='list or delete the fields that are kept on disk',
        description='A field is built once for each bone and voxel size and kept in the cache '
        'folder, see `gsdf cache list`. GSDF_CACHE_DIR chooses another folder. A field that was '
        'deleted is built again when it is needed.', **example('gsdf cache list'))
    parser.add_argument('action', choices=('list', 'clear'),
                        help='list: folder, voxel size, size and date of each field; clear: delete '
                        'them; other files in the folder stay')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """List or delete the files."""
    from gsdf_registration.field.cache import cache_directory, cached_files, clear_cache

    files = cached_files()
    fields = [path for path in files if path.suffix == '.gsdf']
    summary = f'{format_count(len(fields), "field")}, {_megabytes(files)}'
    if args.action == 'list':
        for path in fields:
            print(_line(path))
        print(f'{summary} in {cache_directory()}')
        return 0
    problems = clear_cache()
    if problems:
        raise InputError('; '.join(problems))
    print(f'deleted from {cache_directory()}: {summary}')
    return 0


def _line(path: Path) -> str:
    """Return hash of the bone, voxel size, size, and date of a field."""
    bone, voxel, _ = path.stem.split('-')
    date = time.strftime('%Y-%m-%d %H:%M', time.localtime(path.stat().st_mtime))
    return f'{bone}  {1e-3 * float(voxel[:-2]):5g} mm  {_megabytes([path]):>9}  {date}'


def _megabytes(files: list[Path]) -> str:
    return f'{1e-6 * sum(path.stat().st_size for path in files):.1f} MB'
