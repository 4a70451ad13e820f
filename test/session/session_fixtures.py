# SPDX-License-Identifier: Apache-2.0
"""A small asymmetric bone, and the actions of an operator on a session."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, exp, transform
from gsdf_registration.common.samples import Rejection, Sample
from gsdf_registration.field import Field, build_field
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.session import Session

RATE = 80.0
T_TRACKER_BONE = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])
LANDMARKS = np.array([[0.03, 0.0, 0.0], [0.0, 0.045, 0.0], [0.0, 0.0, 0.07]])
CONFIG = Config.from_flat({'landmarks.names': ['x', 'y', 'z'],
                           'landmarks.positions': LANDMARKS.ravel().tolist()})


def bone(width: float = 0.03) -> Field:
    """Return an ellipsoid with a bump, so that no two of its sides are alike."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices = ball.vertices * [width, 0.045, 0.07]
    vertices *= 1.0 + 0.15 * np.exp(-20.0 * (
        (ball.vertices - [0.6, 0.6, 0.5])**2).sum(axis=1, keepdims=True))
    return build_field(make_bone(vertices, ball.faces), 0.002)


def sample(stamp: float, position: Any, frame_id: str = 'cam', topic: str = '/probe/tip',
           **more: Any) -> Sample:
    x, y, z = map(float, position)
    return Sample(stamp, (x, y, z), frame_id, topic, **more)


def surface_points(field: Field, count: int = 300) -> Array:
    """Return points of the surface in the tracker frame, each far from the one before."""
    rows = np.linspace(0, len(field.surface_points) - 1, count).astype(int)
    return transform(T_TRACKER_BONE, field.surface_points[rows].astype(np.float64))


def surface_point(field: Field, row: int) -> Array:
    return transform(T_TRACKER_BONE, field.surface_points[row].astype(np.float64))


def send(session: Session, points: Array, start: float = 0.0,
         **more: Any) -> list[Rejection | None]:
    """Send points slowly enough for the speed check."""
    return [session.add(sample(start + i, point, **more)) for i, point in enumerate(points)]


def hold(session: Session, point: Array, start: float, **more: Any) -> float:
    """Send the same point for a while; return the time after it."""
    for i in range(50):
        session.add(sample(start + i / RATE, point, **more))
    return start + 51 / RATE


def hold_noisy(session: Session, point: Array, start: float, seconds: float = 1.0) -> float:
    """Send a stationary tip with tracker noise; return the time after it."""
    noise = np.random.default_rng(int(start)).normal(0.0, 1e-4, (round(seconds * RATE), 3))
    for i, reading in enumerate(point + noise):
        session.add(sample(start + i / RATE, reading))
    return start + len(noise) / RATE


def with_landmarks(field: Field | None, config: Config = CONFIG) -> Session:
    """Return a session with all landmarks captured."""
    session = Session(config, field)
    time = 0.0
    for point in transform(T_TRACKER_BONE, LANDMARKS):
        time = hold(session, point, time) + 1.0
        assert session.capture_landmark().success
    return session


def registered(field: Field) -> Session:
    session = with_landmarks(field)
    send(session, surface_points(field), start=100.0)
    assert session.register().success
    return session
