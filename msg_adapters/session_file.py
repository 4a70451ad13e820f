# SPDX-License-Identifier: Apache-2.0
"""
A session file: readable JSON, written in one step.

Schema "gsdf-session/2"; SI units, frames by name; null means unknown:

- ``saved``: the time; ``versions``: of the software; ``model_sha256``: of the bone model;
- ``frames``: of the ``points``, of the accepted ``pose``, and of the ``bone``;
- ``collecting``: whether points were being collected; ``sources``: the topics of the points;
- ``rejected``: number of rejected samples by cause;
- ``landmarks``: name, model position, position of the stationary tip, its spread, stamp;
- ``verifications``: position of the stationary tip, distance to the surface, stamp, number of the
  checkpoint and how far it has moved since it was first touched;
- ``result``: the last registration; ``pose_result``: the accepted registration;
- ``parameters``: the settings by dotted name;
- ``points``: one per line, with the columns in ``columns``: stroke, number of its source (from 0),
  stamp, position, and its residual and weight in the accepted registration.
"""

from __future__ import annotations

import datetime
import json
import os
from collections.abc import Iterator
from typing import Any

from gsdf_registration.common.result import InputError
from msg_adapters.files import read_text, write_atomically

SCHEMA = 'gsdf-session/2'


def write_session(path: str | os.PathLike[str], session: dict[str, Any]) -> None:
    """
    Write a session record (`Session.to_dict`), replacing the file in one step.

    Raises
    ------
    InputError
        If the file cannot be written, or a value is not finite or not plain; the old file stays.

    """
    try:
        text = ''.join(_lines({'schema': SCHEMA, 'saved': now()} | session))
    except (TypeError, ValueError) as error:
        raise InputError(f'{path}: the session cannot be written as JSON: {error}') from None
    write_atomically(path, text + '\n')


def read_session(path: str | os.PathLike[str]) -> dict[str, Any]:
    """
    Read a session record from a file.

    Raises
    ------
    InputError
        If the file is missing, damaged, or has another schema.

    """
    try:
        session = json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError):
        raise InputError(f'{path} is damaged: it is not valid JSON') from None
    if not isinstance(session, dict) or session.get('schema') != SCHEMA:
        raise InputError(f'{path} is not a session of schema {SCHEMA}')
    return session


def now() -> str:
    """Return the present time in UTC, to the second."""
    return datetime.datetime.now(datetime.timezone.utc).isoformat(timespec='seconds')


def _lines(value: Any, indent: str = '') -> Iterator[str]:
    """Yield JSON text with every list of plain numbers or strings on one line."""
    inner = indent + '  '
    if isinstance(value, dict) and value:
        for count, (key, item) in enumerate(value.items()):
            yield f'{"," if count else "{"}\n{inner}{json.dumps(key)}: '
            yield from _lines(item, inner)
        yield f'\n{indent}}}'
    elif isinstance(value, list) and any(isinstance(item, (dict, list)) for item in value):
        for count, item in enumerate(value):
            yield f'{"," if count else "["}\n{inner}'
            yield from _lines(item, inner)
        yield f'\n{indent}]'
    else:
        yield json.dumps(value, allow_nan=False)
