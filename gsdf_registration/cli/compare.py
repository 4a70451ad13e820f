# SPDX-License-Identifier: Apache-2.0
"""``gsdf compare``: how two results of a registration differ, or two runs over an archive."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from gsdf_registration.common.command_line import example, number
from gsdf_registration.common.result import InputError

NEEDED = ('reason', 'message', 'T_tracker_bone', 'bone_pose', 'inputs', 'predicted_tre_m', 'config')
LIMIT = 0.5     # mm
EXAMPLES = ('gsdf compare a.json b.json --report difference.html',
            'gsdf compare release_1 release_2 --limit 0.5 --report releases.html')


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'compare', help='compare two results, or two runs over an archive',
        description='Compare two results that register or replay wrote with --json: how far the '
        'poses are apart at the targets, the expected errors, and the settings that differ. Or '
        'compare two folders of replay --output: the recordings with another verdict, and those '
        'whose pose moved. The exit status is then 1 if there are any.', **example(*EXAMPLES))
    parser.add_argument('first', metavar='A', help='result of --json, or folder of --output')
    parser.add_argument('second', metavar='B', help='another one')
    parser.add_argument('--limit', type=number, metavar='MM',
                        help='of folders: list the poses that moved by more, at the targets, else '
                        f'on the bone around the touched area (default: {LIMIT:g})')
    parser.add_argument('--report', metavar='OUT.html', help='write the comparison as a page')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the comparison, and write the page if asked for."""
    folders = [Path(path).is_dir() for path in (args.first, args.second)]
    if all(folders):
        return _compare_runs(args)
    if any(folders):
        raise InputError('give two results (JSON) or two folders of gsdf replay --output')
    if args.limit is not None:
        raise InputError('--limit is for two folders of gsdf replay --output')
    return _compare_results(args)


def _compare_results(args: argparse.Namespace) -> int:
    from gsdf_registration.registration.result_comparison import compare
    from gsdf_registration.visualization.comparison_page import comparison_text, write_comparison
    names = Path(args.first).name, Path(args.second).name
    documents = read_result(args.first), read_result(args.second)
    try:
        comparison = compare(*documents)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f'{args.first} or {args.second} is damaged: {error}') from None
    print(comparison_text(comparison, names))
    if args.report:
        write_comparison(args.report, comparison, names)
    return 0


def _compare_runs(args: argparse.Namespace) -> int:
    """Compare two folders; return 1 if something changed."""
    from gsdf_registration.cli.archive_table import CSV, read_csv
    from gsdf_registration.registration.run_comparison import compare_runs
    from gsdf_registration.visualization.run_comparison_page import (
        comparison_text,
        write_comparison,
    )
    limit = LIMIT if args.limit is None else args.limit
    if not limit >= 0.0:
        raise InputError(f'--limit must be 0 or more, not {limit:g}')
    found = compare_runs(read_csv(Path(args.first, CSV)), read_csv(Path(args.second, CSV)),
                         1e-3 * limit)
    names, settings = (args.first, args.second), _settings(args.first, args.second, found.settings)
    print(comparison_text(found, settings, names))
    if args.report:
        write_comparison(args.report, found, settings, names)
    return int(found.changed)


def _settings(first: str, second: str,
              pairs: set[tuple[str, str]]) -> dict[str, list[tuple[Any, Any]]]:
    """Return the settings that differ between two runs, with all pairs of values."""
    from gsdf_registration.cli.archive_table import read_settings
    from gsdf_registration.registration.result_comparison import changed_settings
    a, b = (read_settings(Path(folder)) for folder in (first, second))
    differing: dict[str, list[tuple[Any, Any]]] = {}
    for one, other in sorted(pairs):
        changed = changed_settings(a.get(one, {}), b.get(other, {}))
        for name, values in changed.items():
            if name != 'model.path' and values not in differing.setdefault(name, []):
                differing[name].append(values)
    return {name: values for name, values in differing.items() if values}


def read_result(path: str) -> dict[str, Any]:
    """Return the JSON document of a result; `InputError` if the file is none."""
    from gsdf_registration.cli.result_json import SCHEMA
    from msg_adapters.files import read_json
    document = read_json(path)
    if isinstance(document, list):
        raise InputError(f'{path} has the results of several recordings; give a file of one')
    if not isinstance(document, dict) or document.get('schema') != SCHEMA or not all(
            name in document for name in NEEDED):
        raise InputError(f'{path} is no result of the schema {SCHEMA}; write one with --json')
    return document
