# SPDX-License-Identifier: Apache-2.0
"""Read and write the ground truth of a recording, a YAML file beside it with the same name."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, is_rigid
from msg_adapters.bag_storage import storage_name
from msg_adapters.files import METRES, parse_yaml, read_text, write_atomically

SCHEMA = 'gsdf-truth/1'


@dataclass(frozen=True, eq=False)
class Truth:
    """
    The true pose of the bone in a recording.

    model : str, path of the bone model relative to the YAML file
    model_unit : 'mm' or 'm', unit of length of the model
    frame_id : str, frame of the recorded points
    T_tracker_bone : (4, 4) float
    landmark_names : of str, in the order in which the landmarks were touched
    landmarks_model : (k, 3) float, m, bone frame
    landmarks_tracker : (k, 3) float, m, touched points, frame of the recorded points
    about : dict, how the recording was made (noise, seed, command, ...), plain YAML values
    """

    model: str
    model_unit: str
    frame_id: str
    T_tracker_bone: Array
    landmark_names: tuple[str, ...] = ()
    landmarks_model: Array = field(default_factory=lambda: np.zeros((0, 3)))
    landmarks_tracker: Array = field(default_factory=lambda: np.zeros((0, 3)))
    about: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Convert lists to arrays; raise `ValueError` if their shapes are invalid."""
        set_ = object.__setattr__
        set_(self, 'landmark_names', tuple(self.landmark_names))
        set_(self, 'T_tracker_bone', np.asarray(self.T_tracker_bone, dtype=np.float64))
        for name in ('landmarks_model', 'landmarks_tracker'):
            set_(self, name, np.asarray(getattr(self, name), dtype=np.float64).reshape(-1, 3))
        if not is_rigid(self.T_tracker_bone):
            raise ValueError('T_tracker_bone is not a rigid motion')
        if not len(self.landmark_names) == len(self.landmarks_model) == len(self.landmarks_tracker):
            raise ValueError('the number of landmarks is not consistent')
        if self.model_unit not in METRES:
            raise ValueError(f'model_unit {self.model_unit!r} is neither mm nor m')


def truth_path(bag: str | os.PathLike[str]) -> Path:
    """Return the path of the ground truth of a bag (directory or storage file)."""
    bag = Path(bag)
    return bag.parent / f'{storage_name(bag) or bag.name}.yaml'


def write_truth(path: str | os.PathLike[str], truth: Truth) -> None:
    """Write ``truth`` as YAML, replacing an existing file atomically."""
    landmarks = [{'name': name, 'model': model.tolist(), 'tracker': tracker.tolist()}
                 for name, model, tracker in zip(truth.landmark_names, truth.landmarks_model,
                                                 truth.landmarks_tracker)]
    document = {'schema': SCHEMA, 'model': truth.model, 'model_unit': truth.model_unit,
                'frame_id': truth.frame_id, 'T_tracker_bone': truth.T_tracker_bone.tolist(),
                'landmarks': landmarks, 'about': truth.about}
    write_atomically(path,
                     yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100))


def read_truth(path: str | os.PathLike[str]) -> Truth:
    """
    Read a file that `write_truth` wrote.

    Raises
    ------
    InputError
        If the file is missing, is not valid YAML, or has another content.

    """
    try:
        document = parse_yaml(read_text(path))
    except yaml.YAMLError:
        raise InputError(f'{path} is not valid YAML') from None
    if not isinstance(document, dict) or document.get('schema') != SCHEMA:
        raise InputError(f'{path} is not a ground truth of schema {SCHEMA}')
    try:
        landmarks = document['landmarks']
        return Truth(document['model'], document['model_unit'], document['frame_id'],
                     document['T_tracker_bone'], tuple(mark['name'] for mark in landmarks),
                     np.array([mark['model'] for mark in landmarks]),
                     np.array([mark['tracker'] for mark in landmarks]),
                     document['about'])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f'{path} is a damaged ground truth: {_describe(error)}') from None


def _describe(error: Exception) -> str:
    """Return the defect of the document as text."""
    return f'{error.args[0]} is missing' if isinstance(error, KeyError) else str(error)
