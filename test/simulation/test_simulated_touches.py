# SPDX-License-Identifier: Apache-2.0
"""Simulated touches: where the tip rests, and how it gets there."""

from __future__ import annotations

import numpy as np
import trimesh

from gsdf_registration.simulation.interference import Kind
from gsdf_registration.simulation.patch import Patch, whole_surface
from gsdf_registration.simulation.probe import Tracker, random_pose
from gsdf_registration.simulation.touches import Touching, simulate_touches


def ball() -> Patch:
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    return whole_surface(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def test_the_tip_rests_at_every_place_and_moves_smoothly_between() -> None:
    rng = np.random.default_rng(0)
    T = random_pose(rng)
    recording = simulate_touches(ball(), 20, rng, tracker=Tracker(sigma=1e-4),
                                 touching=Touching(tremor=0.0), T_tracker_bone=T)
    resting = recording.kinds == Kind.RESTING
    assert np.unique(recording.strokes).tolist() == list(range(20))
    for k in range(20):
        here = recording.tips[resting & (recording.strokes == k)]
        assert 24 <= len(here) <= 160 and (here == here[0]).all()
        assert abs(np.linalg.norm(here[0]) - 0.03) < 2e-4
    speed = np.linalg.norm(np.diff(recording.tips, axis=0), axis=1) * 80.0
    assert speed.max() < 0.6
    assert (recording.kinds[~resting] == Kind.LIFT_OFF).all()
    assert (np.linalg.norm(recording.tips[~resting], axis=1) > 0.025).any()
    assert (np.diff(recording.stamps) > 0.0).all()


def test_a_share_of_the_touches_is_off_the_bone() -> None:
    recording = simulate_touches(ball(), 40, np.random.default_rng(1),
                                 touching=Touching(soft_tissue=0.2, tremor=0.0))
    soft = recording.kinds == Kind.SOFT_TISSUE
    assert len(np.unique(recording.strokes[soft])) == 8
    height = np.linalg.norm(recording.tips[soft], axis=1) - 0.03
    assert height.min() > 0.0018 and height.max() < 0.0051
    assert not recording.on_bone[soft].any()
