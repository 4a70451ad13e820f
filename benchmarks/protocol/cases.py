# SPDX-License-Identifier: Apache-2.0
"""The bones of a folder and their exposed regions, each loaded once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config, SearchConfig
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field, cached_field
from gsdf_registration.field.model import load_model
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.registration.pose_selection import select_pose
from gsdf_registration.search.global_search import find_start_poses
from gsdf_registration.simulation.patch import Patch
from gsdf_registration.simulation.regions import named_patch
from gsdf_registration.solver import solve

REGIONS = {'hip': ('acetabulum',), 'femur': ('proximal_femur', 'condyles'),
           'tibia': ('proximal_tibia',)}
KIND = {region: kind for kind, regions in REGIONS.items() for region in regions}
MIRROR = np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class Case:
    """A mesh (path, mm) and the region that the incision exposes."""

    bone: str
    region: str

    @property
    def name(self) -> str:
        """Return bone/region."""
        return f'{Path(self.bone).stem}/{self.region}'

    @property
    def kind(self) -> str:
        """Return the kind of bone: hip, femur, tibia."""
        return KIND[self.region]

    @property
    def person(self) -> str:
        """Return the person: the file name before the kind of bone, without CT or MRI."""
        before = Path(self.bone).stem.lower().partition(self.kind)[0].rstrip('_-. ')
        return before.removesuffix('mri').removesuffix('ct')

    @property
    def side(self) -> str:
        """Return the side: the file name after the kind of bone."""
        return Path(self.bone).stem.lower().partition(self.kind)[2]


def find_cases(files: Sequence[Path], regions: Sequence[str] = ()) -> list[Case]:
    """
    Return every bone with each of its regions.

    The file name determines the kind of bone (hip, femur, tibia), else the shape.

    Parameters
    ----------
    files : meshes, mm
    regions : use these instead, for every bone

    Raises
    ------
    InputError
        If a region is unknown.

    """
    for region in regions:
        if region not in KIND:
            raise InputError(f'region "{region}" is unknown; choose one of {", ".join(KIND)}')
    return [Case(str(file), region) for file in files for region in regions or _regions(file)]


@lru_cache(maxsize=64)
def bone(path: str, mirrored: bool = False) -> Field:
    """
    Return the field of a mesh, mm, or of its mirror image.

    Raises
    ------
    InputError
        If it cannot be read, or is a point cloud.

    """
    field = load_model(path)
    if not len(field.faces):
        raise InputError(f'{path} is a point cloud; give a mesh')
    return cached_field(make_bone(*surface(path, mirrored))) if mirrored else field


def surface(path: str, mirrored: bool = False) -> tuple[Array, np.ndarray]:
    """Return vertices (n, 3), m, and outward faces (m, 3) of a mesh or its mirror image."""
    field = bone(path)
    vertices, faces = field.vertices.astype(np.float64), field.faces.astype(np.int64)
    return (vertices * MIRROR, faces[:, ::-1]) if mirrored else (vertices, faces)


@lru_cache(maxsize=128)
def region_patch(path: str, region: str, mirrored: bool = False) -> Patch:
    """
    Return an exposed region of a mesh, mm, or of its mirror image.

    Raises
    ------
    InputError
        If the bone has no such region.

    """
    try:
        return named_patch(region, *surface(path, mirrored))
    except InputError as error:
        raise InputError(f'{path}: {error.message}') from None


@lru_cache(maxsize=64)
def between_scans(path: str, other: str) -> Array:
    """Return T_other_bone (4, 4), m, between two scans of a bone, from their whole surfaces."""
    points, field = bone(path).surface_points[::4].astype(np.float64), bone(other)
    config = Config().replaced({'solver.method': 'paper', 'solver.cauchy_scale': 0.003})
    starts = find_start_poses(points, field, SearchConfig(), count=20)
    found = [solve(points, field, T, config.solver) for T in starts]
    selected = select_pose(found, points, field, config)
    return rigid.orthonormalized(selected.solution.T_bone_tracker)


def _regions(file: Path) -> Sequence[str]:
    """Return the regions of the bone in a file, by the file name, else by the shape."""
    for kind, regions in REGIONS.items():
        if kind in file.stem.lower():
            return regions
    for kind in ('hip', 'femur'):
        try:
            region_patch(str(file), REGIONS[kind][0])
            return REGIONS[kind]
        except InputError:
            pass    # no cup, or no head
    return REGIONS['tibia']
