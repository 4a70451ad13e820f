# SPDX-License-Identifier: Apache-2.0
"""Matrices of small motions [xi, phi]: a rotation xi about a centre and a translation phi."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.rigid import Array


def motion_between(new: Array, old: Array) -> Array:
    """Return G (6, 6), which maps a motion about centre ``old`` to the same about ``new``."""
    G = np.eye(6)
    G[3:, :3] = rigid.skew(old - new)
    return G


def inverse(matrix: Array) -> Array:
    """Return the inverse of a positive (6, 6) covariance or information of motions."""
    scale = np.sqrt(np.diag(matrix))
    found = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
    return np.asarray(0.5 * (found + found.T))


def moved(motion: Array, centre: Array) -> Array:
    """Return the rigid motion (4, 4) of [rotation about ``centre``, translation]."""
    R = rigid.rotation_exp(motion[:3])
    return rigid.from_rt(R, centre + motion[3:] - R @ centre)
