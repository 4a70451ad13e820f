# SPDX-License-Identifier: Apache-2.0
"""The initial guess from touched landmarks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import InputError, as_numbers
from gsdf_registration.common.rigid import Array

MIN_LANDMARKS = 3       # that determine a pose
MIN_SEPARATION = 0.005  # m: landmarks nearer than the usual touch error cannot be distinguished
MIN_SPREAD = 0.1        # width over length of the landmarks: below, they lie on a line
# m: by touch errors of about 4 mm each, the distance of two landmarks is hardly ever off by more
MAX_DISAGREEMENT = 0.012
MAX_ORDERED = 5         # landmarks of which every order is tried


def named_points(config: Config) -> dict[str, Array]:
    """Return the landmarks and targets of the settings by name, (3,) float, m, bone frame."""
    positions = np.reshape(config.landmarks.positions + config.targets.positions, (-1, 3))
    return dict(zip(config.landmarks.names + config.targets.names, positions))


def pose_from_landmarks(model: ArrayLike, tracker: ArrayLike) -> tuple[Array, float]:
    """
    Return the pose that best maps landmarks of the model onto the touched landmarks.

    Parameters
    ----------
    model : (n, 3) float, metres, bone frame, n >= 3
    tracker : (n, 3) float, metres, tracker frame
        Row i is landmark i of ``model``, as touched.

    Returns
    -------
    T_tracker_bone : (4, 4) float
    residual_rms : float, metres
        How well the two sets agree; it is not the accuracy of the pose.

    Raises
    ------
    InputError
        If there are fewer than three pairs, two landmarks coincide, or all lie on a line, which
        leaves the rotation about it undetermined.

    """
    model, tracker = as_numbers(model, 'model landmarks'), as_numbers(tracker, 'touched landmarks')
    if model.shape != tracker.shape or model.ndim != 2 or model.shape[1] != 3:
        raise InputError(
            'landmarks need one touched point for each model point; the arrays have the shapes '
            f'{model.shape} and {tracker.shape}')
    if len(model) < MIN_LANDMARKS:
        raise InputError(f'{format_count(len(model), "landmark")} cannot determine a pose; '
                         'touch at least three')
    if not (np.isfinite(model).all() and np.isfinite(tracker).all()):
        raise InputError('a landmark has a coordinate that is not finite; touch it again')
    for points, where in ((model, 'on the model'), (tracker, 'as touched')):
        _check_spread(points, where)
    T = rigid.fit_points(tracker, model)
    residual = tracker - rigid.transform(T, model)
    return T, float(np.sqrt((residual**2).sum(axis=1).mean()))


def _check_spread(points: Array, where: str) -> None:
    """Raise InputError if two of the points coincide or all lie on a line."""
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    i, j = np.unravel_index(np.argmin(distance + np.diag(np.full(len(points), np.inf))),
                            distance.shape)
    if distance[i, j] < MIN_SEPARATION:
        raise InputError(
            f'landmarks {min(i, j) + 1} and {max(i, j) + 1} {where} are only '
            f'{1e3 * distance[i, j]:.1f} mm apart; touch points that are well apart')
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < MIN_SPREAD * spread[0]:
        raise InputError(
            f'the landmarks {where} lie on a line, so the rotation about it is undetermined; touch '
            'a landmark off the line')


def disagreement(names: Sequence[str], model: Array, tracker: Array) -> str:
    """
    Compare the distances between landmarks as touched with those on the model.

    They do not depend on the pose, so a wrong landmark is found before there is a pose.

    Parameters
    ----------
    names : sequence of str, k
    model : (k, 3) float, metres, bone frame
    tracker : (k, 3) float, metres, tracker frame

    Returns
    -------
    str
        A sentence on the order in which they were touched, on the one landmark without which the
        others agree, or on the pair that differs most. Empty if all agree.

    """
    apart = [np.linalg.norm(points[:, None] - points[None], axis=2) for points in (model, tracker)]
    off = np.abs(apart[0] - apart[1])
    if off.max() <= MAX_DISAGREEMENT:
        return ''
    for order in permutations(range(len(names))) if 2 < len(names) <= MAX_ORDERED else ():
        if np.abs(apart[0][np.ix_(order, order)] - apart[1]).max() <= MAX_DISAGREEMENT:
            return ('the landmarks were probably touched in this order: '
                    + ', '.join(f'"{names[k]}"' for k in order))
    odd = [k for k in range(len(names))
           if np.delete(np.delete(off, k, 0), k, 1).max() <= MAX_DISAGREEMENT]
    if len(odd) == 1:
        k = odd[0]
        return (f'"{names[k]}" is up to {1e3 * off[k].max():.0f} mm off relative to the other '
                'landmarks; check that the right place was touched')
    i, j = sorted(divmod(int(np.argmax(off)), len(names)))
    return (f'"{names[i]}" and "{names[j]}" are {1e3 * apart[1][i, j]:.0f} mm apart, but '
            f'{1e3 * apart[0][i, j]:.0f} mm on the model; check that the right places were touched')
