# SPDX-License-Identifier: Apache-2.0
"""Folders for files that can be made again, also for users without a home."""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
from collections.abc import Iterable
from pathlib import Path


def user_cache() -> Path:
    """
    Return the cache folder of the user, which may not exist or not be writable.

    This is ``$XDG_CACHE_HOME``, else ``.cache`` in the home of the user, else a folder for this
    user among the temporary files.
    """
    base = os.environ.get('XDG_CACHE_HOME')
    if base:
        return Path(base)
    try:
        return Path.home() / '.cache'
    except RuntimeError:    # neither HOME is set nor does the user have an entry in passwd
        return temporary_cache()


def temporary_cache() -> Path:
    """Return the folder for this user among the temporary files."""
    user = os.getuid() if hasattr(os, 'getuid') else 0
    return Path(os.environ.get('TMPDIR') or '/tmp') / f'gsdf-{user}'


def hash_of_code(facts: object, folders: Iterable[Path]) -> str:
    """Return the hash of the Python sources in some folders, and of ``facts``, by its `repr`."""
    digest = hashlib.sha256(repr(facts).encode())
    for folder in folders:
        for file in sorted(folder.glob('*.py')):
            digest.update(file.read_bytes())
    return digest.hexdigest()


def is_writable(folder: Path, private: bool = False) -> bool:
    """
    Create a folder if it is missing; return whether files can be written there.

    ``private``: and whether no other user can write there.
    """
    try:
        folder.mkdir(mode=0o700 if private else 0o777, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
        found = folder.lstat()
    except OSError:
        return False
    return not private or (stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
                           and not found.st_mode & 0o022)
