# SPDX-License-Identifier: Apache-2.0
"""
A session on disk: JSON to be read by people too, written in one step.

Schema "gsdf-session/2"; SI units, the frames by name; null is what is not known:

- ``saved``: when; ``versions``: of what wrote it; ``model_sha256``: of the bone it belongs to;
- ``frames``: that of the ``points``, that of the last good ``pose``, and that of the ``bone``;
- ``collecting``: whether points were being collected; ``sources``: the topics they came from;
- ``rejected``: samples not kept, by cause;
- ``landmarks``: name, place on the model, where the tip rested, its spread, stamp;
- ``verifications``: where the tip rested, distance to the surface, stamp, number of the checkpoint
  and how far that has moved since it was touched first;
- ``result``: the last registration; ``pose_result``: the last good one;
- ``parameters``: the settings it was made with, by dotted name;
- ``points``: one a line, as ``columns`` says: its stroke, the number of its source (from 0), stamp,
  position, and in the last good registration its residual and weight.
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
    Write a session's plain values (`Session.to_dict`), replacing the file in one step.

    Raises
    ------
    InputError
        If the file cannot be written, or a value is not finite or not plain; the old one stays.

    """
    try:
        text = ''.join(_lines({'schema': SCHEMA, 'saved': now()} | session))
    except (TypeError, ValueError) as error:
        raise InputError(f'{path}: the session cannot be written as JSON: {error}') from None
    write_atomically(path, text + '\n')


def read_session(path: str | os.PathLike[str]) -> dict[str, Any]:
    """
    Read what `write_session` wrote.

    Raises
    ------
    InputError
        If the file is missing, damaged, or no session of this schema.

    """
    try:
        session = json.loads(read_text(path))
    except (json.JSONDecodeError, RecursionError):
        raise InputError(f'{path} is damaged: it is not valid JSON') from None
    if not isinstance(session, dict) or session.get('schema') != SCHEMA:
        raise InputError(f'{path} is no session of schema {SCHEMA}')
    return session


def now() -> str:
    """Return the time, in UTC, to the second."""
    return datetime.datetime.now(datetime.timezone.utc).isoformat(timespec='seconds')


def _lines(value: Any, indent: str = '') -> Iterator[str]:
    """Yield JSON text in which every list of mere numbers or words stands on one line."""
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
