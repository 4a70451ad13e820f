# SPDX-License-Identifier: Apache-2.0
"""What every reader asks first: is it there, is it a file, and what are its numbers in metres."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from gsdf_registration.common.result import InputError

METRES = {'mm': 0.001, 'm': 1.0}


def metres_per(unit: str) -> float:
    """Return the length of one ``unit`` ('mm' or 'm') in metres; `InputError` for other words."""
    try:
        return METRES[unit]
    except (KeyError, TypeError):
        raise InputError(f'unit {unit!r} is not known: say mm or m') from None


def readable_file(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` if it is a file with something in it, else raise `InputError`."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f'{path} is a directory: give a file')
    if not path.is_file():
        raise InputError(f'{path} does not exist')
    if path.stat().st_size == 0:
        raise InputError(f'{path} is empty')
    return path


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a UTF-8 file (byte order mark or not), or raise `InputError`."""
    path = readable_file(path)
    try:
        return path.read_text(encoding='utf-8-sig')
    except UnicodeDecodeError:
        raise InputError(
            f'{path} is not UTF-8 text: save it as plain text or CSV (UTF-8)') from None
    except OSError as error:
        raise InputError(f'{path} cannot be read: {error.strerror}') from None


def words_of(error: Exception) -> str:
    """Return what a library's exception says on one line, or its kind if it says nothing."""
    return ' '.join(str(error).split()).rstrip('.!') or type(error).__name__


def write_atomically(path: str | os.PathLike[str], content: str | bytes) -> None:
    """
    Write a file so that a reader, or a crash, sees the old one or the new, never a part.

    Text is written as UTF-8.

    Raises
    ------
    InputError
        If the file cannot be written; what stood there is then untouched.

    """
    path = Path(path)
    temporary = None
    try:
        # in the same directory: a rename is atomic only within one file system
        handle, temporary = tempfile.mkstemp(prefix=f'.{path.name}.', dir=path.parent)
        with os.fdopen(handle, 'wb') as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)  # mkstemp's file is for the owner alone
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        raise InputError(f'{path} cannot be written: {error.strerror}') from None
    finally:
        if temporary is not None:
            os.unlink(temporary)
