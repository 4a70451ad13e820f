# SPDX-License-Identifier: Apache-2.0
"""An even sample of a bone's surface: where to start a search, where to predict errors, what to draw."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from gsdf_registration.bone import Bone
from gsdf_registration.mesh_repair import areas

SPACING = 0.002     # m: one point on about SPACING^2 of surface


def sample_surface(bone: Bone) -> tuple[np.ndarray, np.ndarray]:
    """
    Return points and outward normals, each (k, 3) float32, always the same for the same bone.

    Of a mesh: walking the faces in an order that keeps neighbours together, one point for every SPACING^2
    of area. Of a cloud: the first point in every cube of SPACING.
    """
    if bone.faces is None:
        assert bone.normals is not None
        cell = np.floor(bone.vertices / SPACING).astype(np.int64)
        _, chosen = np.unique(cell, axis=0, return_index=True)
        return bone.vertices[chosen].astype(np.float32), bone.normals[chosen].astype(np.float32)
    corners = bone.vertices[bone.faces]
    order = cKDTree(corners.mean(axis=1), leafsize=4).indices
    area = np.cumsum(areas(bone.vertices, bone.faces[order]))
    k = max(1, round(area[-1] / SPACING**2))
    chosen = corners[order[np.searchsorted(area, (np.arange(k) + 0.5) / k * area[-1])]]
    # a low-discrepancy sequence (Roberts' R2) folded into the triangle
    u = np.outer(np.arange(k), [0.7548776662466927, 0.5698402909980532]) % 1.0
    u = np.where(u.sum(axis=1, keepdims=True) > 1.0, 1.0 - u, u)
    a, ab, ac = chosen[:, 0], chosen[:, 1] - chosen[:, 0], chosen[:, 2] - chosen[:, 0]
    normals = np.cross(ab, ac)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return (a + u[:, :1] * ab + u[:, 1:] * ac).astype(np.float32), normals.astype(np.float32)
