# SPDX-License-Identifier: Apache-2.0
"""
Compile all kernels ahead of use, once on a machine.

Numba compiles a kernel when it is first called, which takes half a minute for all of them, and
keeps it in a cache on disk. Two processes compile one half each: within a process the compiler
holds a lock, and the interpreter would stop all other threads most of the time.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable

import numpy as np

from gsdf_registration.common.config import Config
from gsdf_registration.common.kernel_cache import (
    PACKAGE,
    cache_folder,
    kernels_compiled,
    mark_compiled,
)
from gsdf_registration.common.numba_options import on_compilation
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field, build_field
from gsdf_registration.field.sample import CELLS, FieldArrays
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.registration.point_selection import select_points
from gsdf_registration.registration.pose_selection import select_pose
from gsdf_registration.search.global_search import find_start_poses
from gsdf_registration.solver import (
    Neighbourhood,
    allow_for_model_error,
    refine,
    solve,
)

Progress = Callable[[float], None]  # argument: the finished share, 0 to 1

MODULE = __name__ if __name__ != '__main__' else 'gsdf_registration.registration.kernels'
RADIUS, VOXEL = 0.03, 0.002     # m, of the body that the kernels are called with


def compile_kernels(progress: Progress = lambda share: None) -> None:
    """
    Compile all kernels, unless they are in the cache.

    This takes about 20 s on two cores. The work is done by other processes, so the threads of this
    one go on. Where no cache can be written, it is done here.

    Parameters
    ----------
    progress : callable
        Called with the finished share, 0 to 1, from any thread.

    """
    if kernels_compiled():
        return
    if cache_folder() is None or not _compile_in_processes(progress):
        _compile_here(progress)
    progress(1.0)
    mark_compiled()


def _compile_in_processes(progress: Progress) -> bool:
    """Compile the halves in one process each; return whether both succeeded."""
    done = dict.fromkeys(HALVES, 0.0)

    def follow(name: str, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            done[name] = float(line)
            progress(sum(done.values()) / len(done))
    environment = os.environ | {
        'PYTHONPATH': os.pathsep.join([str(PACKAGE.parent), *filter(None, sys.path)])}
    # in sessions of their own, so that a Ctrl-C reaches only this process, with which they end
    processes = [subprocess.Popen([sys.executable, '-m', MODULE, name], text=True, env=environment,
                                  stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                  stderr=subprocess.DEVNULL, start_new_session=True)
                 for name in HALVES]
    try:
        threads = [threading.Thread(target=follow, args=pair, daemon=True)
                   for pair in zip(HALVES, processes)]
        for thread in threads:
            thread.start()
        return [process.wait() for process in processes] == [0] * len(processes)
    finally:
        for process in processes:
            if process.poll() is None:      # interrupted
                process.kill()
                process.wait()
            assert process.stdin is not None
            process.stdin.close()


def load_kernels() -> None:
    """Load all kernels into this process, so that the first registration takes no longer."""
    _compile_here(lambda share: None)


def _compile_here(progress: Progress) -> None:
    """Compile both halves in this process."""
    def follow(first: int) -> Progress:
        return lambda share: progress((first + share) / len(HALVES))
    for number, name in enumerate(HALVES):
        _compile(name, follow(number))


def _compile(name: str, progress: Progress) -> None:
    """Compile one half; the progress is the share of the functions that it consists of."""
    compiled, (functions, calls) = 0, HALVES[name]

    def count() -> None:
        nonlocal compiled
        compiled += 1
        progress(min(compiled / functions, 1.0))
    with on_compilation(count):
        for call in calls:
            call()


def _call_model() -> None:
    """Call the kernels that build a field."""
    across = np.linspace(-RADIUS, RADIUS, 7)
    x, y = np.meshgrid(across, across, indexing='ij')
    corner = np.arange(36).reshape(6, 6) + np.arange(6)[:, None]    # of each square of the grid
    square = np.stack([corner, corner + 7, corner + 8, corner + 1], axis=-1).reshape(-1, 4)
    # an upper and a lower side with the same rim
    inside = RADIUS * (1.0 - (across[:, None] / RADIUS)**4) * (1.0 - (across / RADIUS)**4)
    sides = [np.stack([x, y, z], axis=-1).reshape(-1, 3) for z in (inside, -inside)]
    faces = np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
    make_bone_and_field(np.concatenate(sides), np.concatenate([faces, faces[:, ::-1] + 49]))


def make_bone_and_field(vertices: Array, faces: np.ndarray) -> Field:
    """Return the field of a mesh, m, which is not stored."""
    return build_field(make_bone(vertices, faces, None), VOXEL)


def _call_search() -> None:
    """Call the kernels of the selection of points and of the global search."""
    short = Config().replaced({'search.rotations': 1, 'search.places': 1, 'search.parts': 0})
    points = _touched()
    find_start_poses(points[select_points(points).rows], _body(), short.search)


def _call_solver() -> None:
    """Call the kernels of the local solver, of the choice of a pose, and of the live pose."""
    points, field, config = _touched(), _body(), Config()
    solution = allow_for_model_error(solve(points, field, np.eye(4), config.solver), points, field,
                                     config.model.surface_error)
    select_pose([solution], points, field, config)
    refine(points, field, solution, config.solver)
    Neighbourhood(points, field, np.eye(4)).add(points[:20] + 1e-4)
    solve(points, field, np.eye(4), config.replaced({'solver.method': 'paper'}).solver)


def _radius(direction: Array) -> Array:
    """Return the distance (n,) of the surface of the body from its centre, m."""
    x, y, z = direction.T
    return np.asarray(RADIUS * (1.0 + 0.2 * x * y + 0.1 * z**3))


def _directions(count: int) -> Array:
    """Return random unit vectors (count, 3)."""
    vectors = np.random.default_rng(0).normal(size=(count, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])


def _touched() -> Array:
    """Return points (n, 3), m, near the surface of the body, with noise and a model error."""
    direction = _directions(400)
    error = 5e-4 * np.sin(8.0 * direction[:, 0]) * np.cos(8.0 * direction[:, 1])
    noise = 1e-4 * np.random.default_rng(1).normal(size=len(direction))
    return direction * (_radius(direction) + error + noise)[:, None]


def _body() -> Field:
    """Return the field of a body without symmetry, with coarse nodes only."""
    edge = CELLS * VOXEL
    cells = 2 * round(1.5 * RADIUS / edge)
    origin = np.full(3, -0.5 * cells * edge)
    nodes = origin + edge * np.indices(3 * (cells + 1,)).reshape(3, -1).T
    distance = np.maximum(np.linalg.norm(nodes, axis=1), 1e-6)
    direction = nodes / distance[:, None]
    values = np.ascontiguousarray(
        np.column_stack([distance - _radius(direction), direction]), dtype=np.float32)
    surface = _directions(500)
    points = surface * _radius(surface)[:, None]
    arrays = FieldArrays(origin, VOXEL, np.full(3 * (cells,), -1, np.int32), values, 0)
    return Field(arrays, '', np.stack([points.min(axis=0), points.max(axis=0)]),
                 points.astype(np.float32), surface.astype(np.float32), points.astype(np.float32),
                 np.empty((0, 3), np.int32))


# About the number of functions in each half, with those of numba, and the calls that need them
HALVES: dict[str, tuple[int, tuple[Callable[[], None], ...]]] = {
    'model and search': (90, (_call_model, _call_search)),
    'solver': (90, (_call_solver,))}


def _end_with_parent() -> None:
    sys.stdin.read()        # until the parent process closes it or ends
    os._exit(1)


if __name__ == '__main__':
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _compile(sys.argv[1], lambda share: print(share, flush=True))
