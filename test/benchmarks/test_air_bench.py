# SPDX-License-Identifier: Apache-2.0
"""The simulated way of a probe through the air, and what a session records of it."""

from __future__ import annotations

from functools import cache

import numpy as np
from smooth_bone import bone_field, bone_mesh

from benchmarks.air.path import AirPath, measured_path
from benchmarks.air.trial import _recorded, _tools
from gsdf_registration.common import rigid
from gsdf_registration.common.tool_pose import tip_positions
from gsdf_registration.simulation.air import SHAFT, along_shaft
from gsdf_registration.simulation.patch import exposed_patch
from gsdf_registration.simulation.probe import (
    SimulatedRecording,
    Tracker,
    random_pose,
    simulate_scan,
)

TRACKER = Tracker(sigma=1e-4)


@cache
def simulated() -> tuple[SimulatedRecording, AirPath]:
    mesh, rng = bone_mesh(), np.random.default_rng(0)
    centre = mesh.vertices[np.argmax(mesh.vertices[:, 0])]
    patch = exposed_patch(mesh.vertices, mesh.faces, centre, 0.04)
    recording = simulate_scan(patch, 400, rng, tracker=TRACKER, T_tracker_bone=random_pose(rng))
    return recording, measured_path(recording, patch, bone_field(), rng, TRACKER)


def test_neither_tip_nor_shaft_enters_the_bone() -> None:
    recording, path = simulated()
    T = rigid.inverse(recording.T_tracker_bone)
    assert len(path.tips) > 50
    for positions in (path.tips, along_shaft(path.tips, path.shafts, SHAFT),
                      along_shaft(recording.positions, path.touching_shafts, SHAFT)):
        assert bone_field().sample(rigid.transform(T, positions))[0].min() > -1e-3


def test_the_tip_rises_above_the_bone_between_strokes() -> None:
    recording, path = simulated()
    height = bone_field().sample(rigid.transform(rigid.inverse(recording.T_tracker_bone),
                                                 path.tips))[0]
    assert 0.005 < height.max() < 0.08


def test_a_session_records_the_way_and_with_a_shaft_more() -> None:
    recording, path = simulated()
    tips = _recorded(path, recording, [])
    assert 0.5 * len(path.tips) < len(tips) <= len(path.tips)
    assert len(_recorded(path, recording, [0.0, 0.0, 1.0])) > 10 * len(tips)


def test_the_shaft_is_along_z_of_the_tool() -> None:
    shafts = np.random.default_rng(0).normal(size=(5, 3))
    shafts /= np.linalg.norm(shafts, axis=1)[:, None]
    tools = _tools(np.zeros((5, 3)), shafts)
    np.testing.assert_allclose(tip_positions(tools, [0.0, 0.0, 1.0]), shafts, atol=1e-12)
