# SPDX-License-Identifier: Apache-2.0
"""Simulate an archive of small recordings with a table of cases, and some that are damaged."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gsdf_registration.common.rigid import transform
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.simulation.probe import random_pose, simulate_scan
from gsdf_registration.simulation.regions import named_patch
from msg_adapters.bag_writer import BagWriter
from msg_adapters.points import read_model
from msg_adapters.truth import Truth, write_truth

POINTS, REGION, FRAME = 300, 'acetabulum', 'tracker'
START = 1.75e9          # s, of the first stamp
LANDMARK_ERROR = 0.002  # m, standard deviation along each axis
BAD_EVERY = 20          # recordings: one is cut, and one is empty


def simulate_archive(folder: Path, model: Path, count: int, seed: int,
                     advance: Callable[[], None]) -> Path:
    """
    Write recordings with their ground truth, and return the table of cases.

    Of 20 recordings one is cut in half and one is empty.

    Parameters
    ----------
    folder : of the archive
    model : mesh of a hip, mm
    count : number of recordings
    seed : of the first recording; each depends only on its own
    advance : is called for each recording

    """
    vertices, faces, _ = read_model(model, 'mm')
    bone = make_bone(vertices, faces)
    patch = named_patch(REGION, bone.vertices, np.asarray(bone.faces))
    places = bone.vertices[patch_places(bone.vertices, patch.centre)]
    with (folder / 'cases.csv').open('w', newline='') as file:
        table = csv.writer(file)
        table.writerow(['bag', 'landmarks', 'label'])
        for number in range(count):
            rng = np.random.default_rng([seed, number])
            bag = folder / f'{number // 1000:04d}' / f'case_{number:06d}'
            bag.parent.mkdir(exist_ok=True)
            T = random_pose(rng, translation=0.3)
            scan = simulate_scan(patch, POINTS, rng, T_tracker_bone=T)
            with BagWriter(bag) as writer:
                for stamp, position in zip(scan.stamps, scan.positions):
                    writer.write_point('/probe/tip', START + float(stamp), position, FRAME)
            touched = transform(scan.T_tracker_bone, places) + rng.normal(
                0.0, LANDMARK_ERROR, places.shape)
            truth = bag.with_suffix('.yaml')
            write_truth(truth, Truth(os.path.relpath(model, bag.parent), 'mm', FRAME,
                                     scan.T_tracker_bone, ('a', 'b', 'c', 'd'), places, touched))
            _damage(bag, number % BAD_EVERY)
            table.writerow([bag.relative_to(folder), truth.relative_to(folder), f'case {number}'])
            advance()
    return folder / 'cases.csv'


def patch_places(vertices: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the rows of four vertices at different distances from the exposed area."""
    order = np.argsort(np.linalg.norm(vertices - centre, axis=1))
    return order[(np.array([0.02, 0.3, 0.6, 0.95]) * len(order)).astype(int)]


def _damage(bag: Path, kind: int) -> None:
    """Cut the recording in half (0) or leave nothing of it (10)."""
    file, = bag.glob('*.mcap')
    if kind in (0, BAD_EVERY // 2):
        os.truncate(file, file.stat().st_size // 2 if kind == 0 else 0)
