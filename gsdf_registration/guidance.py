# SPDX-License-Identifier: Apache-2.0
"""
Where to touch next: the patch of bone that would teach most, and how to say where it is.

Each point touched adds J^T J / sigma^2 to the information on the pose; the best patch is the one
after which the predicted TRE is least (active sensing with the matrix of Ma and Ellis 2004).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from gsdf_registration import rigid
from gsdf_registration.confidence import Confidence, motion_at
from gsdf_registration.field import Field
from gsdf_registration.rigid import Array

REACH = 0.1         # m from what was touched: what a wound may still give access to
PATCH = 0.008       # m, radius of a patch
STROKE = 60         # points that a short stroke over a patch gives
APART = 0.02        # m between patches offered
NAMED = 0.03        # m: a landmark this near gives the place its name


@dataclass(frozen=True)
class Touch:
    """
    A patch of bone worth touching.

    position, normal : (3,) float, m, bone frame
    predicted_tre : float, m, RMS at the targets once a short stroke was drawn over it
    """

    position: Array
    normal: Array
    predicted_tre: float


def where_to_touch(confidence: Confidence, field: Field, reachable: Array, targets: Array,
                   count: int = 3) -> list[Touch]:
    """
    Return the patches after which the predicted TRE is least, best first.

    Parameters
    ----------
    confidence : of the present pose
    field : of the bone
    reachable : (n, 3) float, m, bone frame: what was touched, or points of an exposed region;
        patches within 100 mm of them are considered
    targets : (m, 3) float, m, bone frame: where the error matters
    count : how many to return, 20 mm apart at least

    """
    surface = field.surface_points.astype(np.float64)
    normals = field.surface_normals.astype(np.float64)
    near = np.flatnonzero(cKDTree(reachable).query(surface, distance_upper_bound=REACH)[0] < REACH)
    centres = near[::max(1, len(near) // 400)]
    if not len(centres):
        return []
    # what one point says of the pose, and the mean of it over each patch
    J = np.concatenate([np.cross(surface - confidence.centre, normals), normals], axis=1)
    patches = cKDTree(surface).query(surface[centres], k=12, distance_upper_bound=PATCH)[1]
    inside = patches < len(surface)
    J_patch = J[np.where(inside, patches, 0)] * inside[..., None]
    gained = STROKE / confidence.sigma**2 * np.einsum(
        'pki,pkj->pij', J_patch, J_patch) / inside.sum(axis=1)[:, None, None]
    after = np.linalg.inv(np.linalg.inv(confidence.motion_covariance) + gained)
    B = motion_at(targets - confidence.centre).reshape(-1, 6)
    error = np.sqrt(np.einsum('pij,ij->p', after, B.T @ B / len(targets)))
    chosen: list[int] = []
    for k in np.argsort(error, kind='stable'):
        place = surface[centres[k]]
        if all(np.linalg.norm(place - surface[centres[j]]) > APART for j in chosen):
            chosen.append(k)
        if len(chosen) == count:
            break
    return [Touch(surface[centres[k]], normals[centres[k]], float(error[k])) for k in chosen]


def where_they_differ(poses: Sequence[Array], field: Field, touched: Array) -> Array:
    """
    Return the place (3,), m, bone frame, whose touch best tells the first pose from all others.

    Parameters
    ----------
    poses : (4, 4) float each, T_bone_tracker, two or more
    field : of the bone
    touched : (n, 3) float, m, bone frame at the first pose; places within 100 mm are considered

    """
    surface = field.surface_points.astype(np.float64)
    near = cKDTree(touched).query(surface, distance_upper_bound=REACH)[0] < REACH
    places = surface[near][::5]
    in_tracker = rigid.transform(rigid.inverse(poses[0]), places)
    off = [np.abs(field.sample(rigid.transform(T, in_tracker))[0]) for T in poses[1:]]
    return np.asarray(places[np.argmax(np.min(off, axis=0))])


def in_words(place: Array, touched: Array, names: Mapping[str, Array]) -> str:
    """Say where a ``place`` (3,), m, bone frame, is: by a named point, or from ``touched``."""
    nearest = min(names, key=lambda name: float(np.linalg.norm(names[name] - place)), default=None)
    if nearest is not None and np.linalg.norm(names[nearest] - place) < NAMED:
        return f'near {nearest}'
    middle = touched.mean(axis=0)
    axis = int(np.argmax(np.abs(place - middle)))
    return (f'{1e3 * np.linalg.norm(place - middle):.0f} mm from there, towards '
            f'{"+-"[int(place[axis] < middle[axis])]}{"xyz"[axis]} of the model, at '
            '({:.0f}, {:.0f}, {:.0f}) mm'.format(*1e3 * place))
