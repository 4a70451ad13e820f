# SPDX-License-Identifier: Apache-2.0
"""Compare two fields."""

from __future__ import annotations

import numpy as np

from gsdf_registration.field import Field


def assert_same(a: Field, b: Field) -> None:
    """Check that all of two fields is equal, to the bit."""
    for one, other in zip(a.arrays, b.arrays, strict=True):
        np.testing.assert_array_equal(one, other)
    for name in ('bone_sha256', 'voxel_size', 'bounds', 'surface_points', 'surface_normals',
                 'vertices', 'faces', 'notes', 'nbytes'):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
