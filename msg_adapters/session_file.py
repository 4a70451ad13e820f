# SPDX-License-Identifier: Apache-2.0
"""A session on disk: JSON, written in one step, so that a crash leaves the last good file."""

from __future__ import annotations

import json
import os
from typing import Any

from gsdf_registration.result import InputError
from msg_adapters.files import read_text, write_atomically

SCHEMA = 'gsdf-session/1'


def write_session(path: str | os.PathLike[str], session: dict[str, Any]) -> None:
    """
    Write a session's plain values (`Session.to_dict`), replacing the file in one step.

    Raises
    ------
    InputError
        If the file cannot be written, or a value is not finite or not plain; the old one stays.

    """
    try:
        text = json.dumps({'schema': SCHEMA} | session, allow_nan=False, indent=1)
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
