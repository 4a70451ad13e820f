# SPDX-License-Identifier: Apache-2.0
"""Cache fields on disk by the hash of the bone and the voxel size."""

from __future__ import annotations

import fcntl
import logging
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gsdf_registration.common.result import InputError
from gsdf_registration.common.user_cache import user_cache
from gsdf_registration.field.build import build_field
from gsdf_registration.field.field import Field
from gsdf_registration.field.store import VERSION, load_field, save_field
from gsdf_registration.mesh.bone import Bone

# <hash of the bone>-<voxel size in micrometres>um-v<version>.gsdf, and the bone of a file, see
# `gsdf_registration.field.known_bones`; what a process leaves that is killed while it writes has
# a further suffix and may begin with a dot
NAME = re.compile(r'\.?[0-9a-f]{32}(-\d+um-v\d+\.(gsdf|lock)|\.bone\.json).*')

_log = logging.getLogger('gsdf_registration')


def cache_directory() -> Path:
    """Return ``$GSDF_CACHE_DIR``, else the folder ``gsdf`` in the cache folder of the user."""
    directory = os.environ.get('GSDF_CACHE_DIR')
    if directory:
        return Path(directory)
    return user_cache() / 'gsdf'


def cached_field(bone: Bone, voxel_size: float = 0.001) -> Field:
    """
    Return the field of a bone from the cache; build and cache it if it is not there.

    A damaged file is replaced. If the cache cannot be written, a warning is logged.

    Parameters
    ----------
    bone : Bone
    voxel_size : float, metres

    """
    found = stored_field(bone.sha256, voxel_size)
    if found is not None:
        return found
    path = _path(bone.sha256, voxel_size)
    with _only_builder(path):
        return (stored_field(bone.sha256, voxel_size, logging.WARNING)
                or _built(path, bone, voxel_size))


def stored_field(bone_sha256: str, voxel_size: float, level: int = logging.DEBUG) -> Field | None:
    """
    Return the field of a bone from the cache.

    None if it is not there, or if its file is damaged, which is logged with this level.
    """
    path = _path(bone_sha256, voxel_size)
    if not path.exists():
        return None
    try:
        field = load_field(path)
    except InputError as error:
        _log.log(level, '%s', error.message)
        return None
    return field if field.bone_sha256 == bone_sha256 and field.voxel_size == voxel_size else None


def cached_files() -> list[Path]:
    """Return the files of this cache, by name; other files in its folder are left alone."""
    with suppress(OSError):
        return sorted(path for path in cache_directory().iterdir() if NAME.fullmatch(path.name))
    return []


def clear_cache() -> list[str]:
    """Delete the files of this cache; return one sentence for each that cannot be deleted."""
    problems = []
    for path in cached_files():
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            problems.append(f'{path} cannot be deleted: {error.strerror}')
    return problems


def _path(bone_sha256: str, voxel_size: float) -> Path:
    return cache_directory() / f'{bone_sha256[:32]}-{voxel_size * 1e6:.0f}um-v{VERSION}.gsdf'


def _built(path: Path, bone: Bone, voxel_size: float) -> Field:
    """Build a field and write it to the cache."""
    field = build_field(bone, voxel_size)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_field(field, path)
    except (OSError, InputError) as error:
        _log.warning('the field could not be cached: %s', error)
    return field


@contextmanager
def _only_builder(path: Path) -> Iterator[None]:
    """Wait while another process builds the same field; nobody waits on a disk without locks."""
    lock, handle = path.with_suffix('.lock'), -1
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(lock, os.O_CREAT | os.O_RDWR, 0o666)
        fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield
    finally:
        if handle >= 0:
            with suppress(OSError):     # those who wait hold the file, and find the field
                lock.unlink()
            os.close(handle)
