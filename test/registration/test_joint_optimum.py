# SPDX-License-Identifier: Apache-2.0
"""The pose that fits points and landmarks together is that of a brute-force minimization."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.common import rigid
from gsdf_registration.common.landmarks import NO_LANDMARKS, Landmarks
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.joint_optimum import (
    information_factor,
    joint_optimum,
    linearize,
)
from gsdf_registration.registration.motions import inverse, moved

NOISE = 3e-4
PLACES = np.array([[0.2, 0.05, 0.0], [-0.1, 0.1, 0.1]])     # m, away from the bone
EVERYWHERE = np.ones(60)


class Torus:
    """A body whose distance is known exactly; points do not constrain the turn about its axis."""

    def __init__(self, ring: float = 0.04, tube: float = 0.015) -> None:
        self.ring, self.tube = ring, tube

    def sample(self, x: Array) -> tuple[Array, Array]:
        """Return the distance and its gradient."""
        out = x[:, :2] / np.linalg.norm(x[:, :2], axis=1)[:, None]
        from_tube = x - self.ring * np.column_stack([out, np.zeros(len(x))])
        away = np.linalg.norm(from_tube, axis=1)
        return away - self.tube, from_tube / away[:, None]

    def points(self, seed: int) -> Array:
        """Return points on a part of it, with noise, in the frame of the tracker."""
        u, v = np.random.default_rng(seed).uniform([[0.0], [-1.5]], [[1.5], [1.5]], (2, 80))
        across = self.ring + self.tube * np.cos(v)
        x = np.column_stack([across * np.cos(u), across * np.sin(u), self.tube * np.sin(v)])
        noise = NOISE * np.random.default_rng(seed + 100).normal(size=x.shape)
        return rigid.transform(T_TRACKER_BONE, x + noise)


def brute_force(field: Field | Torus, points: Array, marks: Landmarks, T: Array) -> Array:
    """Minimize the sum of both squared misfits over the pose, by another solver."""
    def misfits(x: Array) -> Array:
        there = rigid.exp(x) @ T
        off = rigid.transform(there, marks.touched) - marks.model
        return np.concatenate([field.sample(rigid.transform(there, points))[0] / NOISE,
                               (off / marks.sigmas[:, None]).ravel()])
    found = least_squares(misfits, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15,
                          x_scale=[0.01, 0.01, 0.01, 1e-3, 1e-3, 1e-3])
    return rigid.exp(found.x) @ T


def optimum_of_points(points: Array) -> Array:
    return brute_force(bone_field(), points, NO_LANDMARKS, rigid.inverse(T_TRACKER_BONE))


def problem(seed: int, radius: float = 0.02) -> Array:
    """Return a few points of a small part of the bone, which constrain the pose weakly."""
    return rigid.transform(T_TRACKER_BONE, touched_points(60, seed, NOISE, radius))


def landmarks(off: Array, sigma: float = 0.002) -> Landmarks:
    return Landmarks.of(PLACES, rigid.transform(T_TRACKER_BONE, PLACES) + off,
                        sigma * np.array([1.0, 1.5]))


@pytest.mark.parametrize('seed', range(5))
def test_equals_a_brute_force_minimization_also_after_a_long_motion(seed: int) -> None:
    torus = Torus()
    points = torus.points(seed)
    alone = brute_force(torus, points, NO_LANDMARKS, rigid.inverse(T_TRACKER_BONE))
    # anywhere along the motion that the points do not constrain is their optimum as well
    start = rigid.exp([0.0, 0.0, 0.1 * (seed + 1), 0.0, 0.0, 0.0]) @ alone
    marks = landmarks(0.006 * np.random.default_rng(seed).normal(size=(2, 3)))
    found, converged = joint_optimum(start, points, cast(Field, torus), np.ones(len(points)),
                                     np.eye(6) / NOISE**2, np.zeros(3), marks)
    expected = brute_force(torus, points, marks, alone)
    assert converged and rigid.displacement(start, expected, marks.touched).max() > 0.005
    assert rigid.displacement(found, expected, marks.touched).max() < 2e-6


def misfit(T: Array, points: Array, marks: Landmarks) -> float:
    e = bone_field().sample(rigid.transform(T, points))[0] / NOISE
    off = (rigid.transform(T, marks.touched) - marks.model) / marks.sigmas[:, None]
    return float((e**2).sum() + (off**2).sum())


@pytest.mark.parametrize('seed', range(3))
def test_no_pose_of_a_sampled_field_fits_both_clearly_better(seed: int) -> None:
    points = problem(seed)
    marks = landmarks(0.006 * np.random.default_rng(seed).normal(size=(2, 3)))
    start = optimum_of_points(points)
    found, converged = joint_optimum(start, points, bone_field(), EVERYWHERE,
                                     np.eye(6) / NOISE**2, np.zeros(3), marks)
    assert converged and rigid.displacement(start, found, marks.touched).max() > 0.003
    before, after, least = (misfit(T, points, marks) for T in (
        start, found, brute_force(bone_field(), points, marks, start)))
    assert after - least < 0.05 * (before - least)


def test_without_landmarks_the_pose_stays() -> None:
    points = problem(0)
    start = optimum_of_points(points) @ rigid.exp([1e-3, 0.0, 0.0, 0.0, 0.0, 1e-4])
    found, _ = joint_optimum(start, points, bone_field(), EVERYWHERE, np.eye(6), np.zeros(3),
                             NO_LANDMARKS)
    np.testing.assert_allclose(found, start, atol=1e-12)


def test_to_first_order_it_minimizes_the_quadratic_form_of_the_information() -> None:
    points, field, centre = problem(1, 0.045), bone_field(), np.array([0.01, 0.0, 0.02])
    start = optimum_of_points(points)
    rng = np.random.default_rng(3)
    root = rng.normal(size=(6, 6)) * np.array([30.0, 40.0, 50.0, 2e3, 1e3, 3e3])
    information = root.T @ root + np.diag([1e3, 1e3, 1e3, 1e6, 1e6, 1e6])
    factor = information_factor(start, points, field, EVERYWHERE, information, centre)
    exact = Landmarks.of(PLACES, rigid.transform(rigid.inverse(start), PLACES), [0.002, 0.003])
    small = 1e-6 * rng.normal(size=(2, 3))
    touched = exact.touched + small @ start[:3, :3]
    near = Landmarks.of(PLACES, touched, exact.sigmas)
    B, r, precision = linearize(start, centre, near)
    np.testing.assert_allclose(r, small, atol=1e-12)
    step = -np.linalg.solve(
        information + np.einsum('kij,kil,k->jl', B, B, precision),
        np.einsum('kij,ki,k->j', B, r, precision))
    found, _ = joint_optimum(start, points, field, EVERYWHERE, factor, centre, near)
    expected = moved(step, centre) @ start
    shift = rigid.displacement(start, expected, touched)
    assert rigid.displacement(found, expected, touched).max() < 0.03 * shift.max()


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6))
def test_does_not_depend_on_the_frame_of_the_tracker(twist: list[float]) -> None:
    T, points = rigid.exp(twist), problem(0)
    start = rigid.inverse(T_TRACKER_BONE)
    off = 0.002 * np.random.default_rng(1).normal(size=(2, 3))
    here = landmarks(off)
    there = Landmarks.of(PLACES, rigid.transform(T, here.touched), here.sigmas)
    one, other = (
        joint_optimum(pose, cloud, bone_field(), EVERYWHERE, np.eye(6) / NOISE**2, np.zeros(3),
                      marks)[0]
        for pose, cloud, marks in ((start, points, here),
                                   (start @ rigid.inverse(T), rigid.transform(T, points), there)))
    np.testing.assert_allclose(other @ T, one, atol=1e-8)


def test_an_inverse_of_motions_has_no_unit() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6))
    matrix = root @ root.T * np.outer([1, 1, 1, 1e-6, 1e-6, 1e-6], [1, 1, 1, 1e-6, 1e-6, 1e-6])
    np.testing.assert_allclose(inverse(matrix) @ matrix, np.eye(6), atol=1e-8)
