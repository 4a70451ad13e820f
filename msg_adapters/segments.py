# SPDX-License-Identifier: Apache-2.0
"""
The segments of a segmentation, and the choice of one of them.

A segmentation of 3D Slicer (.seg.nrrd) gives each segment a name, a label and, if segments overlap,
a layer of its own. Other label maps have only the labels.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array

LISTED = 12         # segments that a message lists


class Mask(NamedTuple):
    """
    The voxels of one bone.

    inside : (i, j, k) bool
    T_lps_index : (4, 4) float64, mm, from the indices of a voxel to LPS
    """

    inside: NDArray[np.bool_]
    T_lps_index: Array


class Segment(NamedTuple):
    """A segment: label, name (empty: it has none), and the layer in which it is stored."""

    value: int
    name: str = ''
    layer: int = 0


def segments_of(image: Any, labels: list[list[int]]) -> list[Segment]:
    """
    Return the segments of an image of SimpleITK, in the order of layer and label.

    Parameters
    ----------
    image : with the metadata of the file
    labels : of each layer, without the background

    """
    names: dict[tuple[int, int], str] = {}
    for key in image.GetMetaDataKeys():
        found = re.fullmatch(r'Segment(\d+)_LabelValue', key)
        if found:
            prefix = f'Segment{found.group(1)}_'
            layer = _value(image, prefix + 'Layer', '0')
            names[int(layer), int(image.GetMetaData(key))] = _value(image, prefix + 'Name', '')
    return [Segment(value, names.get((layer, value), ''), layer)
            for layer, values in enumerate(labels) for value in values]


def chosen(path: Path, segments: list[Segment], label: str) -> Segment:
    """Return the segment with a number or name, or the only one."""
    wanted = label.strip().lower()
    found = [each for each in segments
             if not wanted or wanted in (str(each.value), each.name.lower())]
    if len(found) == 1:
        return found[0]
    listed = ', '.join(f'{each.value} ({each.name})' if each.name else str(each.value)
                       for each in segments[:LISTED])
    more = f' and {len(segments) - LISTED} more' if len(segments) > LISTED else ''
    what = (f'{len(found) or "no"} labels {label!r}' if wanted
            else format_count(len(segments), 'label'))
    raise InputError(f'{path} has {what}: choose one with --label (model.label): {listed}{more}')


def _value(image: Any, key: str, default: str) -> str:
    return str(image.GetMetaData(key)) if image.HasMetaDataKey(key) else default
