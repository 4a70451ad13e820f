# SPDX-License-Identifier: Apache-2.0
"""``gsdf warm-up``: compile all kernels, so that the first registration does not wait for them."""

from __future__ import annotations

import argparse
import time
from typing import Any

from gsdf_registration.common.command_line import example, progress_bar


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'warm-up', help='compile all kernels ahead of use, once on a machine',
        description='Compile all kernels, which takes about half a minute, and keep them on disk. '
        'Other commands and the node do so when they need them.', **example('gsdf warm-up'))
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compile the kernels and say how long it took."""
    started = time.monotonic()
    if prepare_kernels():
        print(f'all kernels are compiled now ({time.monotonic() - started:.0f} s)')
    else:
        print('all kernels are compiled already')
    return 0


def prepare_kernels() -> bool:
    """Compile the kernels if they are not in the cache; return whether they were not."""
    from gsdf_registration.common.kernel_cache import kernels_compiled
    if kernels_compiled():
        return False
    from gsdf_registration.registration.kernels import compile_kernels
    with progress_bar('compiling, once on this machine') as show:
        compile_kernels(show)
    return True
