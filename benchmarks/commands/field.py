# SPDX-License-Identifier: Apache-2.0
"""``python -m benchmarks field``: compare the building of fields with libigl and Open3D."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from benchmarks.options import add_bones_option, bones
from gsdf_registration.common.command_line import example, number, whole_number

if TYPE_CHECKING:
    import numpy as np

    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field
    from gsdf_registration.mesh.bone import Bone

REPEATS = 5
TIME_LIMIT = 60.0       # s for a peer; the rest is extrapolated, which the table marks
BATCH = 20_000          # nodes per call of a peer, from a random order
TESTED = 50_000         # points at which the error is measured
BAND = 3.0              # voxels from the surface, in which they lie
# build a field in a new process and print the peak of its memory, kB
PEAK = (
    'import sys; from gsdf_registration.field.model import load_model; '
    'load_model(sys.argv[1], "mm", float(sys.argv[2])); '
    'print(*(s.split()[1] for s in open("/proc/self/status") if s.startswith("VmHWM")))'
)

# points (n, 3) -> signed distances (n,)
Peer = Callable[['Array'], 'Array']


def add_parser(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        'field', help='compare the building of fields with libigl and Open3D',
        description='Measure the time to repair a mesh and build its field, and the time of libigl '
        'and Open3D for the signed distances at the same nodes. Also measure the error against '
        'exact distances, the memory, the size of the file and the time to load it.',
        **example('python -m benchmarks field --bones ~/bones'))
    add_bones_option(parser)
    parser.add_argument('--voxel', type=number, default=1.0, metavar='MM',
                        help='spacing of the samples near the surface, mm (default: 1)')
    parser.add_argument(
        '--faces',
        type=whole_number,
        default=0,
        metavar='N',
        help='remesh to about N faces first, with Open3D (default: no remeshing)')
    parser.add_argument('--no-peers', action='store_true', help='skip libigl and Open3D')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print a table."""
    print(
        f'voxel {args.voxel:g} mm, {os.cpu_count()} cores, median of {REPEATS} warm runs\n'
        f'bone: repair; field: build; libigl, Open3D: signed distances at the same nodes, '
        'and the ratio\nof their time to the build time (~: extrapolated from a random subset)\n'
        f'rms, max: error of the distance at {TESTED} random points within {BAND:g} '
        f'voxels of the surface\n'
        'peak: memory to read, repair and build; half: ratio of the costs at half the voxel size\n'
        'missing: the library is not installed (extra "bench")\n')
    print(
        f'{"bone":<18}{"faces":>8}{"bone ms":>9}{"field ms":>9}{"nodes k":>9}'
        f'{"libigl":>12}{"Open3D":>12}'
        f'{"rms um":>8}{"max um":>8}{"MB":>7}{"disk MB":>9}{"load ms":>9}{"peak MB":>9}'
        f'{"half: s":>9}'
        f'{"MB":>6}')
    for file in bones(args.bones):
        measure(file, 1e-3 * args.voxel, args.faces, not args.no_peers)
    return 0


def measure(file: Path, voxel: float, faces: int, peers: bool) -> None:
    """Print the row of one bone, each figure as soon as it is known."""
    import numpy as np

    from gsdf_registration.field import build_field, load_field, save_field
    from gsdf_registration.mesh.bone import make_bone
    from msg_adapters.points import read_model

    vertices, triangles, normals = read_model(file, 'mm')
    if faces and triangles is not None:
        vertices, triangles = resampled(vertices, triangles, faces)
    bone = make_bone(vertices, triangles, normals)
    field = build_field(bone, voxel)    # the first one compiles
    bone_s = median_time(lambda: make_bone(vertices, triangles, normals))
    field_s = median_time(lambda: build_field(bone, voxel))
    nodes = node_positions(field)
    count = 0 if bone.faces is None else len(bone.faces)
    show(
        f'{file.stem:<18}{count:>8}{1e3 * bone_s:>9.0f}{1e3 * field_s:>9.0f}'
        f'{1e-3 * len(nodes):>9.0f}'
    )
    for prepare in (igl_distances, open3d_distances):
        show(f'{beside(prepare, bone, nodes, field_s) if peers else "-":>12}')
    try:
        error = errors(bone, field)
        show(f'{1e6 * np.sqrt(np.mean(error**2)):>8.1f}{1e6 * np.abs(error).max():>8.0f}')
    except ImportError:     # the exact distances need libigl
        show(f'{"missing":>8}{"missing":>8}')
    show(f'{1e-6 * field.nbytes:>7.1f}')
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'bone.gsdf'
        save_field(field, path)
        show(
            f'{1e-6 * path.stat().st_size:>9.1f}{1e3 * median_time(lambda: load_field(path)):>9.0f}'
        )
        show(f'{peak_megabytes(file, voxel, folder):>9.0f}')
    half = build_field(bone, 0.5 * voxel)
    half_s = median_time(lambda: build_field(bone, 0.5 * voxel), 3)
    show(f'{half_s / field_s:>9.1f}{half.nbytes / field.nbytes:>6.1f}\n')


def show(text: str) -> None:
    """Print a part of a row immediately."""
    print(text, end='', flush=True)


def median_time(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the median time of several calls, s."""
    import numpy as np
    seconds = []
    for _ in range(repeats):
        started = perf_counter()
        work()
        seconds.append(perf_counter() - started)
    return float(np.median(seconds))


def node_positions(field: Field) -> Array:
    """Return the positions (n, 3), m, of all nodes of a field, each once, in random order."""
    import numpy as np

    from gsdf_registration.field.sample import CELLS, NODES
    a = field.arrays
    steps = np.argwhere(np.ones((NODES, NODES, NODES)))
    fine = (np.argwhere(a.block_of >= 0)[:, None] * CELLS + steps).reshape(-1, 3)
    coarse = np.argwhere(np.ones([n + 1 for n in a.block_of.shape])) * CELLS
    nodes = np.unique(np.concatenate([fine, coarse]), axis=0)
    return np.random.default_rng(0).permutation(nodes) * a.voxel + a.origin


def beside(prepare: Callable[[Bone], Peer], bone: Bone, nodes: Array, ours: float) -> str:
    """Return as text the time of a peer for all nodes, s, and its ratio to ours."""
    try:
        prepare(bone)(nodes[:1])    # imports the library and starts its threads
    except (ImportError, OSError):
        return 'missing'
    started, done = perf_counter(), 0
    distances = prepare(bone)
    while done < len(nodes) and perf_counter() - started < TIME_LIMIT:
        distances(nodes[done:done + BATCH])
        done += BATCH
    seconds = (perf_counter() - started) * max(1.0, len(nodes) / done)
    return f'{"~" if done < len(nodes) else ""}{seconds:.1f}s {seconds / ours:.0f}x'


def igl_distances(bone: Bone) -> Peer:
    """Return the signed distance of libigl with its default sign, on all threads."""
    import igl
    import numpy as np
    assert bone.faces is not None
    vertices, faces = bone.vertices, bone.faces.astype(np.int64)
    return lambda x: igl.signed_distance(x, vertices, faces)[0]


def open3d_distances(bone: Bone) -> Peer:
    """Return the signed distance of Open3D, on all threads."""
    import numpy as np
    import open3d as o3d
    assert bone.faces is not None
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(bone.vertices.astype(np.float32)),
                        o3d.core.Tensor(bone.faces.astype(np.uint32)))
    return lambda x: scene.compute_signed_distance(o3d.core.Tensor(x.astype(np.float32))).numpy()


def errors(bone: Bone, field: Field) -> Array:
    """Return the errors of the distance, m, at random points in the band."""
    import igl
    import numpy as np
    a = field.arrays
    rng = np.random.default_rng(0)
    edge = 4.0 * a.voxel
    blocks = rng.choice(np.argwhere(a.block_of >= 0), 3 * TESTED)
    x = a.origin + (blocks + rng.random((len(blocks), 3))) * edge
    roughly, _ = field.sample(x)
    x = x[np.abs(roughly) < (BAND + 0.5) * a.voxel][:2 * TESTED]
    assert bone.faces is not None
    exact = igl.signed_distance(x, bone.vertices, bone.faces.astype(np.int64))[0]
    inside = np.abs(exact) <= BAND * a.voxel
    return (field.sample(x)[0] - exact)[inside][:TESTED]


def peak_megabytes(file: Path, voxel: float, cache: str) -> float:
    """Return the peak memory of a process that reads, repairs, builds and caches a bone, MB."""
    command = [sys.executable, '-c', PEAK, str(file), str(voxel)]
    done = subprocess.run(command, env={**os.environ, 'GSDF_CACHE_DIR': cache}, check=True,
                          capture_output=True, text=True)
    return float(done.stdout.split()[-1]) * 1024e-6


def resampled(vertices: Array, faces: np.ndarray, count: int) -> tuple[Array, np.ndarray]:
    """Return a mesh with about ``count`` faces and nearly the same surface."""
    import numpy as np
    import open3d as o3d
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(vertices),
                                     o3d.utility.Vector3iVector(faces))
    while len(mesh.triangles) < count:
        mesh = mesh.subdivide_midpoint(1)
    mesh = mesh.simplify_quadric_decimation(count)
    return np.asarray(mesh.vertices), np.asarray(mesh.triangles)
