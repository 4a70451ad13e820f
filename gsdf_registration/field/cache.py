# SPDX-License-Identifier: Apache-2.0
"""Fields kept between runs, by content: the same bone at the same voxel size is built once."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from gsdf_registration.common.result import InputError
from gsdf_registration.field.build import build_field
from gsdf_registration.field.field import Field
from gsdf_registration.field.store import VERSION, load_field, save_field
from gsdf_registration.mesh.bone import Bone

_log = logging.getLogger('gsdf_registration')


def cache_directory() -> Path:
    """Return where fields are kept: ``$GSDF_CACHE_DIR``, else ``gsdf`` in the user's XDG cache."""
    chosen = os.environ.get('GSDF_CACHE_DIR')
    if chosen:
        return Path(chosen)
    base = os.environ.get('XDG_CACHE_HOME')
    return (Path(base) if base else Path.home() / '.cache') / 'gsdf'


def cached_field(bone: Bone, voxel_size: float = 0.001) -> Field:
    """
    Return the field of a bone from the cache, or build and keep it.

    A damaged file is replaced; where nothing can be kept, the field is built every time.

    Parameters
    ----------
    bone : Bone
    voxel_size : float, metres

    """
    path = cache_directory() / f'{bone.sha256[:32]}-{voxel_size * 1e6:.0f}um-v{VERSION}.gsdf'
    if path.exists():
        try:
            field = load_field(path)
            if field.bone_sha256 == bone.sha256 and field.voxel_size == voxel_size:
                return field
        except InputError as error:
            _log.warning('%s', error.message)
    field = build_field(bone, voxel_size)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_field(field, path)
    except (OSError, InputError) as error:
        _log.warning('the field is not kept for the next run: %s', error)
    return field
