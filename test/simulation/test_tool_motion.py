# SPDX-License-Identifier: Apache-2.0
"""The motion of a tool that carries its tip along a recording."""

from __future__ import annotations

import numpy as np
import trimesh

from gsdf_registration.common.rigid import transform
from gsdf_registration.simulation.ball_tip import BallContact
from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.patch import exposed_patch
from gsdf_registration.simulation.probe import SimulatedRecording, Tracker, simulate_scan
from gsdf_registration.simulation.tool_motion import Tool, ToolMotion, carried

BALL = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
VERTICES, FACES = np.asarray(BALL.vertices), np.asarray(BALL.faces)
RATE = 40.0
TOOL = Tool((0.0, 0.02, 0.1), (0.0, -1.0, 0.0))


def motion() -> tuple[SimulatedRecording, ToolMotion]:
    rng = np.random.default_rng(0)
    patch = exposed_patch(VERTICES, FACES, (0.0, 0.0, 0.04), 0.03)
    recording = simulate_scan(patch, 200, rng, tracker=Tracker(rate=RATE))
    return recording, carried(recording, patch, BallContact(VERTICES, FACES).distance, RATE, rng,
                              TOOL)


def test_the_tip_of_the_tool_passes_all_recorded_places_at_their_times() -> None:
    recording, made = motion()
    rows = np.searchsorted(made.stamps, recording.stamps)
    np.testing.assert_array_equal(made.stamps[rows], recording.stamps)
    tips = [transform(T, TOOL.tip) for T in made.T_bone_tool[rows]]
    np.testing.assert_allclose(tips, recording.tips, atol=1e-12)
    np.testing.assert_array_equal(made.kinds[rows], recording.kinds)


def test_pauses_are_filled_with_frames_in_the_air() -> None:
    recording, made = motion()
    assert np.diff(recording.stamps).max() > 0.6
    assert np.diff(made.stamps).max() < 1.5 / RATE and np.diff(made.stamps).min() > 0.5 / RATE
    assert (made.kinds == Kind.LIFT_OFF).sum() == len(made.stamps) - len(recording.stamps)


def test_the_tool_turns_steadily_and_its_shaft_points_away_from_the_bone() -> None:
    _, made = motion()
    np.testing.assert_allclose(made.T_bone_tool[:, :3, :3] @ np.array(TOOL.shaft), made.shafts,
                               atol=1e-12)
    cosines = (made.shafts * made.tips).sum(axis=1) / np.linalg.norm(made.tips, axis=1)
    assert cosines.min() > 0.3
    steps = np.einsum('nij,nij->n', made.T_bone_tool[1:, :3, :3], made.T_bone_tool[:-1, :3, :3])
    angles = np.degrees(np.arccos(np.clip((steps - 1.0) / 2.0, -1.0, 1.0)))
    assert 0.5 < np.median(angles) < 10.0 and angles.max() < 40.0
