# SPDX-License-Identifier: Apache-2.0
"""A bone like a potato, and an operator who touches it."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, exp, transform
from gsdf_registration.common.samples import Rejection
from gsdf_registration.field import Field, build_field
from gsdf_registration.mesh.bone import make_bone
from gsdf_registration.session import Session

RATE = 80.0
T_TRACKER_BONE = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])
LANDMARKS = np.array([[0.03, 0.0, 0.0], [0.0, 0.045, 0.0], [0.0, 0.0, 0.07]])
CONFIG = Config.from_flat({'landmarks.names': ['x', 'y', 'z'],
                           'landmarks.positions': LANDMARKS.ravel().tolist()})


def bone(width: float = 0.03) -> Field:
    """Return a bone like a potato: no two of its sides are alike."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices = ball.vertices * [width, 0.045, 0.07]
    vertices *= 1.0 + 0.15 * np.exp(-20.0 * (
        (ball.vertices - [0.6, 0.6, 0.5])**2).sum(axis=1, keepdims=True))
    return build_field(make_bone(vertices, ball.faces), 0.002)


def touched(field: Field, count: int = 300) -> Array:
    """Return points of the surface, far from one another from one to the next."""
    rows = np.linspace(0, len(field.surface_points) - 1, count).astype(int)
    return transform(T_TRACKER_BONE, field.surface_points[rows].astype(np.float64))


def send(session: Session,
         points: Array,
         start: float = 0.0,
         **more: Any) -> list[Rejection | None]:
    """Send points slowly enough for the speed gate."""
    return [session.add_point(start + i, point, 'cam', **more) for i, point in enumerate(points)]


def hold(session: Session, point: Array, start: float, **more: Any) -> float:
    for i in range(50):
        session.add_point(start + i / RATE, point, 'cam', **more)
    return start + 51 / RATE


def landmarked(field: Field | None, config: Config = CONFIG) -> Session:
    """Return a session with all landmarks captured."""
    session = Session(config, field)
    time = 0.0
    for point in transform(T_TRACKER_BONE, LANDMARKS):
        time = hold(session, point, time) + 1.0
        assert session.capture_landmark().success
    return session


def registered(field: Field) -> Session:
    session = landmarked(field)
    send(session, touched(field), start=100.0)
    assert session.register().success
    return session


def rest(session: Session, point: Array, start: float, seconds: float = 1.0) -> float:
    """Hold the tip as a tracker sees it, no two readings alike; return the time after it."""
    readings = point + np.random.default_rng(int(start)).normal(0.0, 1e-4,
                                                                (round(seconds * RATE), 3))
    for i, reading in enumerate(readings):
        session.add_point(start + i / RATE, reading, 'cam')
    return start + len(readings) / RATE


def on_surface(field: Field, row: int) -> Array:
    return transform(T_TRACKER_BONE, field.surface_points[row].astype(np.float64))
