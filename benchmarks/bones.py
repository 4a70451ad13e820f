# SPDX-License-Identifier: Apache-2.0
"""What the benches share: the bones they measure on, and what their tables depend on."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli.common import sha256_of
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from benchmarks.cases import Case
    from gsdf_registration.common.config import Config

SHIPPED = 'package://gsdf_registration/bags/hip.ply'


def add_bones_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the folder for `bones`."""
    parser.add_argument('--bones', metavar='DIR', default=os.environ.get('GSDF_BONES_DIR'),
                        help='meshes (PLY, STL, OBJ, OFF; mm) to measure on (default: '
                        '$GSDF_BONES_DIR, else those that come along)')


def bones(folder: str | None) -> list[Path]:
    """Return the meshes to measure on."""
    from gsdf_registration.field.model import find_model
    found = sorted(file
                   for file in (Path(folder) if folder else find_model(SHIPPED).parent).iterdir()
                   if file.suffix.lower() in ('.ply', '.stl', '.obj', '.off'))
    if not found:
        raise InputError(f'{folder} holds no mesh; give a folder of PLY, STL, OBJ or OFF files')
    return found


def about(cases: list[Case], seed: int, config: Config) -> dict[str, Any]:
    """Return all that the rows of a table depend on."""
    from benchmarks.journal import source_hash
    from gsdf_registration import __version__
    return {
        'version': __version__, 'sources': source_hash(), 'seed': seed, 'config': config.flat(),
        'cases': [case.name for case in cases],
        'bones': {Path(path).name: sha256_of(path) for path in sorted({c.bone for c in cases})}
    }
