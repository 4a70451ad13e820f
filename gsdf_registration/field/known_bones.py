# SPDX-License-Identifier: Apache-2.0
"""
Find the bone of a mesh file that was read before, without reading the mesh again.

To import the reader of meshes, and to read and repair a mesh, takes longer than to load a field
from the cache: half a second for a small bone, some seconds for a large one. An entry of the cache
holds the hash of the bone and its repairs. Its name is the hash of all that they depend on: the
content and type of the file, the settings, and the code that reads and repairs a mesh.
"""

from __future__ import annotations

import functools
import hashlib
import json
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import gsdf_registration
import msg_adapters
from gsdf_registration.common.result import InputError
from gsdf_registration.common.user_cache import hash_of_code
from gsdf_registration.field.cache import cache_directory
from gsdf_registration.mesh.bone import Bone
from msg_adapters.files import write_atomically

KINDS = ('.stl', '.ply', '.obj', '.off')    # files whose surface is in no other file
PACKAGE = Path(gsdf_registration.__file__).parent
CODE = (PACKAGE / 'common', PACKAGE / 'mesh', Path(msg_adapters.__file__).parent)
LIBRARIES = ('numba', 'numpy', 'scipy', 'trimesh')


class KnownBone(NamedTuple):
    """The hash of a bone, and the repairs of its mesh, one sentence each."""

    sha256: str
    notes: tuple[str, ...]


def key_of(file: Path, unit: str, body: str) -> str:
    """
    Return the hash of all that the bone of a mesh file depends on.

    It is empty for other files, and for a file that cannot be read.
    """
    if file.suffix.lower() not in KINDS:
        return ''
    digest = hashlib.sha256(repr((_code(), file.suffix.lower(), unit, body)).encode())
    try:
        digest.update(file.read_bytes())
    except OSError:
        return ''
    return digest.hexdigest()


def known_bone(key: str) -> KnownBone | None:
    """Return the bone of an earlier `remember`; None if there is none, or the entry is damaged."""
    if not key:
        return None
    try:
        found = json.loads(_entry(key).read_text('utf-8'))
        return KnownBone(str(found['bone_sha256']), tuple(map(str, found['notes'])))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def remember(key: str, bone: Bone) -> None:
    """Write the entry of a bone; without an error if the cache cannot be written."""
    entry = _entry(key)
    with suppress(OSError, InputError):
        entry.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(entry, json.dumps({'bone_sha256': bone.sha256, 'notes': bone.notes}))


def _entry(key: str) -> Path:
    return cache_directory() / f'{key[:32]}.bone.json'


@functools.cache
def _code() -> str:
    """Return the hash of the code that reads and repairs a mesh."""
    return hash_of_code([version(name) for name in LIBRARIES], CODE)
