# SPDX-License-Identifier: Apache-2.0
"""Load a bone model and return its field."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import shortened
from gsdf_registration.field import Field, cached_field, load_field
from gsdf_registration.field.cache import stored_field
from gsdf_registration.field.known_bones import key_of, known_bone, remember
from gsdf_registration.mesh.bone import make_bone, warn_of_repairs
from msg_adapters.points import read_model


def load_model(path: str, unit: str = 'mm', voxel_size: float = 0.001, label: str = '',
               body: str = '') -> Field:
    """
    Return the gradient-SDF of a bone model, from the cache if possible.

    Parameters
    ----------
    path : str
        Mesh, point cloud with normals, segmentation or field (.gsdf), see `read_model`; a path or
        a package:// URI.
    unit : str
        Unit of length of the file, 'mm' or 'm'; ignored for a field.
    voxel_size : float
        Spacing of the fine nodes, m; ignored for a field.
    label : str
        Number or name of the bone in a segmentation; empty: the only one.
    body : str
        Which bone of a mesh of several: a number, 'largest' or 'all'.

    Raises
    ------
    InputError
        If the file is missing or damaged or has several bones, or the size is not that of a bone
        (`wrong_unit`).

    """
    file = find_model(path)
    if file.suffix.lower() == '.gsdf':
        return load_field(file)
    key = '' if label else key_of(file, unit, body)
    known = known_bone(key)
    field = None if known is None else stored_field(known.sha256, voxel_size)
    if known is not None and field is not None:
        warn_of_repairs(known.notes)
        return field
    try:
        bone = make_bone(*read_model(file, unit, label), body)
    except InputError as error:
        named = error.message if str(file) in error.message else f'{path}: {error.message}'
        raise InputError(named, error.reason) from None
    if key and key == key_of(file, unit, body):     # it was not replaced while it was read
        remember(key, bone)
    return cached_field(bone, voxel_size)


def find_model(path: str) -> Path:
    """
    Return the regular file of a path or of a ``package://name/path`` URI.

    The package is searched for in the ament index, in ``share/`` of the Python prefix, and in the
    directory from which Python imports it.

    Raises
    ------
    InputError
        If the package is not installed or has no such file, or the path is not a regular file.

    """
    shown = shortened(path)
    try:
        if path.startswith('package://'):
            return _find_in_package(path)
        file = Path(path).expanduser()
        if file.is_file():
            return file
        if not file.exists():
            raise InputError(f'{shown} does not exist')
    except RuntimeError:        # ~name of a user that does not exist
        raise InputError(f'{shown}: there is no such user') from None
    except (OSError, ValueError) as error:      # a name that is too long, or has a NUL byte
        raise InputError(f'{shown}: this is not a valid path: '
                         f'{getattr(error, "strerror", None) or error}') from None
    raise InputError(f'{shown}: this is not a regular file')


def _find_in_package(path: str) -> Path:
    name, _, inside = path.removeprefix('package://').partition('/')
    if '..' in Path(inside).parts or Path(inside).is_absolute():
        raise InputError(f'{shortened(path)}: a package URI names a file inside its package')
    for share in _shares(name):
        if (share / inside).is_file():
            return share / inside
    raise InputError(f'{shortened(path)}: package "{shortened(name)}" is not installed or has no '
                     f'file "{shortened(inside)}"')


def _shares(name: str) -> list[Path]:
    """Return the directories that may contain the files of a package."""
    shares = [Path(sys.prefix) / 'share' / name]
    try:
        from ament_index_python.packages import get_package_share_directory
        shares.insert(0, Path(get_package_share_directory(name)))
    except (ImportError, LookupError, OSError, ValueError):
        pass    # ROS is not installed, or it has no such package
    spec = importlib.util.find_spec(name) if name.isidentifier() else None
    if spec is not None and spec.origin is not None:
        folder = Path(spec.origin).parent
        shares += [folder, folder.parent]
    return shares
