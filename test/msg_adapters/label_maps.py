# SPDX-License-Identifier: Apache-2.0
"""An asymmetric shape in the coordinates of the patient, and images that contain it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

# boxes, LPS, mm: a body, a nose to the left at its lower end, and one to the back at its upper end
BOXES = np.array([[[-20, -15, -40], [20, 15, 40]], [[19, -5, -40], [40, 5, -25]],
                  [[-5, 14, 20], [5, 30, 35]]], dtype=float)
LEFT, BACK = (40.0, 0.0, -32.5), (0.0, 30.0, 27.5)      # middles of the ends of the noses
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


def distances(points: np.ndarray) -> np.ndarray:
    """Return the signed distance (n,) of points (n, 3), mm, to the shape, exact outside of it."""
    centre, half = BOXES.mean(axis=1), np.ptp(BOXES, axis=1) / 2
    over = np.abs(points[:, None] - centre) - half
    outside = np.linalg.norm(np.maximum(over, 0.0), axis=2)
    return (outside + np.minimum(over.max(axis=2), 0.0)).min(axis=1)


def voxels(T_lps_index: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """Return the voxels (i, j, k) of an image whose centres lie in the shape."""
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing='ij'), axis=-1).reshape(-1, 3)
    return (distances(index @ T_lps_index[:3, :3].T + T_lps_index[:3, 3]) < 0.0).reshape(shape)


def around(axes: np.ndarray, spacing: np.ndarray) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Return ``T_lps_index`` and the size of an image with these axes (columns) round the shape."""
    low, high = BOXES.min(axis=(0, 1)) - 9.0, BOXES.max(axis=(0, 1)) + 9.0
    half = np.abs(axes.T) @ (high - low) / 2
    shape = np.ceil(2 * half / spacing).astype(int) + 1
    T = np.eye(4)
    T[:3, :3] = axes * spacing
    T[:3, 3] = (low + high) / 2 - T[:3, :3] @ (shape - 1) / 2
    return T, (int(shape[0]), int(shape[1]), int(shape[2]))


def write_nifti(path: Path, labels: np.ndarray, T_lps_index: np.ndarray) -> None:
    """Write a NIfTI-1 file byte by byte: its affine is in RAS (https://nifti.nimh.nih.gov)."""
    T_ras_index = FLIP @ T_lps_index
    header = bytearray(352)
    struct.pack_into('<i', header, 0, 348)
    struct.pack_into('<8h', header, 40, 3, *labels.shape, 1, 1, 1, 1)
    struct.pack_into('<2h', header, 70, 2, 8)       # uint8
    spacing = np.linalg.norm(T_lps_index[:3, :3], axis=0)
    struct.pack_into('<8f', header, 76, 1.0, *spacing, 0, 0, 0, 0)
    struct.pack_into('<3f', header, 108, 352.0, 1.0, 0.0)
    header[123] = 2                                 # mm
    struct.pack_into('<2h', header, 252, 0, 1)      # only the sform
    struct.pack_into('<12f', header, 280, *T_ras_index[:3].ravel())
    header[344:348] = b'n+1\0'
    path.write_bytes(bytes(header) + labels.astype(np.uint8).tobytes(order='F'))
