# SPDX-License-Identifier: Apache-2.0
"""
``gsdf``: build fields, register points, replay recordings.

Exit status: 0 success, 1 refused, 2 bad usage or unreadable input (one line on stderr).
"""

from __future__ import annotations

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from gsdf_registration import __version__
from gsdf_registration.cli.common import example
from gsdf_registration.common.result import Refusal

SUBCOMMANDS = ('build', 'register', 'replay', 'import_ndi', 'simulate', 'show', 'demo')


class Parser(argparse.ArgumentParser):
    """An `ArgumentParser` that says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with status 2."""
        self.exit(2, f'gsdf: error: {message} (see {self.prog} --help)\n')


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of all subcommands; each brings its own ``run``."""
    parser = Parser(prog='gsdf', description='Find a bone under a tracked probe.',
                    **example('gsdf register hip.stl points.csv --unit mm --report hip.html'))
    parser.add_argument('--version', action='version', version=f'gsdf {__version__}')
    subparsers = parser.add_subparsers(title='subcommands', metavar='COMMAND', required=True)
    for name in SUBCOMMANDS:
        importlib.import_module(f'gsdf_registration.cli.{name}').add_parser(subparsers)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run one subcommand and return its exit status."""
    logging.basicConfig(format='gsdf: %(message)s', level=logging.WARNING)
    try:
        args = make_parser().parse_args(argv)
        status: int = args.run(args)
        sys.stdout.flush()
        return status
    except Refusal as refusal:
        print(f'gsdf: error: {refusal.message}', file=sys.stderr)
        return 2
    except BrokenPipeError:     # whoever read our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        print(f'gsdf: error: {error.filename or "input or output"}: {error.strerror}',
              file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == '__main__':
    sys.exit(main())
