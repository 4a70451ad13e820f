# SPDX-License-Identifier: Apache-2.0
"""
Guidance: the next touch that improves the pose most.

Each point adds J^T J / sigma^2 to the information on the pose. The best patch of the bone is the
one after which the predicted TRE is smallest (active sensing with the matrix of Ma and Ellis 2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import NextTouch
from gsdf_registration.common.rigid import Array
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import Confidence
from gsdf_registration.registration.landmarks import named_points

REACH = 0.05            # m from the touched area: what the incision may still give access to
EXTENDED_REACH = 0.1    # m: the same, if no place nearer distinguishes the poses
DISTINCT = 0.001        # m off the bone at the other pose: enough to distinguish two poses
PATCH = 0.008           # m, radius of a patch
PATCH_POINTS = 48       # surface points that represent a patch, at most
PATCH_STEP = 6          # every sixth surface point is the centre of a patch, about 5 mm apart
STROKE = 60             # points that a short stroke over a patch adds
SPACING = 0.02          # m between the patches returned
MAX_COMPARED = 600      # patches that are compared; of more, a subset spread over all of them
FACING = -0.3           # cosine to the mean normal: a probe does not reach patches facing away more


class _Patches(NamedTuple):
    """
    Overlapping patches of a bone.

    centres, normals : (p, 3) float64, m, bone frame
    information : (p, 6, 6), mean of J^T J over each patch, J = [x x n, n] about the origin
    """

    centres: Array
    normals: Array
    information: Array


def next_touches(confidence: Confidence, field: Field, touched: Array, targets: Array,
                 config: Config, count: int = 3) -> list[NextTouch]:
    """Return `best_touches` in the region of the settings ``guidance.*``."""
    reachable = _reachable(touched, config)
    return best_touches(confidence, field, reachable, targets, count, config.guidance.reach)


def _reachable(touched: Array, config: Config) -> Array:
    """Return the landmarks and targets of ``guidance.near``, or else the ``touched`` points."""
    names, points = config.guidance.near, named_points(config)
    return np.array([points[name] for name in names]) if names else touched


def best_touches(confidence: Confidence, field: Field, reachable: Array, targets: Array,
                 count: int = 3, reach: float = REACH) -> list[NextTouch]:
    """
    Return the patches after whose touch the predicted TRE is smallest, best first.

    Parameters
    ----------
    confidence : Confidence
        In the current pose.
    field : Field
        Of the bone; its patches are cached.
    reachable : (n, 3) float, m, bone frame
        Touched points, or points of an exposed area.
    targets : (m, 3) float, m, bone frame
        Where the error matters.
    count : int
        Patches to return, at least 20 mm apart.
    reach : float, m
        Maximum distance of a patch from the reachable points. Patches that face away from them are
        not considered.

    """
    patches = _patches(field)
    near = _within(patches, field, reachable, reach)
    if not len(near):
        return []
    # an error of the model does not average out over the points of a stroke
    variance = confidence.sigma**2 / STROKE + confidence.model_sd**2
    gained = _shifted(patches.information[near], confidence.centroid) / variance
    # neither does that of the tip, which is the same at every touch
    lasting = confidence.total_covariance - confidence.motion_covariance
    after = np.linalg.inv(np.linalg.inv(confidence.motion_covariance) + gained) + lasting
    metric = _metric(targets - confidence.centroid)
    error = np.sqrt(np.einsum('pij,ij->p', after, metric))
    current = float(np.sqrt((confidence.total_covariance * metric).sum()))
    chosen: list[int] = []
    for k in np.argsort(error, kind='stable'):
        place = patches.centres[near[k]]
        if all(np.linalg.norm(place - patches.centres[near[j]]) > SPACING for j in chosen):
            chosen.append(k)
        if len(chosen) == count:
            break
    return [NextTouch(patches.centres[near[k]], patches.normals[near[k]], float(error[k]), current)
            for k in chosen]


def distinguishing_touch(poses: Sequence[Array], field: Field, reachable: Array,
                         reach: float = REACH) -> NextTouch:
    """
    Return the place that best distinguishes the first pose from all others.

    Parameters
    ----------
    poses : sequence of (4, 4) float, T_bone_tracker
        Two or more.
    field : Field
    reachable, reach
        As in `best_touches`; if no place there distinguishes the poses, the place may be up to
        100 mm away.

    """
    patches, bone = _patches(field), field.for_tip(0.0)     # the places are on the bone itself
    T_tracker_bone = rigid.inverse(poses[0])
    for within in (reach, EXTENDED_REACH):
        near = _within(patches, field, reachable, within)
        places = patches.centres[near]
        off = np.min([np.abs(bone.sample(rigid.transform(T @ T_tracker_bone, places))[0])
                      for T in poses[1:]], axis=0)
        if off.max(initial=0.0) > DISTINCT:
            break
    best = near[np.argmax(off)]
    return NextTouch(patches.centres[best], patches.normals[best])


@lru_cache(maxsize=2)
def _patches(field: Field) -> _Patches:
    surface = field.surface_points.astype(np.float64)
    normals = field.surface_normals.astype(np.float64)
    centres = np.arange(0, len(surface), PATCH_STEP)    # the surface points are spatially sorted
    members = cKDTree(surface).query(surface[centres], PATCH_POINTS,
                                     distance_upper_bound=PATCH)[1]
    inside = members < len(surface)
    J = np.concatenate([np.cross(surface, normals), normals], axis=1)
    J_patch = J[np.where(inside, members, 0)] * inside[..., None]
    information = J_patch.swapaxes(1, 2) @ J_patch / inside.sum(axis=1)[:, None, None]
    return _Patches(surface[centres], normals[centres], information)


def _within(patches: _Patches, field: Field, reachable: Array, reach: float) -> NDArray[np.int64]:
    """Return the indices of patches near ``reachable`` (n, 3) that do not face away from it."""
    outward = field.sample(reachable)[1].mean(axis=0)
    # points all around the bone have no mean normal; then every patch is reachable
    facing = patches.normals @ outward > FACING * np.linalg.norm(outward) - 1e-9
    distance = cKDTree(reachable).query(patches.centres, distance_upper_bound=reach)[0]
    near = np.flatnonzero((distance < reach) & facing)
    return near[::-(-len(near) // MAX_COMPARED) or 1]


def _shifted(information: Array, centroid: Array) -> Array:
    """Return information (p, 6, 6) on motions about the origin as that about ``centroid``, m."""
    shift = np.eye(6)
    shift[3:, :3] = rigid.skew(centroid)
    return np.asarray(shift.T @ information @ shift)


def _metric(arms: Array) -> Array:
    """Return the mean of B^T B (6, 6), B = [-(q - m)^, I], over ``arms`` q - m (n, 3)."""
    second, mean = arms.T @ arms / len(arms), arms.mean(axis=0)
    skew = rigid.skew(mean)
    return np.block([[np.trace(second) * np.eye(3) - second, skew], [-skew, np.eye(3)]])
