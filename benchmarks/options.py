# SPDX-License-Identifier: Apache-2.0
"""Options that the benchmarks share, and what the rows of their tables depend on."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from gsdf_registration.common.command_line import natural_number
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from benchmarks.execution.result_table import Row
    from benchmarks.protocol.cases import Case
    from gsdf_registration.common.config import Config

Job = TypeVar('Job')
SHIPPED = 'package://gsdf_registration/bags/hip.ply'


def add_bones_option(parser: argparse.ArgumentParser) -> None:
    """Add the option with the folder for `bones`."""
    parser.add_argument('--bones', metavar='DIR', default=os.environ.get('GSDF_BONES_DIR'),
                        help='folder of meshes (PLY, STL, OBJ, OFF; mm) (default: $GSDF_BONES_DIR, '
                        'else the shipped bones)')


def add_seed_option(parser: argparse.ArgumentParser, what: str, default: int = 0) -> None:
    """Add the option with the seed; ``what`` says of what it is."""
    parser.add_argument('--seed', type=natural_number, default=default, metavar='N',
                        help=f'{what} (default: {default})')


def add_table_options(parser: argparse.ArgumentParser, row: str) -> None:
    """Add the options with the table, one row per ``row``, and with the settings."""
    parser.add_argument('-o', '--output', metavar='FILE.tsv',
                        help=f'table with a row for each {row}; an existing one is continued')
    parser.add_argument('--config', metavar='YAML',
                        help='settings, as in config/registration.yaml')


def bones(folder: str | None) -> list[Path]:
    """
    Return the meshes of a folder; without one, the shipped meshes.

    Raises
    ------
    InputError
        If the folder contains no mesh.

    """
    from gsdf_registration.field.model import find_model
    found = sorted(file
                   for file in (Path(folder) if folder else find_model(SHIPPED).parent).iterdir()
                   if file.suffix.lower() in ('.ply', '.stl', '.obj', '.off'))
    if not found:
        raise InputError(f'{folder} contains no mesh; give a folder of PLY, STL, OBJ or OFF files')
    return found


def about(cases: list[Case], seed: int, config: Config) -> dict[str, Any]:
    """Return what the rows of a table depend on, as JSON values."""
    from benchmarks.execution.result_table import source_hash
    from gsdf_registration import __version__
    from msg_adapters.files import sha256_of
    return {
        'version': __version__, 'sources': source_hash(), 'seed': seed, 'config': config.flat(),
        'cases': [case.name for case in cases],
        'bones': {Path(path).name: sha256_of(path) for path in sorted({c.bone for c in cases})}
    }


def case_of(model: str | None, region: str | None = None) -> Case:
    """Return the case of a model, mm, else of the shipped hip; in its first usual region."""
    from benchmarks.protocol.cases import find_cases
    from gsdf_registration.field.model import find_model
    return find_cases([find_model(model or SHIPPED)], [region] if region else [])[0]


def single_threaded(args: argparse.Namespace) -> Config:
    """Return the settings of ``--config``, with one thread for each search: a job has one core."""
    from msg_adapters.settings_file import read_config
    return read_config(args.config).replaced({'search.threads': 1})


def run_table(args: argparse.Namespace, cases: list[Case], config: Config, jobs: Mapping[str, Job],
              work: Callable[[Job], Row], label: str = 'trials', **depends: Any) -> list[Row]:
    """
    Return the row of each job, in the table of ``--output`` if there is one.

    Parameters
    ----------
    args : with the options of `add_seed_option` and `add_table_options`
    cases, config : what the rows depend on, beside the seed
    jobs, work, label : as in `benchmarks.execution.runner.run_all`
    depends : what else the rows depend on, JSON values

    """
    from benchmarks.execution.runner import run_all
    return run_all(jobs, work, output=Path(args.output) if args.output else None,
                   about={**about(cases, args.seed, config), **depends}, label=label)


def print_table(rows: Iterable[Sequence[str]], widths: Sequence[int]) -> None:
    """Print rows of a table, see `table_row`."""
    for cells in rows:
        print(table_row(cells, widths))


def table_row(cells: Sequence[str], widths: Sequence[int]) -> str:
    """Return a row: the first cell to the left, the others to the right, one without width last."""
    return (f'{cells[0]:<{widths[0]}}'
            + ''.join(f'{cell:>{width}}' for cell, width in zip(cells[1:], widths[1:]))
            + ''.join(f'  {cell}' for cell in cells[len(widths):]))
