# SPDX-License-Identifier: Apache-2.0
"""A first guess from touched landmarks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError, as_numbers
from gsdf_registration.common.rigid import Array

MIN_SEPARATION = 0.005  # m: landmarks nearer than their usual touch error are one
MIN_SPREAD = 0.1        # width over length of their triangle: less is a line
# m: two touches of some 4 mm error each lie hardly farther from or nearer to one another than this
DISAGREEMENT = 0.012
MOST_ORDERED = 5        # landmarks of which every order is tried


def named_points(config: Config) -> dict[str, Array]:
    """Return the landmarks and targets of the settings by name, (3,) float, m, bone frame."""
    positions = np.reshape(config.landmarks.positions + config.targets.positions, (-1, 3))
    return dict(zip(config.landmarks.names + config.targets.names, positions))


def pose_from_landmarks(model: ArrayLike, tracker: ArrayLike) -> tuple[Array, float]:
    """
    Return the pose that best maps landmarks of the model onto the touched ones.

    Parameters
    ----------
    model : (n, 3) float, metres, bone frame, n >= 3
    tracker : (n, 3) float, metres, tracker frame, row i is the touch of row i of ``model``

    Returns
    -------
    T_tracker_bone : (4, 4) float
    residual_rms : float, metres; how well the two triangles agree, not how accurate the pose is

    Raises
    ------
    InputError
        If there are fewer than three pairs, two of them coincide, or they lie on a line: a rotation
        about the line would be free.

    """
    model, tracker = as_numbers(model, 'model landmarks'), as_numbers(tracker, 'touched landmarks')
    if model.shape != tracker.shape or model.ndim != 2 or model.shape[1] != 3:
        raise InputError(
            f'landmarks need one touched point for each model point; got arrays of shape '
            f'{model.shape} and {tracker.shape}')
    if len(model) < 3:
        raise InputError(f'{len(model)} landmark(s) do not fix a pose; touch at least three')
    if not (np.isfinite(model).all() and np.isfinite(tracker).all()):
        raise InputError('a landmark holds a number that is not finite; touch it again')
    for points, where in ((model, 'on the model'), (tracker, 'as touched')):
        _refuse_degenerate(points, where)
    T = rigid.fit_points(tracker, model)
    residual = tracker - rigid.transform(T, model)
    return T, float(np.sqrt((residual**2).sum(axis=1).mean()))


def _refuse_degenerate(points: Array, where: str) -> None:
    """Raise InputError where two of the points coincide or all lie on a line."""
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
            f'the landmarks {where} lie on a line, which leaves the rotation about it free; touch '
            'a point off the line')


def disagreement(names: Sequence[str], model: Array, tracker: Array) -> str:
    """
    Tell whether the distances between landmarks are on the bone what they are on the model.

    They do not depend on the pose, so that a wrong touch shows before there is one.

    Parameters
    ----------
    names : k of them
    model, tracker : (k, 3) float, metres, bone frame and as touched

    Returns
    -------
    str
        What is wrong, naming the order they were touched in or the one landmark without which the
        others agree; empty if nothing is.

    """
    apart = [np.linalg.norm(points[:, None] - points[None], axis=2) for points in (model, tracker)]
    off = np.abs(apart[0] - apart[1])
    if off.max() <= DISAGREEMENT:
        return ''
    for order in permutations(range(len(names))) if 2 < len(names) <= MOST_ORDERED else ():
        if np.abs(apart[0][np.ix_(order, order)] - apart[1]).max() <= DISAGREEMENT:
            return ('but it looks as if they were touched in this order: '
                    + ', '.join(f'"{names[k]}"' for k in order))
    odd = [k for k in range(len(names))
           if np.delete(np.delete(off, k, 0), k, 1).max() <= DISAGREEMENT]
    if len(odd) == 1:
        k = odd[0]
        return (f'but "{names[k]}" lies up to {1e3 * off[k].max():.0f} mm off as seen from the '
                'others: was it another place?')
    i, j = sorted(divmod(int(np.argmax(off)), len(names)))
    return (f'but "{names[i]}" and "{names[j]}" are {1e3 * apart[1][i, j]:.0f} mm '
            f'apart, {1e3 * apart[0][i, j]:.0f} mm on the model: were other places touched?')
