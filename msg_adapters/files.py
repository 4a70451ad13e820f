# SPDX-License-Identifier: Apache-2.0
"""Read and write files, with one-line errors; convert units of length."""

from __future__ import annotations

import codecs
import contextlib
import datetime
import hashlib
import json
import os
import stat
import tempfile
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import shortened

METRES = {'mm': 0.001, 'm': 1.0}
_KINDS = {stat.S_IFDIR: 'a directory', stat.S_IFLNK: 'a symbolic link', stat.S_IFIFO: 'a FIFO',
          stat.S_IFSOCK: 'a socket', stat.S_IFCHR: 'a device', stat.S_IFBLK: 'a device'}


def unit_scale(unit: str) -> float:
    """Return the length of a unit in metres; raise `InputError` unless it is mm or m."""
    try:
        return METRES[unit]
    except (KeyError, TypeError):
        raise InputError(f'unit {unit!r} is unknown; choose mm or m') from None


def absolute_path(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` as an absolute path, with ``~`` expanded; `InputError` if it has none."""
    try:
        if '\0' in os.fspath(path):
            raise ValueError('a path contains no null byte')
        return Path(os.path.abspath(Path(path).expanduser()))
    except RuntimeError:
        raise InputError(f'{shortened(str(path))}: this user has no home directory; give an '
                         'absolute path') from None
    except (OSError, ValueError) as error:     # as when the current directory was deleted
        raise InputError(f'{shortened(str(path))}: {describe_error(error)}') from None


def irregular(path: str | os.PathLike[str]) -> str:
    """Return what stands at ``path``, as 'a FIFO'; empty: a regular file, or nothing."""
    try:
        mode = os.lstat(path).st_mode
    except (FileNotFoundError, NotADirectoryError):
        return ''
    return '' if stat.S_ISREG(mode) else _KINDS.get(stat.S_IFMT(mode), 'no regular file')


def readable_file(path: str | os.PathLike[str]) -> Path:
    """Return ``path``; raise `InputError` unless it is a file that is not empty."""
    path = Path(path)
    try:
        found = os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f'{path} does not exist') from None
    except (OSError, ValueError) as error:     # a name that is too long, a null byte
        raise InputError(f'{path} cannot be read: {_cause(error)}') from None
    if stat.S_ISDIR(found.st_mode):
        raise InputError(f'{path} is a directory; choose a file')
    if not stat.S_ISREG(found.st_mode):
        raise InputError(f'{path} is {_KINDS.get(stat.S_IFMT(found.st_mode), "no file")}; choose a '
                         'regular file')
    if found.st_size == 0:
        raise InputError(f'{path} is empty')
    return path


def open_file(path: str | os.PathLike[str], limit: int) -> BinaryIO:
    """
    Open a regular file of at most ``limit`` bytes, that is not empty, for reading.

    Raises
    ------
    InputError
        If there is none, or it cannot be read.

    """
    path = readable_file(path)
    try:
        # should a FIFO replace the file meanwhile, this does not wait for its writer
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise InputError(f'{path} cannot be read: {_cause(error)}') from None
    found = os.fstat(handle)
    if stat.S_ISREG(found.st_mode) and found.st_size <= limit:
        return open(handle, 'rb')   # noqa: SIM115 - the caller closes it
    os.close(handle)
    raise InputError(f'{path} is too large: {found.st_size / 1e6:.0f} MB, of at most '
                     f'{limit / 1e6:.0f} MB')


def read_text(path: str | os.PathLike[str], legacy: str = '') -> str:
    """
    Return the text of a file in UTF-8 or, with a byte order mark, UTF-16; lines end with a newline.

    ``legacy`` is the encoding of files that are neither, if they can be anything else.
    """
    path = readable_file(path)
    try:
        content = path.read_bytes()
        marked = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = _decoded(content, ['utf-16'] if marked else
                        ['utf-8-sig', legacy] if legacy else ['utf-8-sig'])
    except UnicodeDecodeError:
        raise InputError(
            f'{path} is not UTF-8 text; save it as plain text or CSV (UTF-8)') from None
    except OSError as error:
        raise InputError(f'{path} cannot be read: {_cause(error)}') from None
    return text.replace('\r\n', '\n').replace('\r', '\n')


def read_json(path: str | os.PathLike[str]) -> Any:
    """Return the content of a JSON file; raise `InputError` if it is not valid JSON."""
    try:
        return json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise InputError(f'{path}, line {error.lineno}: this is not valid JSON') from None
    except (ValueError, RecursionError):   # a number of too many digits; nested too deeply
        raise InputError(f'{path}: this is not valid JSON') from None


def parse_yaml(text: str) -> Any:
    """Return the content of a YAML text; raise `yaml.YAMLError` if it is not valid."""
    import yaml
    loader = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # of libyaml: 10 times as fast
    return yaml.load(text, loader)      # noqa: S506 - both loaders are safe


def _decoded(content: bytes, encodings: Sequence[str]) -> str:
    """Return the text in the first encoding that is valid; a null byte is in no text."""
    for encoding in encodings:
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if '\0' not in text:
            return text
    raise UnicodeDecodeError(encodings[0], content, 0, 1, 'not text')


def describe_error(error: Exception) -> str:
    """Return the message of an exception on one line, or its type if it has no message."""
    return ' '.join(str(error).split()).rstrip('.!') or type(error).__name__


def _cause(error: Exception) -> str:
    """Return the message of an exception, without the path that an OSError repeats."""
    return (error.strerror if isinstance(error, OSError) else None) or describe_error(error)


def sha256_of(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file, or of all files of a bag directory in order of their names."""
    root = Path(path)
    digest = hashlib.sha256()
    for file in sorted(p for p in root.iterdir() if p.is_file()) if root.is_dir() else [root]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def keep_with_date(path: Path) -> Path:
    """Give a file another name, with its date, and return it; ``path`` may stay or not."""
    date = datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.timezone.utc)
    stem, number = f'{path.stem}.{date:%Y-%m-%dT%H-%M-%SZ}', 1
    while True:
        kept = path.with_name(f'{stem}{"" if number == 1 else f"-{number}"}{path.suffix}')
        try:
            os.link(path, kept)     # never overwrites
            return kept
        except FileExistsError:
            number += 1
        except OSError:     # a file system without hard links
            if kept.exists():
                number += 1
                continue
            os.rename(path, kept)
            return kept


def write_atomically(path: str | os.PathLike[str], content: str | bytes | Iterable[bytes],
                     before: Callable[[], None] = lambda: None) -> None:
    """
    Replace a file so that a reader or a crash sees the old or the new content, never a part.

    Text is encoded as UTF-8, blocks are written one by one.  The file keeps its permissions; a new
    one can be read by everybody.

    Parameters
    ----------
    path
    content
    before : callable, optional
        Called when the content is on the disk, just before it replaces the file.

    Raises
    ------
    InputError
        If the file cannot be written, or is a link or a device; it is then unchanged.

    """
    path = Path(path)
    temporary = None
    try:
        found = irregular(path)
        if found:
            raise InputError(f'{path} is {found}, which is not replaced; choose another path')
        # mkstemp creates files that only the owner can read
        mode = stat.S_IMODE(os.stat(path).st_mode) if path.exists() else 0o644
        # in the same directory: a rename is atomic only within one file system
        handle, temporary = tempfile.mkstemp(prefix=f'.{path.name[:64]}.', dir=path.parent)
        with os.fdopen(handle, 'wb') as file:
            text = content.encode() if isinstance(content, str) else content
            file.writelines([text] if isinstance(text, bytes) else text)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, mode)
        before()
        os.replace(temporary, path)
        temporary = None
    except (OSError, ValueError) as error:
        raise InputError(f'{path} cannot be written: {_cause(error)}') from None
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
