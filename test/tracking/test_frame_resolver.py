# SPDX-License-Identifier: Apache-2.0
"""The motion into the session frame, or the reason why it is unknown."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import exp, inverse
from gsdf_registration.common.samples import Rejection
from gsdf_registration.tracking.frame_resolver import FrameResolver
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.pose_buffer import LookupStatus

ARRAY = Config.from_flat({'reference.topic': '/array'})
WORLD = Config.from_flat({'probe.frame_id': 'world'})
A, B = exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]), exp([-0.3, 0.1, 0.2, 0.0, 0.2, 1.0])


def test_points_stay_as_they_are_without_array_and_frame() -> None:
    assert FrameResolver(None).motion('camera', 1.0, Config()) is None


def test_uses_the_inverse_pose_of_the_array() -> None:
    resolver = FrameResolver(None)
    assert resolver.motion('camera', 1.0, ARRAY) is LookupStatus.NOT_YET
    resolver.add_pose(1.0, A, 'camera', ARRAY)
    np.testing.assert_allclose(resolver.motion('camera', 1.0, ARRAY), inverse(A))


def test_combines_tf_and_array() -> None:
    frames = Frames()
    frames.add('camera', 'wand', 0.0, B, fixed=True)
    resolver = FrameResolver(frames)
    resolver.add_pose(1.0, A, 'camera', ARRAY)
    np.testing.assert_allclose(resolver.motion('wand', 1.0, ARRAY), inverse(A) @ B)


@pytest.mark.parametrize(('frames', 'part'), [(None, 'tf2_msgs'), (Frames(), 'not connect')])
def test_names_both_frames_if_nothing_connects_them(frames: Frames | None, part: str) -> None:
    cause, sentence = FrameResolver(frames).failure_reason('camera', '/tip', 0.0, WORLD)
    assert cause is Rejection.WRONG_FRAME
    assert all(name in sentence for name in ('/tip', '"camera"', '"world"', part))


def test_says_why_the_pose_of_the_array_is_missing() -> None:
    resolver = FrameResolver(None)
    cause, sentence = resolver.failure_reason('camera', '/tip', 0.0, ARRAY)
    assert cause is Rejection.NO_REFERENCE and 'in view' in sentence
    assert 'are 3.0 s apart' in resolver.failure_reason('camera', '/tip', -3.0, ARRAY)[1]
    resolver.add_pose(1.0, np.zeros((4, 4)), 'camera', ARRAY)
    assert resolver.failure_reason('camera', '/tip', 0.0, ARRAY)[1].endswith(
        'Rejected array poses: 1; the last is not a rigid motion')
