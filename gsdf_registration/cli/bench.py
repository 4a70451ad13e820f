# SPDX-License-Identifier: Apache-2.0
"""``gsdf bench``: measurements beside other libraries' in the same run."""

from __future__ import annotations

import importlib
from typing import Any

from gsdf_registration.cli.common import example

BENCHES = ('live',)


def add_parser(subparsers: Any) -> None:
    """
    Add the subcommand with one of its own for each bench.

    A bench is a file ``bench_<name>.py`` here.
    """
    parser = subparsers.add_parser(
        'bench', help='measure speed and accuracy beside other libraries',
        description='Measure speed and accuracy beside other libraries, in the same run.',
        **example('gsdf bench field'))
    benches = parser.add_subparsers(title='benches', metavar='BENCH', required=True)
    for name in BENCHES:
        importlib.import_module(f'gsdf_registration.cli.bench_{name}').add_parser(benches)
