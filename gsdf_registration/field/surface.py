# SPDX-License-Identifier: Apache-2.0
"""An even sample of a surface: where to start a search, where to predict errors, what to draw."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.rigid import Array
from gsdf_registration.field.tree import Tree

SPACING = 0.002     # m: one point on SPACING^2 of surface


def sample_triangles(tree: Tree) -> tuple[np.ndarray, np.ndarray]:
    """
    Return points and normals, each (k, 3) float32, always the same for the same mesh.

    The triangles are walked in the order of the tree, where neighbours follow each other, and a
    point is put down every SPACING^2 of area.
    """
    a, ab, ac = (tree.triangle[:, i:i + 3] for i in (0, 3, 6))
    area = np.cumsum(0.5 / np.sqrt(tree.triangle[:, 15]))
    k = max(1, round(float(area[-1]) / SPACING**2))
    chosen = np.searchsorted(area, (np.arange(k) + 0.5) / k * area[-1])
    # a low-discrepancy sequence (Roberts' R2) folded into the triangle
    u = np.outer(np.arange(k), [0.7548776662466927, 0.5698402909980532]) % 1.0
    u = np.where(u.sum(axis=1, keepdims=True) > 1.0, 1.0 - u, u)
    points = a[chosen] + u[:, :1] * ab[chosen] + u[:, 1:] * ac[chosen]
    return points.astype(np.float32), tree.normal[chosen, 0]


def thin_out(points: Array, normals: Array) -> tuple[np.ndarray, np.ndarray]:
    """Return the first point in every cube of SPACING, and its normal, each (k, 3) float32."""
    _, chosen = np.unique(np.floor(points / SPACING).astype(np.int64), axis=0, return_index=True)
    return points[chosen].astype(np.float32), normals[chosen].astype(np.float32)
