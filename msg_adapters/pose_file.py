# SPDX-License-Identifier: Apache-2.0
"""Write the pose of a bone as YAML: a static transform for tf2, or a pose for CRTK."""

from __future__ import annotations

import os
from typing import Any

import yaml

from gsdf_registration.common.rigid import Array, quaternion_from_rotation
from msg_adapters.files import write_atomically


def write_static_transform(path: str | os.PathLike[str], T_tracker_bone: Array, frame_id: str,
                           child_frame_id: str) -> None:
    """
    Write a tf2_msgs/msg/TFMessage for /tf_static.

    Parameters
    ----------
    path : path
    T_tracker_bone : (4, 4) float, m
    frame_id, child_frame_id : str
        Frames of the tracker and of the bone.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    translation, rotation = _components(T_tracker_bone)
    _write(path, {'transforms': [{
        'header': {'stamp': _stamp(), 'frame_id': frame_id}, 'child_frame_id': child_frame_id,
        'transform': {'translation': translation, 'rotation': rotation}}]})


def write_pose(path: str | os.PathLike[str], T_tracker_bone: Array, frame_id: str) -> None:
    """Write a geometry_msgs/msg/PoseStamped, as of CRTK's measured_cp; see the function above."""
    position, orientation = _components(T_tracker_bone)
    _write(path, {'header': {'stamp': _stamp(), 'frame_id': frame_id},
                  'pose': {'position': position, 'orientation': orientation}})


def _components(T: Array) -> tuple[dict[str, float], dict[str, float]]:
    """Return position, m, and unit quaternion."""
    quaternion = quaternion_from_rotation(T[:3, :3]).tolist()
    return dict(zip('xyz', T[:3, 3].tolist())), dict(zip('xyzw', quaternion))


def _stamp() -> dict[str, int]:
    """Return the stamp of a pose that is valid for all times."""
    return {'sec': 0, 'nanosec': 0}


def _write(path: str | os.PathLike[str], message: dict[str, Any]) -> None:
    write_atomically(path, yaml.safe_dump(message, sort_keys=False))
