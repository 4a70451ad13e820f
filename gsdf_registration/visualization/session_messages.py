# SPDX-License-Identifier: Apache-2.0
"""
Which messages about the pose of a session are sent when: pose, result, guidance and scene.

The node sends them on its topics, a replay writes them to a recording. `docs/pose_lifetime.md`
lists what is valid after which event.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import NextTouch, Refusal
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.visualization.marker_scene import MarkerScene
from msg_adapters import results, ros
from msg_adapters.marker_cdr import DELETE_ALL, Marker, to_bytes
from msg_adapters.messages import Time
from msg_adapters.session_result import SessionStatus, current_msg, header_of

# positions, residuals, weights and strokes of a cloud
NO_POINTS = (np.zeros((0, 3)), np.zeros(0), np.zeros(0), np.zeros(0))


class Outlet(Protocol):
    """Where the messages go."""

    def now(self) -> Time:
        """Return the time of the messages."""

    def show_pose(self, status: SessionStatus) -> None:
        """Send the accepted registration, or withdraw it if there is none any more."""

    def send(self, topic: str, message: Any) -> None:
        """Send a message on a topic of the node; of markers, its bytes in CDR."""


class ShownSession(Protocol):
    """What is used of a session."""

    @property
    def config(self) -> Config:
        """Settings in use."""

    def status(self) -> SessionStatus:
        """Return a snapshot."""

    def registered_points(self) -> Points | None:
        """Return the points of the accepted registration."""


class Estimate(Protocol):
    """A pose and its points: of a registration or of a full assessment."""

    @property
    def T_tracker_bone(self) -> Array | None:
        """Pose (4, 4); None: there is none."""

    @property
    def covariance(self) -> Array | None:
        """Its covariance (6, 6)."""

    @property
    def residuals_m(self) -> Array | None:
        """Of each point (n,), m."""

    @property
    def weights(self) -> Array | None:
        """Of each point (n,)."""


class SessionMessages:
    """
    Sends what has changed; may be used by any thread.

    Parameters
    ----------
    outlet : Outlet
    bone_frame : str
        Frame of the bone model.

    """

    def __init__(self, outlet: Outlet, bone_frame: str) -> None:
        self._outlet, self._bone_frame = outlet, bone_frame
        self._scene = MarkerScene()
        self._drawing = threading.Lock()
        self._field: Field | None = None
        self._shown: tuple[Any, ...] = ()       # session and registration sent last
        self._guidance: tuple[Any, ...] = ()    # sent last
        self._shows_estimate = False    # whether the scene shows something beside the registration
        self._has_points = False        # whether the last cloud sent has points

    def set_bone(self, field: Field | None) -> None:
        """Use this bone, and send everything at the next `show_registration`."""
        self._field, self._shown = field, ()

    def show_registration(self, session: ShownSession) -> None:
        """
        Send the accepted registration and its points; if there is none, withdraw it.

        Nothing is sent if neither has changed.
        """
        status = session.status()
        shown = (status.session_id, status.registration_id, status.pose_result is None,
                 status.withdrawn)
        if shown == self._shown:
            return
        before, self._shown = self._shown, shown
        self._outlet.show_pose(status)
        if results.available() and (status.pose_result is not None or before[2:] != shown[2:]):
            self._outlet.send('result', current_msg(status, self._bone_frame, self._outlet.now()))
        self._guide()
        self._draw_registration(session)

    def show_assessment(self, session: ShownSession, estimate: Estimate, points: Points,
                        refusal: Refusal | None) -> None:
        """
        Show an estimate while points come in, or without its pose the accepted registration.

        Parameters
        ----------
        session, estimate, points
            The estimate has a pose if it may be shown.
        refusal : Refusal, optional
            For which it would be rejected; it says where to touch next.

        """
        next_touches, advice = ((), '') if refusal is None else (
            refusal.next_touches, refusal.advice)
        self._guide(next_touches, advice)
        if estimate.T_tracker_bone is not None:
            self._draw(session.config, estimate, points, next_touches)
            self._shows_estimate = True
        elif self._shows_estimate or next_touches:
            self._draw_registration(session, next_touches)
            self._shows_estimate = bool(next_touches)

    def withdraw(self, session: ShownSession, reason: Withdrawal, sentence: str) -> None:
        """Send that there is no pose, and an empty scene; the session keeps its pose."""
        self._shown, status = (), session.status()
        if results.available() and status.pose_result is not None:
            self._outlet.send('result', results.withdrawal_msg(
                reason, sentence, header_of(status, self._bone_frame, self._outlet.now())))
        self._guide()
        with self._drawing:
            self._send_scene([Marker('', 0, action=DELETE_ALL)], *NO_POINTS)

    def _guide(self, next_touches: Sequence[NextTouch] = (), advice: str = '') -> None:
        """Send where to touch next, if that has changed."""
        guidance = results.guidance_content(next_touches, advice)
        if results.available() and guidance != self._guidance:
            self._guidance = guidance
            self._outlet.send('guidance', results.guidance_msg(
                next_touches, advice, self._bone_frame, self._outlet.now()))

    def _draw_registration(self, session: ShownSession,
                           next_touches: Sequence[NextTouch] = ()) -> None:
        """Show where to touch next and, if there is an accepted registration, its points."""
        self._shows_estimate = False
        self._draw(session.config, session.status().pose_result, session.registered_points(),
                   next_touches)

    def _draw(self, config: Config, estimate: Estimate | None, points: Points | None,
              next_touches: Sequence[NextTouch]) -> None:
        """Show the bone with its error and the points on it, or without a pose the bone alone."""
        with self._drawing:
            if self._field is None:
                return
            if (estimate is None or points is None or estimate.T_tracker_bone is None
                    or estimate.covariance is None or estimate.residuals_m is None
                    or estimate.weights is None):
                self._send_scene(self._scene.bone(self._field, next_touches), *NO_POINTS)
                return
            field = self._field.for_tip(config.probe.tip_radius)
            contacts = field.contacts_at(estimate.T_tracker_bone, points.positions)
            self._send_scene(
                self._scene.pose(field, config.limits, estimate.T_tracker_bone,
                                 estimate.covariance, contacts, estimate.residuals_m,
                                 estimate.weights, next_touches),
                contacts, estimate.residuals_m, estimate.weights, points.strokes)

    def _send_scene(self, shown: Sequence[Marker], contacts: Array, residuals: Array,
                    weights: Array, strokes: NDArray[Any]) -> None:
        """Send the complete scene, so a late joiner sees what the others see."""
        self._outlet.send('markers', to_bytes(shown, self._bone_frame))
        if len(contacts) or self._has_points:
            self._outlet.send('points', ros.cloud_msg(contacts, residuals, weights, strokes,
                                                      self._bone_frame, self._outlet.now()))
            self._has_points = len(contacts) > 0
