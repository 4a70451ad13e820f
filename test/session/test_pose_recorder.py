# SPDX-License-Identifier: Apache-2.0
"""Test the recorder of poses."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.rigid import exp, inverse, quaternion_from_rotation
from gsdf_registration.common.tool_pose import ToolPose
from gsdf_registration.session import pose_recorder
from gsdf_registration.session.pose_recorder import PoseRecorder
from gsdf_registration.simulation.moving import Sway


def pose(T: np.ndarray) -> ToolPose:
    x, y, z, qx, qy, qz, qw = (*T[:3, 3].tolist(), *quaternion_from_rotation(T[:3, :3]).tolist())
    return x, y, z, qx, qy, qz, qw


def recorded(motion: Sway, stamps: np.ndarray) -> PoseRecorder:
    recorder = PoseRecorder()
    for stamp in stamps.tolist():
        recorder.add(stamp, pose(motion.pose(stamp)))
    return recorder


def test_returns_the_poses_and_how_far_they_turn() -> None:
    recorder = PoseRecorder()
    for angle in (0.0, 0.2, -0.3, 0.1):
        recorder.add(angle, pose(exp([0.0, angle, 0.0, 1.0, 2.0, angle])))
    assert len(recorder) == 4 and recorder.stamps.tolist() == [0.0, 0.2, -0.3, 0.1]
    assert recorder.angle == pytest.approx(0.3)
    assert np.allclose(recorder.matrices()[2], exp([0.0, -0.3, 0.0, 1.0, 2.0, -0.3]))


def test_of_too_many_poses_every_other_one_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pose_recorder, 'MAX_POSES', 8)
    recorder = recorded(Sway(), np.arange(100.0))
    assert 4 <= len(recorder) < 8
    steps = np.diff(recorder.stamps)
    assert recorder.stamps[0] == 0.0 and (steps == steps[0]).all()


def test_gives_the_poses_in_the_frame_of_another_body() -> None:
    array, T_array_tool = Sway(exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])), exp([0.3, 0, 0, 0, 0, 0.1])
    tool = PoseRecorder()
    for stamp in np.arange(0.05, 2.0, 0.03).tolist():
        tool.add(stamp, pose(array.pose(stamp) @ T_array_tool))
    stamps, T = tool.seen_from(recorded(array, np.arange(0.0, 1.0, 0.01)), 0.5)
    assert len(T) == len(stamps) > 20 and stamps.max() <= 0.99      # later there is no array
    assert np.allclose(T, T_array_tool, atol=1e-6)
    assert np.allclose(inverse(array.pose(0.05)) @ tool.matrices()[0], T[0], atol=1e-6)
    few = recorded(array, np.array([0.0, 0.9, 1.0]))
    assert (tool.seen_from(few, 0.5)[0] > 0.9).all()        # the gap before is too long
    assert len(tool.seen_from(PoseRecorder(), 0.5)[0]) == 0
