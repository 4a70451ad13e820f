# SPDX-License-Identifier: Apache-2.0
"""Transforms between any two connected frames, at any time for which all are known."""

from __future__ import annotations

import numpy as np

from gsdf_registration.common.rigid import Array, exp, inverse
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.pose_buffer import LookupStatus

GAP = 0.5
RNG = np.random.default_rng(0)
A, B, C, D = (exp(RNG.uniform(-1.0, 1.0, 6)) for _ in range(4))


def tree() -> Frames:
    """
    Return world - robot - camera, world - table - probe; the camera moves, the others do not.
    """
    frames = Frames()
    frames.add('world', 'robot', 0.0, A, fixed=True)
    frames.add('world', 'table', 0.0, C, fixed=True)
    frames.add('table', 'probe', 0.0, D, fixed=True)
    for stamp, T in ((1.0, B), (1.1, B @ exp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))):
        frames.add('robot', 'camera', stamp, T)
    return frames


def camera(ratio: float) -> Array:
    return B @ exp([0.0, 0.0, 0.1 * ratio, 0.0, 0.0, 0.0])


def test_composes_transforms_up_and_down_the_tree() -> None:
    frames = tree()
    T_world_camera = A @ camera(0.3)
    np.testing.assert_allclose(frames.at('world', 'camera', 1.03, GAP), T_world_camera, atol=1e-12)
    np.testing.assert_allclose(frames.at('camera', 'world', 1.03, GAP), inverse(T_world_camera),
                               atol=1e-12)
    np.testing.assert_allclose(frames.at('camera', 'probe', 1.03, GAP),
                               inverse(T_world_camera) @ C @ D, atol=1e-12)
    np.testing.assert_array_equal(frames.at('camera', 'camera', 5.0, GAP), np.eye(4))


def test_needs_only_the_frames_on_the_path() -> None:
    frames = tree()
    np.testing.assert_allclose(frames.at('probe', 'table', 77.0, GAP), inverse(D), atol=1e-12)
    assert frames.at('probe', 'robot', 77.0, GAP) is not LookupStatus.NOT_YET
    assert frames.at('probe', 'camera', 1.2, GAP) is LookupStatus.NOT_YET
    assert frames.at('probe', 'camera', 0.9, GAP) is LookupStatus.NEVER


def test_unconnected_frames_may_be_connected_later() -> None:
    frames = tree()
    assert not frames.connected('camera', 'elsewhere')
    assert frames.at('camera', 'elsewhere', 1.05, GAP) is LookupStatus.NOT_YET
    frames.add('probe', 'elsewhere', 0.0, A, fixed=True)
    assert frames.connected('camera', 'elsewhere')
    assert isinstance(frames.at('camera', 'elsewhere', 1.05, GAP), np.ndarray)


def test_a_new_parent_replaces_the_former_one() -> None:
    frames = tree()
    frames.add('table', 'camera', 2.0, D)
    np.testing.assert_allclose(frames.at('table', 'camera', 2.0, GAP), D)
    assert frames.at('robot', 'camera', 1.05, GAP) is LookupStatus.NEVER


def test_ignores_cycles_and_invalid_transforms() -> None:
    frames = tree()
    frames.add('probe', 'probe', 0.0, A, fixed=True)
    frames.add('table', 'probe', 0.0, np.full((4, 4), np.nan), fixed=True)
    frames.add('robot', 'camera', 1.2, np.zeros((4, 4)))
    np.testing.assert_allclose(frames.at('table', 'probe', 1.05, GAP), D)
    assert frames.at('robot', 'camera', 1.15, GAP) is LookupStatus.NOT_YET
    frames.add('probe', 'world', 0.0, A, fixed=True)
    frames.at('camera', 'probe', 1.05, GAP)


def test_static_transforms_survive_a_clock_that_goes_back() -> None:
    frames = tree()
    frames.rewind(-100.0)
    np.testing.assert_allclose(frames.at('world', 'probe', -99.0, GAP), C @ D)
    assert frames.at('robot', 'camera', 1.05, GAP) is LookupStatus.NOT_YET
