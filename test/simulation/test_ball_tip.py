# SPDX-License-Identifier: Apache-2.0
"""Test that a simulated ball touches the mesh, wherever it rolls."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, exp, transform
from gsdf_registration.simulation.ball_tip import BallContact, with_ball_tip
from gsdf_registration.simulation.interference import Interference, Kind
from gsdf_registration.simulation.patch import whole_surface
from gsdf_registration.simulation.probe import SimulatedRecording, simulate_scan

UP = np.array([0.0, 0.0, 1.0])
HALF = np.array([0.02, 0.03, 0.015])     # m, half the sides of a box
RADIUS = 0.001


def box() -> tuple[Array, np.ndarray]:
    mesh = trimesh.creation.box(2.0 * HALF)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def two_boxes(gap: float) -> tuple[Array, np.ndarray]:
    """Return two boxes side by side, with a slot of this width between them."""
    vertices, faces = box()
    shift = np.array([HALF[0] + 0.5 * gap, 0.0, 0.0])
    return np.vstack([vertices - shift, vertices + shift]), np.vstack([faces, faces + 8])


def distance_to_box(points: Array) -> Array:
    beyond = np.abs(points) - HALF
    return np.asarray(np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
                      + np.minimum(beyond.max(axis=1), 0.0))


def test_distances_are_exact_and_negative_inside() -> None:
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (3000, 3)) * HALF
    distance, closest, _ = BallContact(*box()).nearest(points)
    np.testing.assert_allclose(distance, distance_to_box(points), atol=1e-12)
    np.testing.assert_allclose(distance_to_box(closest), 0.0, atol=1e-12)


def test_on_a_flat_face_the_centre_is_the_touched_point_moved_along_the_normal() -> None:
    touched = np.array([[0.01, -0.02, HALF[2]], [-HALF[0], 0.01, 0.002]])
    centres = BallContact(*box()).centres(touched, RADIUS, UP)
    np.testing.assert_allclose(centres, touched + RADIUS * np.array([[0, 0, 1], [-1, 0, 0]]),
                               atol=1e-12)


@pytest.mark.parametrize('gap', [0.0005, 0.001, 0.0018])
def test_a_ball_rests_on_the_rims_of_a_slot_that_is_narrower(gap: float) -> None:
    contact = BallContact(*two_boxes(gap))
    deep = np.array([[s * 0.5 * gap, y, HALF[2] - 0.003] for s in (-1, 1) for y in (0.0, 0.01)])
    centres = contact.centres(deep, RADIUS, UP)
    np.testing.assert_allclose(contact.nearest(centres)[0], RADIUS, atol=2e-7)
    # at least as high as on both rims
    assert (centres[:, 2] > HALF[2] + math.sqrt(RADIUS**2 - 0.25 * gap**2) - 1e-6).all()


def test_a_ball_in_a_wide_slot_touches_its_wall() -> None:
    contact = BallContact(*two_boxes(0.004))
    centres = contact.centres(np.array([[0.002, 0.0, 0.005]]), RADIUS, UP)
    np.testing.assert_allclose(centres, [[0.001, 0.0, 0.005]], atol=1e-9)


def recordings() -> tuple[SimulatedRecording, SimulatedRecording]:
    ball = trimesh.creation.icosphere(4, 0.03)
    surface = np.asarray(ball.vertices), np.asarray(ball.faces)
    sharp = simulate_scan(
        whole_surface(*surface), 300, np.random.default_rng(0),
        interference=Interference(uniform=0.1, soft_tissue=0.2),
        T_tracker_bone=exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0]))
    return sharp, with_ball_tip(sharp, *surface, UP, RADIUS)


def test_a_recording_with_a_ball_has_the_same_noise_stamps_and_outliers() -> None:
    sharp, ball = recordings()
    np.testing.assert_array_equal(ball.stamps, sharp.stamps)
    np.testing.assert_array_equal(ball.kinds, sharp.kinds)
    noise = [each.positions - transform(each.T_tracker_bone, each.tips) for each in (sharp, ball)]
    np.testing.assert_allclose(noise[1], noise[0], atol=1e-12)
    moved = np.linalg.norm(ball.tips - sharp.tips, axis=1)
    np.testing.assert_allclose(moved[sharp.kinds != Kind.UNIFORM], RADIUS, atol=1e-5)
    assert not moved[sharp.kinds == Kind.UNIFORM].any()


@pytest.mark.parametrize('radius', [0.0, -0.001, math.nan, math.inf])
def test_a_radius_that_is_no_ball_is_refused(radius: float) -> None:
    with pytest.raises(InputError, match='radius of a ball tip must be positive'):
        with_ball_tip(recordings()[0], *box(), UP, radius)
