# SPDX-License-Identifier: Apache-2.0
"""Read one segment of a DICOM segmentation (SEG) with highdicom."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gsdf_registration.common.result import InputError
from msg_adapters.extras import needed
from msg_adapters.files import describe_error
from msg_adapters.segments import Mask, Segment, chosen


def read_dicom_mask(path: Path, label: str) -> Mask:
    """
    Return the voxels of a segment.

    Parameters
    ----------
    path : path
    label : str
        Number or name of the segment; empty: the only one.

    Raises
    ------
    InputError
        If the file is damaged or no segmentation, highdicom is missing, or the segment is missing
        or ambiguous.

    """
    seg = needed('highdicom.seg', 'ct', 'DICOM segmentations')
    try:
        file = seg.segread(path)
    except Exception as error:  # a damaged file can cause any exception in the parser
        raise InputError(f'{path} is no DICOM segmentation (SEG): {describe_error(error)}'
                         ) from None
    segments = [Segment(number, str(file.get_segment_description(number).segment_label))
                for number in file.segment_numbers]
    segment = chosen(path, segments, label)
    try:
        volume = file.get_volume(segment_numbers=[segment.value], combine_segments=True,
                                 relabel=True)
    except Exception as error:  # frames that form no volume, of several exception types
        raise InputError(f'{path}: the frames of the segment form no volume '
                         f'({describe_error(error)})') from None
    inside = np.asarray(volume.array) > 0
    if not inside.any():
        raise InputError(f'{path}: the segment {segment.name or segment.value} is empty')
    return Mask(inside, np.asarray(volume.affine, dtype=np.float64))
