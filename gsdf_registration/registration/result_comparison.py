# SPDX-License-Identifier: Apache-2.0
"""Compare two results of a registration, as their JSON documents state them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gsdf_registration.common.rigid import Array, angle_between, displacement

ORIGIN = 'origin of the bone frame'


@dataclass(frozen=True)
class Comparison:
    """
    How two results differ.

    remarks : sentences on what makes the comparison doubtful or impossible
    outcomes : the reason of each, `converged` or a refusal
    rotation : float, rad, between the poses; None without two poses of one bone
    displacement_m : dict of str to float, m, between the poses: at the targets, else at the
        landmarks of the settings, else at the origin of the bone frame
    predicted_tre_m : dict of str to (float, float), m, of each; None: not known
    settings : dict of str to (value, value), those that differ
    """

    remarks: tuple[str, ...]
    outcomes: tuple[str, str]
    rotation: float | None
    displacement_m: dict[str, float]
    predicted_tre_m: dict[str, tuple[float | None, float | None]]
    settings: dict[str, tuple[Any, Any]]


def compare(a: Mapping[str, Any], b: Mapping[str, Any]) -> Comparison:
    """
    Return how two JSON documents of a registration differ; SI units.

    The displacement of a place is the TRE of one pose if the other one were true.
    """
    remarks = []
    models = [each['inputs']['model_sha256'] for each in (a, b)]
    frames = [each['bone_pose']['frame_id'] for each in (a, b) if each['bone_pose']]
    comparable = models[0] == models[1]
    if not comparable:
        remarks.append('the results are of different models, so their poses cannot be compared')
    elif None in models:
        remarks.append('the hash of the model is not known, so the bones may differ')
    if len(set(frames)) > 1:
        comparable = False
        remarks.append(f'the poses are in different frames, {frames[0]} and {frames[1]}, so they '
                       'cannot be compared')
    if a['inputs']['points_sha256'] != b['inputs']['points_sha256']:
        remarks.append('the results are of different points')
    remarks += [f'{name} has no pose: {each["message"]}' for name, each in (('A', a), ('B', b))
                if each['T_tracker_bone'] is None]
    poses = [np.array(each['T_tracker_bone'], np.float64) for each in (a, b)
             if each['T_tracker_bone'] is not None]
    rotation, moved = None, dict[str, float]()
    if comparable and len(poses) == 2:
        rotation = float(angle_between(poses[0][:3, :3], poses[1][:3, :3]))
        names, places = _places(a['config'], b['config'])
        moved = dict(zip(names, displacement(poses[0], poses[1], places).tolist()))
    tre = [each['predicted_tre_m'] for each in (a, b)]
    return Comparison(
        tuple(remarks), (a['reason'], b['reason']), rotation, moved,
        {name: (tre[0].get(name), tre[1].get(name)) for name in {**tre[0], **tre[1]}},
        changed_settings(a['config'], b['config']))


def changed_settings(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the settings of two registrations that differ, by dotted name."""
    return {name: (a.get(name), b.get(name)) for name in {**a, **b} if a.get(name) != b.get(name)}


def _places(*settings: Mapping[str, Any]) -> tuple[list[str], Array]:
    """Return names and positions (n, 3), m: targets, else landmarks, else the origin."""
    for section in ('targets', 'landmarks'):
        found = dict[str, Any]()
        for each in settings:
            positions = np.reshape(each.get(f'{section}.positions') or [], (-1, 3))
            found |= dict(zip(each.get(f'{section}.names') or [], positions))
        if found:
            return list(found), np.array(list(found.values()))
    return [ORIGIN], np.zeros((1, 3))
