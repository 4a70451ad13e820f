# SPDX-License-Identifier: Apache-2.0
"""What the node says of the bone: poses, the points on it, where to touch next."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from rclpy.lifecycle import LifecycleNode

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Touch
from gsdf_registration.field import Field
from gsdf_registration.live import LivePose
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.node.publishers import PosePublishers
from gsdf_registration.node.scene import ScenePublisher
from gsdf_registration.session import Session


class Outputs:
    """Publishes what is found, of the registration and of the live one; from any thread."""

    def __init__(self, node: LifecycleNode, config: Config) -> None:
        self._poses = PosePublishers(node, config)
        self._scene = ScenePublisher(node, config)
        self._drawing = threading.Lock()
        self._field: Field | None = None
        self._draws_live = False

    def configure(self, config: Config) -> None:
        """Work by these settings from now on."""
        self._poses.configure(config)
        self._scene.configure(config)

    def bone(self, field: Field | None, session: Session) -> None:
        """Show this bone from now on, with the pose that stands, if any."""
        self._field = field
        self.registration(session)

    def registration(self, session: Session) -> None:
        """Publish the last good pose and its points on the bone; if there is none, withdraw it."""
        status = session.status()
        if status.pose_result is None:
            self._poses.forget()
        else:
            self._poses.publish(status.pose_result, status.pose_frame_id)
        self._draw_registered(session)

    def live(self, pose: LivePose, frame_id: str) -> None:
        """Publish the present estimate."""
        self._poses.publish_live(pose, frame_id)

    def survey(self, survey: FullAssessment, session: Session) -> None:
        """Show what the live registration has found if it may be, else what was registered."""
        if survey.trusted:
            self._draw(survey.T_tracker_bone, survey.covariance, survey.points.positions,
                       survey.residuals_m, survey.weights, survey.points.strokes, survey.touches)
            self._draws_live = True
        elif self._draws_live or survey.touches:
            self._draw_registered(session, survey.touches)
            self._draws_live = bool(survey.touches)

    def _draw_registered(self, session: Session, touches: Sequence[Touch] = ()) -> None:
        """Show where to touch the bone and, if there is a last good pose, its points on it."""
        self._draws_live = False
        result, points = session.status().pose_result, session.registered_points()
        if result is None or points is None or result.residuals_m is None:
            with self._drawing:
                if self._field is not None:
                    self._scene.bone(self._field, touches)
            return
        self._draw(result.T_tracker_bone, result.covariance, points.positions, result.residuals_m,
                   result.weights, points.strokes, touches)

    def _draw(self, *what: Any) -> None:
        with self._drawing:
            if self._field is not None:
                self._scene.show(self._field, *what)

    def destroy(self) -> None:
        """Take everything off the air."""
        self._field = None
        self._poses.destroy()
        self._scene.destroy()
