# SPDX-License-Identifier: Apache-2.0
"""Run every kernel once, on a small bone, so that all of them are compiled or loaded."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import trimesh
from numba.core import event

from gsdf_registration.common.config import Config
from gsdf_registration.field import build_field
from gsdf_registration.live.warm_pose import WarmPose
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.registration.pipeline import register
from gsdf_registration.solver import solve

KERNELS = 150       # compiled in all, roughly; only the progress depends on it


class _Counter(event.Listener):
    """Counts compiled kernels."""

    def __init__(self, progress: Callable[[float], None]) -> None:
        self._count = 0
        self._progress = progress

    def on_start(self, event: Any) -> None:
        pass

    def on_end(self, event: Any) -> None:
        self._count += 1
        self._progress(min(self._count / KERNELS, 0.99))


def compile_kernels(progress: Callable[[float], None] = lambda share: None) -> None:
    """Run every kernel; ``progress`` receives the share that is compiled, unless it is cached."""
    with event.install_listener('numba:compile', _Counter(progress)):
        field = build_field(make_bone(*_bumpy_ellipsoid()), 0.002)
        points = field.surface_points[::3].astype(np.float64)
        config = Config.from_flat({'search.rotations': 1, 'search.places': 1, 'search.parts': 0})
        register(points, field, config)
        solution = solve(points, field, np.eye(4), config.solver)
        WarmPose(points, field, solution, config).add(np.tile(points[0], (10, 1)))


def _bumpy_ellipsoid() -> tuple[np.ndarray, np.ndarray]:
    sphere = trimesh.creation.icosphere(3)
    x, y, z = sphere.vertices.T
    radius = 0.04 + 0.008 * np.sin(5.0 * x + 1.0) * np.cos(4.0 * y) + 0.006 * z * x
    return sphere.vertices * [0.8, 1.0, 1.6] * radius[:, None], sphere.faces
