# SPDX-License-Identifier: Apache-2.0
"""
The tip of a probe as a settings file: ``probe.tip`` and ``probe.tip_error``.

The first line identifies the file.  Covariance, source and date are comments, because they are no
settings.  A file that this module did not write is never replaced; one that it wrote is kept under
another name, with its date.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, rms_error
from msg_adapters.files import irregular, keep_with_date, write_atomically
from msg_adapters.session_file import now

MARK = '# gsdf-tip/1: '
SUFFIXES = ('.yaml', '.yml')


def tip_path(session_path: Path) -> Path:
    """Return the path of the tip that a node calibrates, beside its session file."""
    return session_path.with_suffix('.tip.yaml')


def write_tip(path: str | os.PathLike[str], tip: Array, covariance: Array, summary: str,
              source: str) -> Path | None:
    """
    Write a tip for ``--params-file`` of the node and ``--config`` of the command line.

    Parameters
    ----------
    path
    tip : (3,) float, m, in the frame of the tool
    covariance : (3, 3) float, m^2
    summary : str, one sentence on the accuracy
    source : str, recording or topic

    Returns
    -------
    Path or None
        Where the tip that was there before is kept; None if there was none.

    Raises
    ------
    InputError
        If the file cannot be written, or another file is there; nothing is changed then.

    """
    path, kept = Path(path), None
    check_tip_path(path)

    def keep() -> None:
        nonlocal kept
        if path.exists():
            check_tip_path(path)
            kept = keep_with_date(path)

    write_atomically(path, _text(tip, covariance, summary, source), before=keep)
    return kept


def _text(tip: Array, covariance: Array, summary: str, source: str) -> str:
    about = [f'tip of a probe, calibrated {now()}', f'from {source}', summary,
             'covariance of x y z, m^2:',
             *('  ' + '  '.join(f'{value: .4e}' for value in row) for row in covariance.tolist())]
    comments = ''.join(f'# {" ".join(line.split())}\n' for line in about[1:])
    values = ', '.join(repr(value) for value in np.asarray(tip).tolist())
    return (f'{MARK}{about[0]}\n{comments}/**:\n  ros__parameters:\n    probe:\n'
            f'      # position of the tip in the frame of the tool [m]\n      tip: [{values}]\n'
            '      # its expected error, RMS distance [m]\n'
            f'      tip_error: {rms_error(covariance)!r}\n')


def check_tip_path(path: str | os.PathLike[str]) -> None:
    """Raise `InputError` unless a tip can be written there: nothing else is overwritten."""
    path = Path(path)
    if path.suffix not in SUFFIXES:
        raise InputError(f'{path}: the name of a tip file ends with .yaml')
    try:
        found = irregular(path)
        if not found and path.exists():
            with path.open('rb') as file:
                found = '' if file.read(len(MARK)) == MARK.encode() else 'no tip file'
    except OSError as error:
        raise InputError(f'{path} cannot be written: {error.strerror}') from None
    if found:
        raise InputError(f'{path} is {found}, so it is not overwritten; choose another name')
