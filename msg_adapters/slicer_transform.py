# SPDX-License-Identifier: Apache-2.0
"""
Write the pose of a bone as a transform file of ITK, which 3D Slicer opens (.tfm, .h5).

Slicer moves the bone with the transform that it reads. The file has the lengths in millimetres and
the axes LPS, and it stores the inverse, from the tracker to the bone, because ITK resamples images
with it. Source: developer guide of 3D Slicer, Transforms.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, inverse
from msg_adapters.extras import needed
from msg_adapters.files import write_atomically
from msg_adapters.slicer import FLIP

ENDINGS = ('.tfm', '.txt', '.h5')


def check_transform_path(path: str | os.PathLike[str]) -> None:
    """Raise `InputError` if the file has another ending, or a library for it is missing."""
    ending = Path(path).suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f'{path}: a transform for Slicer has the ending .tfm or .h5')
    if ending == '.h5':
        needed('SimpleITK', 'ct', '.h5 transforms')


def write_transform(path: str | os.PathLike[str], T_tracker_bone: Array, model_axes: str = 'lps',
                    tracker_axes: str = 'lps') -> None:
    """
    Write a transform file.

    Parameters
    ----------
    path : path
        .tfm (text) or .h5 (HDF5, needs SimpleITK).
    T_tracker_bone : (4, 4) float, m
    model_axes, tracker_axes : {'lps', 'ras'}
        Axes of the coordinates of bone and tracker.

    Raises
    ------
    InputError
        If the name has another ending, SimpleITK is missing, or the file cannot be written.

    """
    check_transform_path(path)
    T = itk_matrix(T_tracker_bone, model_axes, tracker_axes)
    if Path(path).suffix.lower() == '.h5':
        _write_h5(path, T)
        return
    values = ' '.join(repr(float(value)) for value in (*T[:3, :3].ravel(), *T[:3, 3]))
    write_atomically(path, '#Insight Transform File V1.0\n#Transform 0\n'
                     'Transform: AffineTransform_double_3_3\n'
                     f'Parameters: {values}\nFixedParameters: 0 0 0\n')


def itk_matrix(T_tracker_bone: Array, model_axes: str, tracker_axes: str) -> Array:
    """Return the matrix (4, 4) of the file, from tracker to bone in LPS, mm."""
    to_lps = {'lps': np.eye(4), 'ras': np.diag([*FLIP, 1.0])}
    T = to_lps[tracker_axes] @ T_tracker_bone @ to_lps[model_axes]      # FLIP is its own inverse
    T[:3, 3] *= 1e3
    return inverse(T)


def _write_h5(path: str | os.PathLike[str], T: Array) -> None:
    sitk = needed('SimpleITK', 'ct', '.h5 transforms')
    transform = sitk.AffineTransform(T[:3, :3].ravel().tolist(), T[:3, 3].tolist())
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'pose.h5'
        sitk.WriteTransform(transform, str(file))
        write_atomically(path, file.read_bytes())
