# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks solve``: compare the solver with point-to-plane ICPs."""

from __future__ import annotations

import argparse
import os
from dataclasses import dataclass, field
from time import perf_counter
from typing import TYPE_CHECKING, Any

from benchmarks.options import add_bones_option, add_seed_option, bones
from benchmarks.peers.in_process import Aligner, open3d, ours, small_gicp, warm
from gsdf_registration.common.command_line import example, positive_number

if TYPE_CHECKING:
    import numpy as np

    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field

EXPOSED = 0.04          # m, radius of the ball that contains the points
NOISE = 5e-4            # m, standard deviation per axis
LANDMARK_ERROR = 4e-3   # m
DENSITY = 2e6           # model points per square metre for the peers: 0.7 mm apart
PEERS = {'small_gicp, point-to-plane': small_gicp, 'Open3D, plane, Tukey': open3d}


@dataclass
class Row:
    """Measurements of one method on one bone; s, m^2."""

    seconds: list[float] = field(default_factory=list)
    iterations: list[float] = field(default_factory=list)
    squared_tre: list[float] = field(default_factory=list)


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'solve', help='compare the solver with small_gicp and Open3D',
        description='Measure the time and the error of the local solver and of the point-to-plane '
        'ICPs of small_gicp and Open3D, from three landmarks with an error of 4 mm. Each runs on '
        'one thread, with model and search trees prepared beforehand. A warm solve starts from the '
        'previous solution, displaced by 0.5 mm and 0.3 deg, with known neighbours. The lower '
        'limit is the time to sample the field in the same number of passes.',
        **example('python -m benchmarks solve --bones ~/bones'))
    add_bones_option(parser)
    parser.add_argument('--points', type=positive_number, default=1000, metavar='N',
                        help='number of points (default: 1000)')
    parser.add_argument('--solves', type=positive_number, default=60, metavar='N',
                        help='problems per bone (default: 60)')
    add_seed_option(parser, 'seed of points, noise and landmarks')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print a table."""
    os.environ['OMP_NUM_THREADS'] = '1'     # must be set before the peers are imported
    from gsdf_registration.field.model import load_model

    print(
        f'{args.points} points within {1e3 * EXPOSED:.0f} mm, noise {1e3 * NOISE:.1f} mm, '
        f'landmarks {1e3 * LANDMARK_ERROR:.0f} mm off, {args.solves} problems per bone; '
        'one thread\n')
    print(
        f'{"bone":<20}{"method":<30}{"median ms":>10}{"p95 ms":>10}{"iterations":>12}'
        f'{"TRE rms mm":>12}')
    for file in bones(args.bones):
        measure(file.stem, load_model(str(file)), args.points, args.solves, args.seed)
    return 0


def measure(name: str, bone: Field, points: int, solves: int, seed: int) -> None:
    """Print the rows of one bone."""
    surface, normals = sampled(bone, seed)
    near = best_patch(surface, normals, seed)
    methods = {'gradient-SDF, paper': ours(bone, 'paper'),
               'gradient-SDF, mixture': ours(bone, 'mixture'),
               'gradient-SDF, mixture, warm': warm(bone)}
    missing: dict[str, str] = {}
    for peer, prepare in PEERS.items():
        try:
            methods[peer] = prepare(surface, normals)
        except (ImportError, OSError) as error:
            missing[peer] = str(error).splitlines()[0]
    rows = solve_all(methods, bone, surface, near, points, solves, seed)
    one_pass = seconds_per_pass(bone, surface[near][:points])
    for method, row in rows.items():
        show(name, method, row, one_pass)
    for method, reason in missing.items():
        print(f'{name:<20}{method:<30}not measured: {reason}')
    print(f'{"":<20}one pass: {1e6 * one_pass:.0f} us when the field is in the CPU caches, '
          f'{1e9 * one_pass / points:.0f} ns per sample\n')


def solve_all(methods: dict[str, Aligner], bone: Field, surface: Array, near: np.ndarray,
              points: int, solves: int, seed: int) -> dict[str, Row]:
    """Return the row of each method for the same problems, after a first one as a warm-up."""
    import numpy as np

    from gsdf_registration.common import rigid

    rows = {method: Row() for method in methods}
    rng = np.random.default_rng(seed)
    for problem in range(solves + 1):
        T_tracker_bone, touched, guess = draw_problem(surface, near, points, rng)
        for method, align in methods.items():
            T_bone_tracker, iterations, seconds = align(touched, rigid.inverse(guess))
            if problem == 0:
                continue    # the first solve compiles and warms up
            tre = rigid.transform(T_bone_tracker @ T_tracker_bone,
                                  bone.surface_points) - bone.surface_points
            rows[method].seconds.append(seconds)
            rows[method].iterations.append(iterations)
            rows[method].squared_tre.append(float((tre**2).sum(axis=1).mean()))
    return rows


def show(name: str, method: str, row: Row, one_pass: float) -> None:
    """Print the row of a method, and the lower limit of its time; ``one_pass`` in s."""
    import numpy as np

    steps = float(np.median(row.iterations))
    median, p95 = 1e3 * np.percentile(row.seconds, [50.0, 95.0])
    print(f'{name:<20}{method:<30}{median:>10.2f}{p95:>10.2f}'
          f'{"-" if np.isnan(steps) else f"{steps:.0f}":>12}'
          f'{1e3 * np.sqrt(np.mean(row.squared_tre)):>12.2f}')
    if method in ('gradient-SDF, paper', 'gradient-SDF, mixture, warm'):
        # the published method samples once more at its end
        passes = steps + method.endswith('paper')
        limit = f'  lower limit, {passes:.0f} passes'
        print(f'{"":<20}{limit:<30}{1e3 * passes * one_pass:>10.2f}')


def sampled(bone: Field, seed: int) -> tuple[Array, Array]:
    """Return random points on the surface (n, 3), m, and their normals (n, 3)."""
    import numpy as np
    import trimesh

    mesh = trimesh.Trimesh(bone.vertices.astype(np.float64), bone.faces, process=False)
    surface, faces = trimesh.sample.sample_surface(mesh, int(DENSITY * mesh.area), seed=seed)
    return np.ascontiguousarray(surface), np.ascontiguousarray(mesh.face_normals[faces])


def best_patch(surface: Array, normals: Array, seed: int) -> np.ndarray:
    """
    Return the indices of the points in the ball, of 50, that constrains the pose best.

    A random ball may be on the shaft, where no method can find the pose.
    """
    import numpy as np

    candidates = []
    for centre in surface[np.random.default_rng(seed).choice(len(surface), 50)]:
        near = np.flatnonzero(np.linalg.norm(surface - centre, axis=1) < EXPOSED)
        arms = (surface[near] - surface[near].mean(axis=0)) / EXPOSED
        J = np.hstack([np.cross(arms, normals[near]), normals[near]])
        candidates.append((float(np.linalg.eigvalsh(J.T @ J / len(near))[0]), near))
    return np.random.default_rng(seed).permutation(
        max(candidates, key=lambda candidate: candidate[0])[1])


def draw_problem(surface: Array, near: np.ndarray, n: int,
                 rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return T_tracker_bone, points (n, 3), m, tracker frame, and a guess from three landmarks."""
    import numpy as np

    from benchmarks.protocol.starts import landmark_places
    from gsdf_registration.common import rigid
    from gsdf_registration.registration.landmarks import pose_from_landmarks

    T = rigid.exp(np.concatenate([rng.uniform(-1.5, 1.5, 3), rng.uniform(-1.0, 1.0, 3)]))
    points = surface[rng.choice(near, n, replace=len(near) < n)]
    marks = landmark_places(surface, surface[near].mean(axis=0))
    off = rng.normal(size=(3, 3))
    off *= LANDMARK_ERROR / np.linalg.norm(off, axis=1, keepdims=True)
    guess, _ = pose_from_landmarks(marks, rigid.transform(T, marks) + off)
    return T, rigid.transform(T, points) + NOISE * rng.normal(size=points.shape), guess


def seconds_per_pass(bone: Field, points: Array) -> float:
    """Return the time to compute residuals and Jacobian at points (n, 3) of the bone, s."""
    import numpy as np

    from gsdf_registration.solver.gauss_newton import linearize
    n = len(points)
    keep, e, J = np.ones(n, dtype=np.bool_), np.zeros(n), np.zeros((n, 6))
    seconds = []
    for _ in range(200):
        start = perf_counter()
        linearize(bone.arrays, points, np.eye(3), np.zeros(3), keep, e, J)
        seconds.append(perf_counter() - start)
    return float(np.median(seconds))
