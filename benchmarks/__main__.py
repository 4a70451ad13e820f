# SPDX-License-Identifier: Apache-2.0
"""
``python -m benchmarks NAME``: compare accuracy and speed with other libraries.

Exit codes: 0 success, 2 bad usage or unreadable input (one line on stderr).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

from gsdf_registration.common.command_line import Parser, example, run_command

BENCHMARKS = ('field', 'solve', 'search', 'trust', 'calibration', 'paper', 'guided', 'live',
              'console', 'start', 'pivot', 'air', 'landmarks', 'archive', 'phantom',
              'fixtures')


def make_parser() -> Parser:
    """Return the parser of all benchmarks; each sets its own ``run``."""
    parser = Parser(prog='python -m benchmarks',
                    description='Compare accuracy and speed with other libraries.',
                    **example('python -m benchmarks field'))
    subparsers = parser.add_subparsers(title='benchmarks', metavar='NAME', required=True)
    for name in BENCHMARKS:
        importlib.import_module(f'benchmarks.commands.{name}').add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one benchmark and return its exit code."""
    return run_command(make_parser(), argv)


if __name__ == '__main__':
    sys.exit(main())
