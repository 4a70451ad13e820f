# SPDX-License-Identifier: Apache-2.0
"""Poses of a tracked tool or array from a bag, a table or an NDI tracker CSV."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from msg_adapters import ndi, stamps
from msg_adapters.bag import decode_message
from msg_adapters.bag_storage import BagFiles, Topic
from msg_adapters.files import unit_scale
from msg_adapters.motion import ORIENTATION, POSITION, TOLERANCE, TOOL_POSES, tool_pose
from msg_adapters.table import Table, read_table

TABLES = ('.csv', '.txt', '.tsv')


@dataclass(frozen=True)
class ToolPoses:
    """
    Poses of one body as they were recorded.

    T_tracker_body : (n, 4, 4) float64, m; NaN where the source has no valid pose
    stamps : (n,) float64, s, or None if the source has no times
    name : topic, tool or file
    rejected : number of readings without a valid pose, by cause
    notes : sentences on defects of the source that could be read anyway
    """

    T_tracker_body: Array
    stamps: Array | None
    name: str
    rejected: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_tool_poses(path: str | os.PathLike[str], unit: str | None = None, *,
                    tool: str | None = None, topic: str | None = None) -> ToolPoses:
    """
    Read the poses of one tool.

    Parameters
    ----------
    path : path
        A bag; a CSV with the header tx,ty,tz,qx,qy,qz,qw in any order and, if it has times, t, time
        or stamp (s); or an NDI tracker CSV.
    unit : {'mm', 'm'}, optional
        Of the lengths; needed for a CSV.  A bag is in metres by default, as in REP-103; an NDI
        tracker CSV is in millimetres.
    tool : str, optional
        Part of the port label of the tool; needed if an NDI tracker CSV has several tools.
    topic : str, optional
        PoseStamped, PoseWithCovarianceStamped or TransformStamped topic; needed if a bag has
        several.

    Returns
    -------
    ToolPoses

    Raises
    ------
    InputError
        If the file cannot be read or has no poses, or the tool or topic is missing or ambiguous.

    """
    if Path(path).suffix.lower() not in TABLES:
        if tool is not None:
            raise InputError(f'{path} is a bag: --tool does not apply to it, use --topic')
        return _from_bag(path, unit or 'm', topic)
    if ndi.is_ndi(path):
        if topic is not None:
            raise InputError(f'{path} is an NDI tracker CSV: --topic does not apply to it, use '
                             '--tool')
        if unit not in (None, 'mm'):
            raise InputError(f'{path} is an NDI tracker CSV, which is in mm: use --unit mm')
        return _from_ndi(path, tool)
    if tool is not None or topic is not None:
        raise InputError(f'{path} has the poses of one tool: omit --tool and --topic')
    if unit is None:
        raise InputError(f'{path}: the unit of the lengths is missing: choose --unit mm or m')
    return _from_table(path, unit)


def _from_table(path: str | os.PathLike[str], unit: str) -> ToolPoses:
    table = read_table(path, wanted=(*POSITION, *ORIENTATION))
    missing = [name for name in (*POSITION, *ORIENTATION) if name not in table.columns]
    if missing:
        raise InputError(
            f'{path}: poses need the header {",".join((*POSITION, *ORIENTATION))}; missing: '
            f'{", ".join(missing)}')
    if not table.rows:
        raise InputError(f'{path} has no poses')
    positions = table.numbers(*POSITION) * unit_scale(unit)
    T, rejected = to_poses(positions, table.numbers(*ORIENTATION))
    return ToolPoses(T, _times(table), Path(path).name, rejected)


def _times(table: Table) -> Array | None:
    name = table.first_of('t', 'time', 'stamp')
    return None if name is None else table.numbers(name)[:, 0]


def _from_ndi(path: str | os.PathLike[str], wanted: str | None) -> ToolPoses:
    tool = ndi.read_tool(path, wanted)
    if tool.quaternions is None:
        raise InputError(f'{path}: {tool.label} has no orientation (Q0,Qx,Qy,Qz or Rz,Ry,Rx)')
    T, rejected = to_poses(tool.positions, tool.quaternions)
    for cause, count in tool.dropped.items():
        rejected[cause] = rejected.get(cause, 0) + count
    return ToolPoses(T, tool.stamps, tool.label, rejected)


def _from_bag(path: str | os.PathLike[str], unit: str, wanted: str | None) -> ToolPoses:
    bag = BagFiles(path, TOOL_POSES)
    topic = _chosen_topic(bag.path, bag.topics(), wanted)
    times, poses = [], []
    for i, raw in enumerate(bag.messages([topic.name])):
        message = decode_message(bag.path, i, raw)
        stamp = message.header.stamp
        times.append(stamps.to_seconds(stamp.sec, stamp.nanosec))
        poses.append(tool_pose(message, raw.msgtype))
    if not times:
        raise InputError(f'{bag.path} has no messages on {topic.name}')
    rows = np.array(poses)
    T, rejected = to_poses(rows[:, :3] * unit_scale(unit), rows[:, 3:])
    return ToolPoses(T, np.array(times), topic.name, rejected, tuple(bag.notes))


def _chosen_topic(path: Path, topics: list[Topic], wanted: str | None) -> Topic:
    """Return the wanted topic, or the only one with poses."""
    found = [topic for topic in topics
             if topic.msgtype in TOOL_POSES and wanted in (None, topic.name)]
    if len(found) == 1:
        return found[0]
    there = ', '.join(f'{topic.name} ({topic.msgtype})' for topic in topics) or 'no topics'
    if wanted is not None:
        raise InputError(f'{path} has no poses on {wanted}; it has {there}')
    raise InputError(f'{path} has {len(found) or "no"} topics with poses (PoseStamped, '
                     'PoseWithCovarianceStamped or TransformStamped)'
                     + ('; choose one with --topic' if found else '') + f'; it has {there}')


def to_poses(positions: Array, quaternions: Array) -> tuple[Array, dict[str, int]]:
    """Return poses (n, 4, 4), NaN where invalid, and the number of invalid ones by cause."""
    with np.errstate(invalid='ignore', over='ignore'):
        lengths = np.linalg.norm(quaternions, axis=1)
        finite = np.isfinite(positions).all(axis=1) & np.isfinite(lengths)
        unit = np.abs(lengths - 1.0) <= TOLERANCE
    valid = finite & unit
    T = np.full((len(positions), 4, 4), np.nan)
    T[valid] = np.eye(4)
    T[valid, :3, 3] = positions[valid]
    if valid.any():
        T[valid, :3, :3] = Rotation.from_quat(quaternions[valid]).as_matrix()
    return T, {'not_finite': int((~finite).sum()), 'not_unit': int((finite & ~unit).sum())}
