# SPDX-License-Identifier: Apache-2.0
"""
Landmarks with a standard deviation as measurements of the pose.

A landmark far from where the points and the other landmarks expect it is a mistake: another place
was touched, or the bone moved. It is found and left out, so that it changes neither the pose nor
its covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from gsdf_registration.common import rigid
from gsdf_registration.common.formatting import format_length
from gsdf_registration.common.landmarks import Landmarks
from gsdf_registration.common.result import LandmarkFit
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import (
    Confidence,
    about,
    noise_of,
    with_landmarks,
)
from gsdf_registration.registration.joint_optimum import (
    information_factor,
    joint_optimum,
    linearize,
)
from gsdf_registration.registration.motions import inverse
from gsdf_registration.solver import Solution

# Standard deviations from where it was expected, from which a landmark is a mistake: by chance, one
# of a thousand is
MISTAKE = 4.0
OUTLIER = 3.0       # standard deviations of a point that hardly counts while a pose slides
ON_BONE = 0.003     # m: a landmark so near to the surface is one that is touched
MOST_MISTAKES = 3   # that are found at once; more are found one after the other
# Log-likelihood that a mistake costs a pose. A landmark that fits costs at most half the square of
# `MISTAKE`, 8, so one that fits decides between two poses that fit the points equally well, for
# which the default of `limits.min_gap` is 24; one mistake alone does not outweigh points that fit
# one pose.
MISTAKE_COST = 32.0
# Difference in squared standard deviations below which two explanations are about as likely. If it
# is not clear which landmark is the mistake, none of them is used.
UNCLEAR = 9.0


def log_likelihood(landmarks: Landmarks, T_bone_tracker: Array) -> float:
    """Return the log-likelihood of a pose; a mistake costs a fixed amount."""
    residual = rigid.transform(T_bone_tracker, landmarks.touched) - landmarks.model
    squared = (residual**2).sum(axis=1) / landmarks.sigmas**2
    return -float(np.minimum(0.5 * squared, MISTAKE_COST).sum())


def for_tip(landmarks: Landmarks, field: Field) -> Landmarks:
    """
    Return the landmarks where the centre of the ball tip is while the ball touches them.

    A joint centre is not on the surface: it stays.
    """
    if field.tip_radius == 0.0 or not len(landmarks):
        return landmarks
    distance, outward = field.sample(landmarks.model)
    on_bone = np.abs(distance + field.tip_radius) < ON_BONE
    return replace(landmarks, model=landmarks.model
                   - np.where(on_bone, distance, 0.0)[:, None] * outward)


def fuse(solution: Solution, confidence: Confidence, points: Array, field: Field,
         landmarks: Landmarks) -> tuple[Solution, Confidence, tuple[LandmarkFit, ...]]:
    """
    Return the solution of points and landmarks together, its confidence, and the landmarks.

    Residuals, Jacobian and covariance are those at the new pose; the weights of the points stay.
    A solution that does not converge is marked so.

    Parameters
    ----------
    solution : Solution
        Of the points alone.
    confidence : Confidence
        Of this solution.
    points : (n, 3) float64, metres, tracker frame
        The points of the solution.
    field : Field
    landmarks : Landmarks
        With standard deviations.

    """
    if not len(landmarks):
        return solution, confidence, ()
    T, centre = solution.T_bone_tracker, confidence.centroid
    information = inverse(confidence.motion_covariance)
    weight = solution.weights * solution.precision**2
    factor = information_factor(T, points, field, weight, information, centre)
    used = plausible(landmarks, T, centre, information)
    while True:
        fused, converged = joint_optimum(T, points, field, weight, factor, centre,
                                         landmarks.rows(used))
        deviations = _deviations(landmarks, used, fused, centre, information)
        worst = max(used, key=deviations.__getitem__, default=-1)
        if worst < 0 or deviations[worst] <= MISTAKE:
            break
        used.remove(worst)
    moved = _at(solution, fused, points, field, converged)
    new_centre = rigid.transform(fused, points.mean(axis=0))
    B, _, precision = linearize(fused, new_centre, landmarks.rows(used))
    sure = with_landmarks(replace(about(confidence, new_centre), sigma=noise_of(moved)),
                          np.einsum('kij,kil,k->jl', B, B, precision))
    apart = np.linalg.norm(rigid.transform(fused, landmarks.touched) - landmarks.model, axis=1)
    return moved, sure, tuple(
        LandmarkFit(name, k in used, float(landmarks.sigmas[k]), float(apart[k]), deviations[k])
        for k, name in enumerate(landmarks.names))


def mistakes(fits: Sequence[LandmarkFit]) -> str:
    """Return a sentence on the landmarks that are mistakes; empty if there are none."""
    wrong = [fit for fit in fits if not fit.used]
    if not wrong:
        return ''
    off = ', '.join(f'"{fit.name}" is {format_length(fit.residual_m)} from its place, '
                    f'{fit.deviations:.0f} times what was expected' for fit in wrong)
    return (f'{"a landmark is" if len(wrong) == 1 else f"{len(wrong)} landmarks are"} left out as '
            f'a mistake: {off}; check what was touched')


def slide(T_bone_tracker: Array, points: Array, field: Field, sd: Array,
          landmarks: Landmarks) -> Array:
    """
    Return the pose near an optimum of the points that fits points and landmarks together.

    Parameters
    ----------
    T_bone_tracker : (4, 4) float, metres
    points : (n, 3) float64, metres, tracker frame
    field : Field
    sd : (n,) float, m
        Standard deviation of each point, as if they were independent.
    landmarks : Landmarks
        With standard deviations; mistakes are left out.

    """
    x = rigid.transform(T_bone_tracker, points)
    centre, (e, normal) = x.mean(axis=0), field.sample(x)
    weight = 1.0 / (sd * (1.0 + (e / (OUTLIER * sd))**2))**2
    J = np.concatenate([np.cross(x - centre, normal), normal], axis=1)
    used = plausible(landmarks, T_bone_tracker, centre, (J.T * weight) @ J)
    T, converged = joint_optimum(T_bone_tracker, points, field, weight, np.eye(6), centre,
                                 landmarks.rows(used))
    return T if converged else T_bone_tracker


def plausible(landmarks: Landmarks, T_bone_tracker: Array, centre: Array,
              information: Array) -> list[int]:
    """
    Return which landmarks agree with the points and with each other.

    Of all ways to leave some of them out, the one with the least misfit, where one that is left out
    costs as much as one that is four standard deviations off: the truncated least squares, found by
    trying all, because with one of three wrong, all three are off at the pose of all. Where another
    way is about as likely, what that leaves out is left out, too.

    Parameters
    ----------
    landmarks : Landmarks
    T_bone_tracker : (4, 4) float, metres
        The optimum of the points.
    centre : (3,) float, metres, bone frame
    information : (6, 6) float
        Of the points, about ``centre``.

    """
    kept = list(range(len(landmarks)))
    while True:
        ways = _ways(landmarks, kept, T_bone_tracker, centre, information)
        least, best = min(ways)
        left_out = {k for misfit, out in ways for k in out
                    if misfit < least + UNCLEAR and len(out) <= len(best)}
        if not best:
            return kept
        kept = [k for k in kept if k not in left_out]


def _ways(landmarks: Landmarks, kept: list[int], T_bone_tracker: Array, centre: Array,
          information: Array) -> list[tuple[float, tuple[int, ...]]]:
    """Return the misfit of points and ``kept`` landmarks for each way to leave some of them out."""
    B, r, precision = linearize(T_bone_tracker, centre, landmarks)
    N = np.einsum('kij,kil,k->kjl', B, B, precision)
    b = np.einsum('kij,ki,k->kj', B, r, precision)
    squared = (r**2).sum(axis=1) * precision
    ways = []
    for count in range(min(MOST_MISTAKES, len(kept)) + 1):
        for out in combinations(kept, count):
            rows = [k for k in kept if k not in out]
            gain = b[rows].sum(axis=0)
            C = inverse(_positive(information + N[rows].sum(axis=0)))
            ways.append((float(squared[rows].sum() - gain @ C @ gain) + MISTAKE**2 * count, out))
    return ways


def _positive(matrix: Array) -> Array:
    """Return a matrix (6, 6) that can be inverted, changed by 1e-12 of its diagonal."""
    return matrix + np.diag(1e-12 * np.diag(matrix) + 1e-300)


def _deviations(landmarks: Landmarks, used: list[int], T_bone_tracker: Array, centre: Array,
                information: Array) -> list[float]:
    """
    Return how far each landmark is from where it is expected without it, in standard deviations.

    The pose without it follows from one step from the pose with it: the score of all the rest is
    minus that of the landmark.
    """
    B, r, precision = linearize(T_bone_tracker, centre, landmarks)
    N = np.einsum('kij,kil,k->kjl', B, B, precision)
    found = []
    for k in range(len(landmarks)):
        C = inverse(information + N[[j for j in used if j != k]].sum(axis=0))
        without = r[k] + (B[k] @ C @ B[k].T @ r[k] * precision[k] if k in used else 0.0)
        expected = np.eye(3) / precision[k] + B[k] @ C @ B[k].T
        found.append(float(np.sqrt(without @ np.linalg.solve(expected, without))))
    return found


def _at(solution: Solution, T_bone_tracker: Array, points: Array, field: Field,
        converged: bool) -> Solution:
    """Return a solution moved to another pose, with residuals and Jacobian there."""
    before, after = (rigid.transform(T, points) for T in (solution.T_bone_tracker, T_bone_tracker))
    e, normal = field.sample(after)
    arms = after - rigid.transform(T_bone_tracker, points.mean(axis=0))
    step = T_bone_tracker @ rigid.inverse(solution.T_bone_tracker)
    return replace(
        solution, T_bone_tracker=T_bone_tracker, correction=step @ solution.correction,
        residuals=solution.residuals + e - field.sample(before)[0],
        jacobian=np.concatenate([np.cross(arms, normal), normal], axis=1),
        converged=solution.converged and converged,
        termination=solution.termination if converged else
        'the points and the landmarks have no common optimum')
