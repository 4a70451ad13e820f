# SPDX-License-Identifier: Apache-2.0
"""Ball tip, cartilage and soft tissue between a probe and a bone."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, inverse, transform
from gsdf_registration.simulation.ball_tip import BallContact
from gsdf_registration.simulation.interference import Interference
from gsdf_registration.simulation.patch import exposed_patch
from gsdf_registration.simulation.probe import SimulatedRecording, Tracker, simulate_scan
from gsdf_registration.simulation.touched_bone import TouchedBone

BALL = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
VERTICES, FACES = np.asarray(BALL.vertices), np.asarray(BALL.faces)
PATCH = exposed_patch(VERTICES, FACES, (0.0, 0.0, 0.03), 0.02)


def touched(**covers: float | bool) -> tuple[SimulatedRecording, Array]:
    """Return a recording and the heights of the tip above the bone."""
    rng = np.random.default_rng(0)
    bare = simulate_scan(PATCH, 200, rng, tracker=Tracker(sigma=0.0),
                         interference=Interference(lift_off=0.1))
    recording = TouchedBone(VERTICES, FACES, PATCH, **covers).touched(bare, rng)
    return recording, BallContact(VERTICES, FACES).distance(recording.tips[recording.on_bone])[0]


def test_a_sharp_tip_touches_the_bare_bone() -> None:
    assert np.abs(touched()[1]).max() < 1e-6


def test_the_centre_of_a_ball_stays_off_the_bone_by_its_radius() -> None:
    np.testing.assert_allclose(touched(tip_radius=0.001)[1], 0.001, atol=1e-6)


def test_cartilage_covers_a_part_and_adds_to_the_ball() -> None:
    heights = touched(tip_radius=0.001, cartilage=True)[1] - 0.001
    assert 0.2 < (heights > 1e-5).mean() < 0.7
    assert heights.max() == pytest.approx(0.0008, abs=2e-5)


def test_soft_tissue_keeps_the_tip_off_the_bone_everywhere() -> None:
    heights = touched(soft_tissue=0.002)[1]
    assert heights.min() > -1e-6 and 0.001 < heights.mean() < 0.003


def test_measured_positions_move_with_the_tip_and_the_air_stays() -> None:
    recording, _ = touched(soft_tissue=0.002)
    bare, _ = touched()
    np.testing.assert_allclose(transform(inverse(recording.T_tracker_bone), recording.positions),
                               recording.tips, atol=1e-9)
    np.testing.assert_array_equal(recording.tips[~recording.on_bone], bare.tips[~bare.on_bone])


@pytest.mark.parametrize('covers', [{'tip_radius': -0.001}, {'soft_tissue': 0.1},
                                    {'tip_radius': float('nan')}])
def test_lengths_must_be_plausible(covers: dict[str, float]) -> None:
    with pytest.raises(InputError, match='must be 0 to 10 mm'):
        TouchedBone(VERTICES, FACES, PATCH, **covers)
