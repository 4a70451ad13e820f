# SPDX-License-Identifier: Apache-2.0
"""
Read the landmarks that the command line names, and find the axes of model and tracker.

A landmark file with both positions of each landmark is a CSV or the ground truth of a recording.
Point lists of 3D Slicer have one position each: one list for the model, one for the touched points.
Their points are brought to the axes of the model and of the tracker, LPS or RAS.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.landmarks import Landmarks
    from gsdf_registration.field import Field
    from msg_adapters.slicer import PointList

FAR = 0.010         # m, RMS distance from the bone of landmarks that may have the wrong axes
BETTER = 0.3        # share of that distance with the other axes, if the axes are wrong
FEWEST = 3          # landmarks that show whether the axes are right


class Axes(NamedTuple):
    """Anatomical axes of the coordinates of model and tracker, 'lps' or 'ras'."""

    model: str
    tracker: str


def axes_of(args: argparse.Namespace, config: Config) -> Axes:
    """
    Return the axes that the options or the file of the model state; LPS by default.

    Raises
    ------
    InputError
        If the model states other axes than ``--model-axes``, or does not exist.

    """
    from gsdf_registration.field.model import find_model
    from msg_adapters.slicer import model_axes
    stated = model_axes(find_model(config.model.path))
    if stated and args.model_axes not in (None, stated):
        raise InputError(f'{config.model.path} states that its axes are {stated.upper()}: omit '
                         f'--model-axes {args.model_axes}')
    model = args.model_axes or stated or 'lps'
    return Axes(model, args.tracker_axes or model)


def read_landmark_files(args: argparse.Namespace, config: Config, unit: str) -> Landmarks | None:
    """
    Return the landmarks of ``--landmarks``, None without the option.

    Parameters
    ----------
    args : of the command line
    config : with the unit of the model
    unit : 'mm' or 'm', of the touched positions in a CSV

    Raises
    ------
    InputError
        If a file cannot be read, or the lists do not name the same landmarks.

    """
    from msg_adapters.slicer import is_point_list
    paths = args.landmarks or []
    if not paths:
        return None
    if any(is_point_list(path) for path in paths):
        return _paired(paths, axes_of(args, config))
    if len(paths) > 1:
        raise InputError('--landmarks is given several times: only point lists of Slicer come in '
                         'two files, one for the model and one for the touched points')
    return _read_pairs(paths[0], config.model.unit, unit)


def check_axes(landmarks: Landmarks | None, field: Field, axes: Axes) -> None:
    """Raise `InputError` if the landmarks lie on the bone only with the other axes."""
    from gsdf_registration.common.rigid import rms
    from msg_adapters.slicer import AXES, converted
    if landmarks is None or len(landmarks) < FEWEST:
        return
    other = next(name for name in AXES if name != axes.model)
    here, there = (rms(field.sample(positions)[0]) for positions in (
        landmarks.model, converted(landmarks.model, axes.model, other)))
    if here > FAR and there < BETTER * here:
        raise InputError(
            f'the landmarks lie {1e3 * here:.0f} mm off the model, but on it if model and '
            f'landmarks have different axes, LPS and RAS: use --model-axes {other}')


def _read_pairs(path: str, model_unit: str, unit: str) -> Landmarks:
    """Return the landmarks of a CSV in these units, or of a truth YAML."""
    from gsdf_registration.common.landmarks import Landmarks
    from msg_adapters.points import read_landmarks
    from msg_adapters.truth import read_truth
    if Path(path).suffix.lower() not in ('.yaml', '.yml'):
        return read_landmarks(path, model_unit, unit)
    truth = read_truth(path)
    if not truth.landmark_names:
        raise InputError(f'{path} has no landmarks')
    return Landmarks.of(truth.landmarks_model, truth.landmarks_tracker, names=truth.landmark_names)


def _paired(paths: list[str], axes: Axes) -> Landmarks:
    """Return the landmarks of two point lists, matched by their labels."""
    from gsdf_registration.common.landmarks import Landmarks
    from msg_adapters.slicer import read_point_lists
    if len(paths) == 1:
        lists = read_point_lists(paths[0], axes.model)
        if len(lists) != 2:
            raise InputError(
                f'{paths[0]} has only the positions on the model: add a list of the touched points '
                'with the same labels, --landmarks MODEL.mrk.json --landmarks TOUCHED.mrk.json')
        model, touched = lists[0], read_point_lists(paths[0], axes.tracker)[1]
    elif len(paths) == 2:
        model, touched = _one_list(paths[0], axes.model), _one_list(paths[1], axes.tracker)
    else:
        raise InputError('--landmarks needs two point lists, first the one on the model, then the '
                         f'one with the touched points, not {len(paths)}')
    named = ' and '.join(dict.fromkeys(paths))
    for points in (model, touched):
        repeated = next((label for label in points.labels if points.labels.count(label) > 1), None)
        if repeated is not None:
            raise InputError(f'{named}: the landmark {repeated!r} is not unique')
    common = [label for label in model.labels if label in touched.labels]
    alone = sorted(set(model.labels) ^ set(touched.labels))
    if alone:
        raise InputError(f'{named}: {", ".join(alone)} is in one list only; give the points of a '
                         'landmark the same label in both')
    return Landmarks.of(model.positions[[model.labels.index(label) for label in common]],
                        touched.positions[[touched.labels.index(label) for label in common]],
                        names=common)


def _one_list(path: str, axes: str) -> PointList:
    """Return the points of a file: a point list of Slicer with one list."""
    from msg_adapters.slicer import is_point_list, only_list
    if not is_point_list(path):
        raise InputError(f'{path} is not a point list of Slicer (.mrk.json or .fcsv), but the '
                         'other file is; give two point lists, or one CSV with both positions')
    return only_list(path, axes)
