# SPDX-License-Identifier: Apache-2.0
"""
Where to touch next: the patch of bone that would teach most, and how to say where it is.

Each point touched adds J^T J / sigma^2 to the information on the pose; the best patch is the one
after which the predicted TRE is least (active sensing with the matrix of Ma and Ellis 2004).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Touch
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence

REACH = 0.05        # m from what was touched: what a wound may still give access to
FARTHER = 0.1       # m: the same, where nothing nearer would help
TELLING = 0.001     # m off the bone at another pose: enough to tell them apart
PATCH = 0.008       # m, radius of a patch
INSIDE = 48         # surface points of a patch that are looked at
STROKE = 60         # points that a short stroke over a patch gives
APART = 0.02        # m between patches offered
COMPARED = 600      # patches compared at most; of more, so many spread over all
FACING = -0.3       # the cosine to the approach beyond which a tip cannot reach round
NAMED = 0.06        # m: a landmark this near gives the place its name
AT = 0.005          # m: nearer than this is there
ALIGNED = 0.87      # cosine of 30 degrees: that way, in words
UPRIGHT = 0.4       # sine of the angle at which the bone's middle is no more aside, but beneath


class _Patches(NamedTuple):
    """
    A bone cut in patches that overlap.

    centres, normals : (p, 3) float64, m, bone frame
    information : (p, 6, 6), mean of J^T J over each, J = [x x n, n] about the origin
    """

    centres: Array
    normals: Array
    information: Array


def region(touched: Array, config: Config) -> tuple[Array, float]:
    """
    Return points (n, 3), m, bone frame, and how far round them, m, places are proposed.

    By the settings ``guidance.*``: round what was ``touched`` (n, 3), or instead round the
    landmarks and targets that ``guidance.near`` names.
    """
    names, points = config.guidance.near, named_points(config)
    return np.array([points[name] for name in names]) if names else touched, config.guidance.reach


def advise(confidence: Confidence, field: Field, touched: Array, targets: Array, config: Config,
           count: int = 3) -> list[Touch]:
    """Return `where_to_touch` in the `region` that the settings speak of."""
    reachable, reach = region(touched, config)
    return where_to_touch(confidence, field, reachable, targets, count, reach)


def where_to_touch(confidence: Confidence, field: Field, reachable: Array, targets: Array,
                   count: int = 3, reach: float = REACH) -> list[Touch]:
    """
    Return the patches after which the predicted TRE is least, best first.

    Parameters
    ----------
    confidence : of the present pose
    field : of the bone; its patches are kept for the next call
    reachable : (n, 3) float, m, bone frame: what was touched, or points of an exposed region
    targets : (m, 3) float, m, bone frame: where the error matters
    count : how many to return, 20 mm apart at least
    reach : float, m; patches this near to what is reachable are considered, but for those that face
        away from it

    """
    patches = _patches(field)
    near = _within(patches, field, reachable, reach)
    if not len(near):
        return []
    # the error of the model is one over a stroke, however many its points
    variance = confidence.sigma**2 / STROKE + confidence.model_sd**2
    gained = _about(confidence.centre, patches.information[near]) / variance
    after = np.linalg.inv(np.linalg.inv(confidence.motion_covariance) + gained)
    metric = _metric(targets - confidence.centre)
    error = np.sqrt(np.einsum('pij,ij->p', after, metric))
    present = float(np.sqrt((confidence.motion_covariance * metric).sum()))
    chosen: list[int] = []
    for k in np.argsort(error, kind='stable'):
        place = patches.centres[near[k]]
        if all(np.linalg.norm(place - patches.centres[near[j]]) > APART for j in chosen):
            chosen.append(k)
        if len(chosen) == count:
            break
    return [Touch(patches.centres[near[k]], patches.normals[near[k]], float(error[k]), present)
            for k in chosen]


def where_they_differ(poses: Sequence[Array], field: Field, reachable: Array,
                      reach: float = REACH) -> Touch:
    """
    Return the place whose touch best tells the first pose from all others.

    Parameters
    ----------
    poses : (4, 4) float each, T_bone_tracker, two or more
    field : of the bone
    reachable, reach : as in `where_to_touch`; where no place there tells them apart, one up to 100
        mm away is proposed

    """
    patches = _patches(field)
    T_tracker_bone = rigid.inverse(poses[0])
    for within in (reach, FARTHER):
        near = _within(patches, field, reachable, within)
        places = patches.centres[near]
        off = np.min([np.abs(field.sample(rigid.transform(T @ T_tracker_bone, places))[0])
                      for T in poses[1:]], axis=0)
        if off.max(initial=0.0) > TELLING:
            break
    best = near[np.argmax(off)]
    return Touch(patches.centres[best], patches.normals[best])


@lru_cache(maxsize=2)
def _patches(field: Field) -> _Patches:
    """Return the patches of a bone, some 5 mm apart."""
    surface = field.surface_points.astype(np.float64)
    normals = field.surface_normals.astype(np.float64)
    own = np.arange(0, len(surface), 6)     # they lie in the order of their places
    members = cKDTree(surface).query(surface[own], INSIDE, distance_upper_bound=PATCH)[1]
    inside = members < len(surface)
    J = np.concatenate([np.cross(surface, normals), normals], axis=1)
    J_patch = J[np.where(inside, members, 0)] * inside[..., None]
    information = J_patch.swapaxes(1, 2) @ J_patch / inside.sum(axis=1)[:, None, None]
    return _Patches(surface[own], normals[own], information)


def _within(patches: _Patches, field: Field, reachable: Array, reach: float) -> NDArray[np.int64]:
    """Return which patches are near to ``reachable`` (n, 3) and do not face away from it."""
    toward = field.sample(reachable)[1].mean(axis=0)
    # what was touched from all round has no other side
    facing = patches.normals @ toward > FACING * np.linalg.norm(toward) - 1e-9
    gap = cKDTree(reachable).query(patches.centres, distance_upper_bound=reach)[0]
    near = np.flatnonzero((gap < reach) & facing)
    return near[::-(-len(near) // COMPARED) or 1]


def _about(centre: Array, information: Array) -> Array:
    """Return information (p, 6, 6) on motions about the origin as that about ``centre`` (3,), m."""
    shift = np.eye(6)
    shift[3:, :3] = rigid.skew(centre)
    return np.asarray(shift.T @ information @ shift)


def _metric(arms: Array) -> Array:
    """Return the mean of B^T B (6, 6), B = [-(q - m)^, I], over ``arms`` q - m (n, 3)."""
    second, mean = arms.T @ arms / len(arms), arms.mean(axis=0)
    skew = rigid.skew(mean)
    return np.block([[np.trace(second) * np.eye(3) - second, skew], [-skew, np.eye(3)]])


def named_points(config: Config) -> dict[str, Array]:
    """Return the named landmarks and targets, (3,), m, bone frame, to speak of the bone by."""
    positions = np.reshape(config.landmarks.positions + config.targets.positions, (-1, 3))
    return dict(zip(config.landmarks.names + config.targets.names, positions))


def in_words(place: Array, touched: Array, names: Mapping[str, Array], field: Field) -> str:
    """
    Say where a place on the bone is: from the nearest named point, else from what was touched.

    Parameters
    ----------
    place : (3,) float, m, bone frame
    touched : (n, 3) float, m, bone frame
    names : points of the bone to speak of it by, (3,), m, bone frame
    field : of the bone

    """
    nearest = min(names, key=lambda name: float(np.linalg.norm(names[name] - place)), default=None)
    if nearest is not None and np.linalg.norm(names[nearest] - place) < NAMED:
        away, origin = place - names[nearest], f"'{nearest}'"
    else:
        nearest, away, origin = None, place - touched.mean(axis=0), 'the middle of what was touched'
    if np.linalg.norm(away) < AT:
        return f'at {origin}'
    direction = '' if nearest is None else _by_names(away, nearest, names)
    if direction:
        return f'{1e3 * np.linalg.norm(away):.0f} mm from {origin} {direction}'
    return _by_clock(away, origin, touched, field)


def _by_names(away: Array, origin: str, names: Mapping[str, Array]) -> str:
    """Return the direction ``away`` (3,) from a named point by the others; empty if none is so."""
    best, direction = ALIGNED, ''
    for name in names.keys() - {origin}:
        arm = np.asarray(names[name] - names[origin])
        cosine = float(arm @ away) / max(float(np.linalg.norm(arm) * np.linalg.norm(away)), 1e-12)
        if abs(cosine) > best:
            best = abs(cosine)
            direction = f"{'towards' if cosine > 0.0 else 'away from'} '{name}'"
    return direction


def _by_clock(away: Array, origin: str, touched: Array, field: Field) -> str:
    """Say what is ``away`` (3,) from ``origin`` by a clock laid on what was touched (n, 3)."""
    above = field.sample(touched)[1].mean(axis=0)
    above /= max(float(np.linalg.norm(above)), 1e-12)
    arm = _patches(field).centres.mean(axis=0) - touched.mean(axis=0)
    noon, told = arm - (arm @ above) * above, 'the middle of the bone'
    if np.linalg.norm(noon) < UPRIGHT * np.linalg.norm(arm):    # it lies beneath
        axis = int(np.argmin(np.abs(above)))
        noon, told = np.eye(3)[axis] - above[axis] * above, f'+{"xyz"[axis]} of the model'
    noon /= np.linalg.norm(noon)
    up, right, deeper = away @ noon, away @ np.cross(noon, above), -float(away @ above)
    hour = round(6.0 / np.pi * np.arctan2(right, up)) % 12 or 12
    depth = f'{1e3 * abs(deeper):.0f} mm {"deeper" if deeper > 0.0 else "higher"}'
    if np.hypot(up, right) < AT:
        return f'{depth} than {origin}'
    return (f"{1e3 * np.hypot(up, right):.0f} mm from {origin} at {hour} o'clock (12 is towards "
            f'{told})' + (f', {depth}' if abs(deeper) > AT else ''))
