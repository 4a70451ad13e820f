# SPDX-License-Identifier: Apache-2.0
"""
What the node publishes about the bone: poses, results, points, and where to touch next.

`docs/pose_lifetime.md` lists what stays published after which event.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from rclpy.lifecycle import LifecycleNode

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import NextTouch
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Points
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.field import Field
from gsdf_registration.live import LivePose
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.node.centre_frame import CentreFrame
from gsdf_registration.node.publishers import PosePublishers
from gsdf_registration.node.results import ResultPublishers
from gsdf_registration.node.scene import ScenePublisher
from gsdf_registration.session import Session


class Outputs:
    """Publishes the registered and the live pose with their scene; may be used by any thread."""

    def __init__(self, node: LifecycleNode, config: Config) -> None:
        self._poses = PosePublishers(node, config)
        self._results = ResultPublishers(node, config)
        self._scene = ScenePublisher(node, config.model.frame_id)
        self._centre = CentreFrame(node, config.model.frame_id)
        self._drawing = threading.Lock()
        self._field: Field | None = None
        self._shows_live = False    # whether the scene shows the live registration
        self._shown: tuple[Any, ...] = ()       # session and registration published last

    @property
    def problem(self) -> str:
        """What is wrong with the transform on /tf, and what to do; empty: nothing."""
        return self._poses.problem

    def set_tf_rate(self, rate: float) -> None:
        """Repeat the transform on /tf at this rate, Hz; 0: never."""
        self._poses.set_rate(rate)

    def show_bone(self, field: Field | None, session: Session) -> None:
        """Show this bone from now on, with the registered pose if there is one."""
        self._field, self._shown = field, ()
        if field is not None:
            self._centre.show(field)
        self.show_registration(session)

    def show_registration(self, session: Session) -> None:
        """
        Publish the accepted registration and its points; if there is none, withdraw it.

        Nothing is published if neither has changed.
        """
        status = session.status()
        shown = (status.session_id, status.registration_id, status.pose_result is None,
                 status.withdrawn)
        if shown == self._shown:
            return
        before, self._shown = self._shown, shown
        if status.pose_result is None:
            self._poses.withdraw()
        else:
            self._poses.publish(status.pose_result, status.pose_frame_id, status.pose_stamp)
        if status.pose_result is not None or before[2:] != shown[2:]:
            self._results.publish(status)
        self._results.guide()
        self._draw_registration(session)

    def withdraw(self, session: Session) -> None:
        """Publish that there is no pose and an empty scene; the session keeps its pose."""
        self._shown = ()
        self._poses.withdraw()
        self._results.withdraw(session.status(), Withdrawal.DEACTIVATED,
                               'the node is deactivated: activate it to use the pose again')
        self._results.guide()
        with self._drawing:
            self._scene.clear()

    def show_live_pose(self, pose: LivePose, frame_id: str) -> None:
        """Publish the live pose."""
        self._poses.publish_live(pose, frame_id)

    def show_assessment(self, found: FullAssessment, session: Session) -> None:
        """Show the live registration if its pose is trusted, else the accepted registration."""
        reason = found.rejection_reason
        self._results.guide(found.next_touches, '' if reason is None else reason.advice)
        if found.T_tracker_bone is not None and found.covariance is not None:
            with self._drawing:
                if self._field is not None:
                    self._show_pose(self._field, session.config, found.T_tracker_bone,
                                    found.covariance, found.points, found.residuals_m,
                                    found.weights, found.next_touches)
            self._shows_live = True
        elif self._shows_live or found.next_touches:
            self._draw_registration(session, found.next_touches)
            self._shows_live = bool(found.next_touches)

    def destroy(self) -> None:
        """Destroy all publishers."""
        self._field = None
        self._poses.destroy()
        self._results.destroy()
        self._scene.destroy()
        self._centre.destroy()

    def _draw_registration(self, session: Session,
                           next_touches: Sequence[NextTouch] = ()) -> None:
        """Show where to touch next and, if there is an accepted registration, its points."""
        self._shows_live = False
        result, points = session.status().pose_result, session.registered_points()
        with self._drawing:
            if self._field is None:
                return
            if (result is None or points is None or result.T_tracker_bone is None
                    or result.covariance is None or result.residuals_m is None
                    or result.weights is None):
                self._scene.show_bone(self._field, next_touches)
                return
            self._show_pose(self._field, session.config, result.T_tracker_bone, result.covariance,
                            points, result.residuals_m, result.weights, next_touches)

    def _show_pose(self, field: Field, config: Config, T_tracker_bone: Array, covariance: Array,
                   points: Points, residuals: Array, weights: Array,
                   next_touches: Sequence[NextTouch]) -> None:
        self._scene.show_pose(field.for_tip(config.probe.tip_radius), config.limits,
                              T_tracker_bone, covariance, points.positions, residuals, weights,
                              points.strokes, next_touches)
