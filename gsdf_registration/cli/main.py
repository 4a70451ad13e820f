# SPDX-License-Identifier: Apache-2.0
"""
``gsdf``: build fields, register points, replay recordings.

Exit codes: 0 success, 1 rejected, 2 bad usage or unreadable input (one line on stderr).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from gsdf_registration import __version__
from gsdf_registration.common.command_line import Parser, example, run_command

SUBCOMMANDS = ('build', 'register', 'replay', 'record', 'import_ndi', 'import_plus', 'simulate',
               'show', 'view', 'compare', 'pivot', 'landmarks', 'demo', 'warm_up', 'cache', 'igtl')


def make_parser() -> Parser:
    """Return the parser of all subcommands; each sets its own ``run``."""
    parser = Parser(prog='gsdf', description='Find a bone under a tracked probe.',
                    **example('gsdf register hip.stl points.csv --unit mm --report hip.html'))
    parser.add_argument('--version', action='version', version=f'gsdf {__version__}')
    subparsers = parser.add_subparsers(title='subcommands', metavar='COMMAND', required=True)
    for name in SUBCOMMANDS:
        importlib.import_module(f'gsdf_registration.cli.{name}').add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit code."""
    return run_command(make_parser(), argv)


if __name__ == '__main__':
    sys.exit(main())
