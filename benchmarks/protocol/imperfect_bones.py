# SPDX-License-Identifier: Apache-2.0
"""The fields of imperfect models of the bones, each made once and cached on disk."""

from __future__ import annotations

import zlib
from functools import lru_cache

import numpy as np

from benchmarks.protocol.cases import bone, surface
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field, load_field, save_field
from gsdf_registration.field.build import build_field
from gsdf_registration.field.cache import cache_directory
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.simulation.imperfect_models import (
    CT,
    CT_THICK_SLICES,
    MRI,
    decimated,
    segmented,
)

SCANS = {'ct': CT, 'ct_thick_slices': CT_THICK_SLICES, 'mri': MRI}
FACES = 3000            # of a decimated model
VARIANTS = 3            # scans of each bone
VERSION = 1             # of the files; changes with `simulation.imperfect_models`
KINDS = (*SCANS, 'decimated')


def imperfect_bone(path: str, kind: str, seed: int) -> Field:
    """
    Return the field of an imperfect model of a mesh, mm.

    Parameters
    ----------
    path : mesh, mm
    kind : of `KINDS`
    seed : of the trial; there are `VARIANTS` scans of each bone

    """
    return _imperfect_bone(path, kind, seed % VARIANTS if kind in SCANS else 0)


@lru_cache(maxsize=16)
def _imperfect_bone(path: str, kind: str, variant: int) -> Field:
    true = bone(path)
    file = (cache_directory() / 'benchmarks'
            / f'{true.bone_sha256[:32]}-{kind}-{variant}-v{VERSION}.gsdf')
    if file.exists():
        try:
            return load_field(file)
        except InputError:
            pass        # of another version of the format, or damaged
    field = build_field(make_bone(*_mesh(path, true, kind, variant)))
    file.parent.mkdir(parents=True, exist_ok=True)
    save_field(field, file)
    return field


def _mesh(path: str, true: Field, kind: str, variant: int) -> tuple[Array, np.ndarray]:
    if kind == 'decimated':
        return decimated(*surface(path), FACES)
    rng = np.random.default_rng([variant, zlib.crc32(kind.encode()), int(true.bone_sha256[:8], 16)])
    return segmented(lambda x: true.sample(x)[0], true.bounds, SCANS[kind], rng)
