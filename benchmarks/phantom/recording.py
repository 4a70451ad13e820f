# SPDX-License-Identifier: Apache-2.0
"""
Read the published recording of a hip phantom with an electromagnetic tracker.

Its repository, utsTianchengLi/Bone-registration-for-CAOS, has the model, the drag of the tip, and
three landmarks and ten targets that were touched. Where these are on the model stands in a script.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field, build_field
from gsdf_registration.mesh.bone import make_bone
from msg_adapters.files import read_text, readable_file
from msg_adapters.points import read_points
from msg_adapters.recording import Recording

MODEL, DRAG, TOUCHED = 'mesh_hip.mat', 'hip1.csv', 'real_hip_fea.csv'
SCRIPT = 'main_registration_realdata.m'
LANDMARKS = 3       # of the touched places; the others are targets
VOXEL = 0.001       # m


@dataclass(frozen=True)
class Phantom:
    """
    The phantom and what was measured on it; metres.

    field : Field
    drag : Recording of the tip
    landmarks, targets : (2, k, 3) and (2, m, 3) float, on the model and as touched, tracker frame
    """

    field: Field
    drag: Recording
    landmarks: Array
    targets: Array


def read_phantom(folder: Path) -> Phantom:
    """
    Read a checkout of the repository.

    Raises
    ------
    InputError
        If a file is missing or has other contents.

    """
    try:
        mesh = loadmat(readable_file(folder / MODEL))
        bone = make_bone(1e-3 * mesh['ver'], mesh['tri'].astype(np.int64) - 1, None)
    except (KeyError, ValueError) as error:
        raise InputError(f'{folder / MODEL} is not the model of the phantom: {error}') from None
    touched = read_points(folder / TOUCHED, 'mm').positions
    landmarks, targets = (_matrix(folder / SCRIPT, name) for name in ('Tar_fea', 'hip_keypoints'))
    if (len(landmarks), len(landmarks) + len(targets)) != (LANDMARKS, len(touched)):
        raise InputError(f'{folder / TOUCHED} has {len(touched)} places, but {SCRIPT} has '
                         f'{len(landmarks)} landmarks and {len(targets)} targets')
    return Phantom(build_field(bone, VOXEL), read_points(folder / DRAG, 'mm'),
                   np.stack([landmarks, touched[:LANDMARKS]]),
                   np.stack([targets, touched[LANDMARKS:]]))


def _matrix(path: Path, name: str) -> Array:
    """Return the matrix (n, 3) of this name in a script of Matlab, mm, in m."""
    found = re.search(rf'^{name}\s*=\s*\[([^\]]*)\]', read_text(path), re.MULTILINE)
    if not found:
        raise InputError(f'{path} has no matrix {name}')
    return 1e-3 * np.array([row.replace(',', ' ').split() for row in found[1].split(';')
                            if row.strip()], dtype=np.float64)
