# SPDX-License-Identifier: Apache-2.0
"""``gsdf compare``: how two results of a registration differ."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from gsdf_registration.common.command_line import example
from gsdf_registration.common.result import InputError

NEEDED = ('reason', 'message', 'T_tracker_bone', 'bone_pose', 'inputs', 'predicted_tre_m', 'config')


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'compare', help='compare two results: poses, expected errors, settings',
        description='Compare two results that register or replay wrote with --json: how far the '
        'poses are apart at the targets, the expected errors, and the settings that differ.',
        **example('gsdf compare a.json b.json --report difference.html'))
    parser.add_argument('first', metavar='A.json', help='result of --json')
    parser.add_argument('second', metavar='B.json', help='another one')
    parser.add_argument('--report', metavar='OUT.html', help='write the comparison as a page')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the comparison, and write the page if asked for."""
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


def read_result(path: str) -> dict[str, Any]:
    """Return the JSON document of a result; `InputError` if the file is none."""
    from gsdf_registration.cli.result_json import SCHEMA
    from msg_adapters.files import read_text
    try:
        document = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise InputError(f'{path}, line {error.lineno}: this is not valid JSON') from None
    except RecursionError:
        raise InputError(f'{path}: this is not valid JSON') from None
    if isinstance(document, list):
        raise InputError(f'{path} has the results of several recordings; give a file of one')
    if not isinstance(document, dict) or document.get('schema') != SCHEMA or not all(
            name in document for name in NEEDED):
        raise InputError(f'{path} is no result of the schema {SCHEMA}; write one with --json')
    return document
