# SPDX-License-Identifier: Apache-2.0
"""Sample a surface uniformly, for the search, the prediction of errors and drawing."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.field.tree import Tree

SPACING = 0.002     # m; one point per SPACING^2 of the surface


def sample_triangles(tree: Tree) -> tuple[np.ndarray, np.ndarray]:
    """
    Return points and normals, each (k, 3) float32, deterministic for a mesh.

    The triangles are in the order of the tree, in which neighbours follow each other. A point is
    placed after every SPACING^2 of their cumulative area.
    """
    a, ab, ac = (tree.triangle[:, i:i + 3] for i in (0, 3, 6))
    area = np.cumsum(0.5 / np.sqrt(tree.triangle[:, 15]))
    k = max(1, round(float(area[-1]) / SPACING**2))
    selected = np.searchsorted(area, (np.arange(k) + 0.5) / k * area[-1])
    # a low-discrepancy sequence (Roberts' R2) folded into the triangle
    u = np.outer(np.arange(k), [0.7548776662466927, 0.5698402909980532]) % 1.0
    u = np.where(u.sum(axis=1, keepdims=True) > 1.0, 1.0 - u, u)
    points = a[selected] + u[:, :1] * ab[selected] + u[:, 1:] * ac[selected]
    return points.astype(np.float32), tree.normal[selected, 0]


def downsample(points: Array, normals: Array) -> tuple[np.ndarray, np.ndarray]:
    """Return the first point in each voxel of size SPACING and its normal, each (k, 3) float32."""
    _, first = np.unique(np.floor(points / SPACING).astype(np.int64), axis=0, return_index=True)
    return points[first].astype(np.float32), normals[first].astype(np.float32)
