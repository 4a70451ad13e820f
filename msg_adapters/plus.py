# SPDX-License-Identifier: Apache-2.0
"""
Read the tool transforms of PLUS recordings: sequence metafiles (.mha, .mhd) and .nrrd.

The header of the file has the fields of each frame, as in
``Seq_Frame0007_StylusToTrackerTransform = 16 numbers``, ``..._StylusToTrackerTransformStatus = OK``
and ``Seq_Frame0007_Timestamp = 1.25``. Lengths are in millimetres. The image, if there is one, is
not read.
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter

import numpy as np

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import (
    Array,
    is_rigid,
    orthonormalized,
    quaternion_from_rotation,
)
from msg_adapters.files import METRES, open_file
from msg_adapters.tracked_tool import TrackedTool

ENDINGS = ('.mha', '.mhd', '.nrrd', '.nhdr')
LARGEST = 1 << 40       # bytes; the image of a recording can have gigabytes
LONGEST = 1 << 16       # bytes of a line of the header
RIGID = 1e-3            # tolerance of a rotation, which has six digits
FIELD = re.compile(rb'Seq_Frame(\d+)_(\w+?)\s*:?=\s*(.*?)\s*$')
TRANSFORM = 'Transform'
FRAMES = {'ImageToReference'}       # of PLUS itself, which no tracker measures

Fields = dict[int, dict[str, str]]


def read_plus(path: str | os.PathLike[str], wanted: str | None = None) -> list[TrackedTool]:
    """
    Read the poses of all tools.

    Parameters
    ----------
    path : path
        .mha, .mhd, .nrrd or .nhdr of PLUS.
    wanted : str, optional
        Part of the name of a transform: read only this one.

    Returns
    -------
    list of TrackedTool
        In m and s, labelled as StylusToTracker. Frames whose status is not OK are counted as
        'tracking_state', transforms that are not rigid as 'not_rigid', and frames without a
        transform of the tool as 'missing'.

    Raises
    ------
    InputError
        If the file is no recording of PLUS, has a damaged header, or has no valid transform; or
        no tool or several match ``wanted``.

    """
    if not str(path).lower().endswith(ENDINGS):
        raise InputError(f'{path} is no recording of PLUS (.mha, .mhd, .nrrd)')
    frames = _read_header(path)
    names = dict.fromkeys(name.removesuffix(TRANSFORM) for fields in frames.values()
                          for name in fields if name.endswith(TRANSFORM))
    labels = [name for name in names if name not in FRAMES
              and (wanted is None or wanted.lower() in name.lower())]
    if not names:
        raise InputError(f'{path} has no tool transforms (Seq_Frame..._...Transform): it is no '
                         'recording of PLUS')
    if not labels or (wanted is not None and len(labels) > 1):
        raise InputError(f'{path} has {len(labels) or "no"} transforms that match {wanted!r}; '
                         f'choose one with --tool: {", ".join(names)}')
    tools = [_tool(path, frames, label) for label in labels]
    if not any(len(tool) for tool in tools):
        raise InputError(f'{path}: {", ".join(labels)} was never tracked ({len(frames)} frames)')
    return tools


def _read_header(path: str | os.PathLike[str]) -> Fields:
    """Return the fields of each frame by its number."""
    frames: Fields = {}
    nrrd = str(path).lower().endswith(('.nrrd', '.nhdr'))
    with open_file(path, LARGEST) as file:
        while True:
            line = file.readline(LONGEST)
            # the header ends at the image: after this field, or at an empty line of NRRD
            if not line or line.startswith(b'ElementDataFile') or (nrrd and not line.strip()):
                return frames
            found = FIELD.match(line)
            if found:
                number, name, value = found.groups()
                frames.setdefault(int(number), {})[name.decode()] = value.decode('utf-8', 'replace')


def _tool(path: str | os.PathLike[str], frames: Fields, label: str) -> TrackedTool:
    """Return the poses of one transform in the order of the frames."""
    stamps, poses, dropped = [], [], Counter[str]()
    for number in sorted(frames):
        fields = frames[number]
        status = fields.get(f'{label}{TRANSFORM}Status', 'OK').upper()
        if f'{label}{TRANSFORM}' not in fields:
            dropped['missing'] += 1
            continue
        if status not in ('OK', ''):
            dropped['tracking_state'] += 1
            continue
        T = _matrix(path, number, label, fields[f'{label}{TRANSFORM}'])
        if not is_rigid(T, RIGID):
            dropped['not_rigid'] += 1
            continue
        poses.append(orthonormalized(T))
        stamps.append(_stamp(path, number, fields.get('Timestamp', '')))
    T = np.reshape(poses, (-1, 4, 4)).astype(np.float64)
    return TrackedTool(
        label, T[:, :3, 3] * METRES['mm'],
        np.reshape([quaternion_from_rotation(each[:3, :3]) for each in T], (-1, 4)),
        stamps=np.array(stamps), dropped=dict(dropped))


def _matrix(path: str | os.PathLike[str], number: int, label: str, text: str) -> Array:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != 16:
        raise InputError(f'{path}, frame {number}: {label}{TRANSFORM} is not 16 numbers')
    return np.reshape(values, (4, 4))


def _stamp(path: str | os.PathLike[str], number: int, text: str) -> float:
    try:
        stamp = float(text)
    except ValueError:
        stamp = math.nan
    if not math.isfinite(stamp):
        raise InputError(f'{path}, frame {number}: the Timestamp is missing or no number')
    return stamp
