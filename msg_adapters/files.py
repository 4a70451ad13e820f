# SPDX-License-Identifier: Apache-2.0
"""Read and write files, with one-line errors; convert units of length."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

from gsdf_registration.common.result import InputError

METRES = {'mm': 0.001, 'm': 1.0}


def unit_scale(unit: str) -> float:
    """Return the length of a unit in metres; raise `InputError` unless it is mm or m."""
    try:
        return METRES[unit]
    except (KeyError, TypeError):
        raise InputError(f'unit {unit!r} is unknown; choose mm or m') from None


def readable_file(path: str | os.PathLike[str]) -> Path:
    """Return ``path``; raise `InputError` unless it is a file that is not empty."""
    path = Path(path)
    if path.is_dir():
        raise InputError(f'{path} is a directory; choose a file')
    if not path.is_file():
        raise InputError(f'{path} does not exist')
    if path.stat().st_size == 0:
        raise InputError(f'{path} is empty')
    return path


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a UTF-8 file, with or without a byte order mark."""
    path = readable_file(path)
    try:
        return path.read_text(encoding='utf-8-sig')
    except UnicodeDecodeError:
        raise InputError(
            f'{path} is not UTF-8 text; save it as plain text or CSV (UTF-8)') from None
    except OSError as error:
        raise InputError(f'{path} cannot be read: {error.strerror}') from None


def describe_error(error: Exception) -> str:
    """Return the message of an exception on one line, or its type if it has no message."""
    return ' '.join(str(error).split()).rstrip('.!') or type(error).__name__


def sha256_of(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file, or of all files of a bag directory in order of their names."""
    root = Path(path)
    digest = hashlib.sha256()
    for file in sorted(p for p in root.iterdir() if p.is_file()) if root.is_dir() else [root]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def write_atomically(path: str | os.PathLike[str], content: str | bytes) -> None:
    """
    Replace a file so that a reader or a crash sees the old or the new content, never a part.

    Text is encoded as UTF-8.

    Raises
    ------
    InputError
        If the file cannot be written; the old file is then unchanged.

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
        os.chmod(temporary, 0o644)  # mkstemp creates files that only the owner can read
        os.replace(temporary, path)
        temporary = None
    except OSError as error:
        raise InputError(f'{path} cannot be written: {error.strerror}') from None
    finally:
        if temporary is not None:
            os.unlink(temporary)
