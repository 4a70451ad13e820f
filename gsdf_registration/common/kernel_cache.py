# SPDX-License-Identifier: Apache-2.0
"""
Where compiled kernels are kept on disk, and whether all of them are there.

It does not import numba, which reads ``NUMBA_CACHE_DIR`` and takes a second.
"""

from __future__ import annotations

import logging
import os
import platform
from importlib.metadata import version
from pathlib import Path

import llvmlite.binding

from gsdf_registration.common.user_cache import (
    hash_of_code,
    is_writable,
    temporary_cache,
    user_cache,
)

PACKAGE = Path(__file__).parents[1]
IN_PACKAGE = Path(__file__).parent / '__pycache__'
KERNEL_FOLDERS = ('common', 'field', 'mesh', 'search', 'solver')

_log = logging.getLogger('gsdf_registration')


def cache_folder() -> Path | None:
    """Return the folder of the cache of this module, as numba uses it; None: there is no cache."""
    if not _cached:
        return None
    folder = os.environ.get('NUMBA_CACHE_DIR')
    return Path(folder) if folder else IN_PACKAGE


def _choose_cache() -> bool:
    """
    Set ``NUMBA_CACHE_DIR`` if the folder of the package cannot be written.

    Then it is the cache folder of the user, else a temporary one. Return whether there is a cache.
    """
    chosen = os.environ.get('NUMBA_CACHE_DIR')
    if is_writable(Path(chosen) if chosen else IN_PACKAGE):
        return True
    folder = user_cache() / 'gsdf' / 'kernels'
    if chosen or not is_writable(folder, private=True):
        folder = temporary_cache() / 'kernels'
        if not (is_writable(folder.parent, private=True) and is_writable(folder, private=True)):
            os.environ.pop('NUMBA_CACHE_DIR', None)
            _log.warning('no folder for compiled kernels can be written, so they are compiled at '
                         'each start; set NUMBA_CACHE_DIR to a folder that can be written')
            return False
        _log.warning('compiled kernels are kept in %s, because %s cannot be written; set '
                     'NUMBA_CACHE_DIR to a folder that lasts', folder,
                     chosen or 'neither the package nor the cache folder of the user')
    os.environ['NUMBA_CACHE_DIR'] = str(folder)
    return True


def kernels_compiled() -> bool:
    """Return whether all kernels are in the cache; takes some milliseconds."""
    marker = _marker()
    return marker is not None and marker.exists()


def mark_compiled() -> None:
    """Remember that all kernels are in the cache."""
    marker = _marker()
    if marker is None:
        return
    try:
        marker.touch()
    except OSError as error:
        _log.warning('%s cannot be written: %s', marker, error.strerror)


def _marker() -> Path | None:
    """
    Return the file that exists once all kernels are in the cache; None without a cache.

    Its name depends on all that the compiled code depends on.
    """
    folder = cache_folder()
    if folder is None:
        return None
    found = hash_of_code((
        str(PACKAGE), version('numba'), version('llvmlite'), platform.python_version(),
        llvmlite.binding.get_host_cpu_name()), (PACKAGE / name for name in KERNEL_FOLDERS))
    return folder / f'kernels-{found[:16]}.compiled'


_cached = _choose_cache()
