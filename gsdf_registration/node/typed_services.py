# SPDX-License-Identifier: Apache-2.0
"""The services of gsdf_registration_msgs, whose answers carry numbers and the registration's id."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple, Protocol

from gsdf_registration.common.result import InputError, Reason, RegistrationResult
from gsdf_registration.common.rigid import Array
from gsdf_registration.node.results import attempt_message, pose_identity
from gsdf_registration.session import Session
from gsdf_registration.session.landmark_capture import Answer
from gsdf_registration.session.verification import Verification
from msg_adapters import results, ros

Handler = Callable[[Any], Awaitable[Answer]]


class TypedService(NamedTuple):
    """A service: type, name, what it does, and what writes its response beside the sentence."""

    kind: Any
    name: str
    handler: Handler
    fill: Callable[[Any, Answer], None]


class TypedNode(Protocol):
    """The node, as far as the typed services use it."""

    session: Session

    def now(self) -> float:
        """Return the time of the node's clock, s."""


class Operations(Protocol):
    """The operations of the std_srvs services."""

    async def drop(self, drop: Callable[[Session], Answer]) -> Answer:
        """Drop a stroke; if the pose used it, register again without it or withdraw the pose."""

    async def register_from(self, T_tracker_bone: Array | None) -> Answer:
        """Register from this initial pose (4, 4); the detail of the answer is the result."""

    async def verify(self, request: Any) -> Answer:
        """Verify; the detail of the answer is the `Verification`."""

    async def capture_landmark(self, request: Any) -> Answer:
        """Capture a landmark; the detail of the answer is its name and its `StationaryTip`."""


def typed_services(node: TypedNode, operations: Operations) -> list[TypedService]:
    """Return the services; only with gsdf_registration_msgs, see `results.available`."""
    typed = _TypedServices(node, operations)
    kinds = results.service_types()
    return [TypedService(kinds.Register, 'typed/register', typed.register, typed.fill_register),
            TypedService(kinds.Verify, 'typed/verify', operations.verify, typed.fill_verify),
            TypedService(kinds.CaptureLandmark, 'typed/capture_landmark',
                         operations.capture_landmark, typed.fill_landmark),
            TypedService(kinds.DropStroke, 'drop_stroke', typed.drop_stroke, typed.fill_identity)]


class _TypedServices:
    """Handlers of the requests, and what writes the responses."""

    def __init__(self, node: TypedNode, operations: Operations) -> None:
        self._node, self._operations = node, operations

    async def register(self, request: Any) -> Answer:
        """Register the collected points, from the initial pose of the request if it is used."""
        T_tracker_bone = None
        if request.use_initial_pose:
            _, T_tracker_bone, frame_id = ros.pose_from(request.initial_pose)
            points_frame = self._node.session.status().frame_id
            if frame_id and points_frame and frame_id != points_frame:
                raise InputError(f'the initial pose is in frame "{frame_id}", but the points are '
                                 f'in "{points_frame}"')
        return await self._operations.register_from(T_tracker_bone)

    async def drop_stroke(self, request: Any) -> Answer:
        """Drop the stroke of the request."""
        return await self._operations.drop(lambda session: session.drop_stroke(request.stroke))

    def fill_register(self, response: Any, answer: Answer) -> None:
        """Write the result of the attempt, also if it is rejected."""
        session, result = self._node.session, answer.detail
        if result is None:
            result = RegistrationResult.refused(Reason.BAD_INPUT, answer.message)
        response.result = attempt_message(result, session, self._node.now())

    def fill_verify(self, response: Any, answer: Answer) -> None:
        """Write the measured distances."""
        session, measured = self._node.session, answer.detail
        self.fill_identity(response, answer)
        response.limit = session.config.limits.verification
        response.distance = response.moved = results.NAN
        if isinstance(measured, Verification):
            response.distance, response.checkpoint = measured.distance_m, measured.checkpoint
            response.moved = results.NAN if measured.moved_m is None else measured.moved_m

    def fill_landmark(self, response: Any, answer: Answer) -> None:
        """Write the captured landmark, and which ones remain."""
        status = self._node.session.status()
        response.session_id = status.session_id
        response.remaining = list(status.remaining_landmarks)
        response.spread = results.NAN
        if answer.detail is not None:
            response.name, tip = answer.detail
            # the place of the tip on the tool may follow later
            known = tip.tool is None or self._node.session.config.probe.tip
            response.position = ros.point_msg(tip.position if known else 3 * [results.NAN],
                                              status.frame_id or '',
                                              ros.seconds_to_stamp(tip.stamp))
            response.spread, response.samples = tip.spread_rms, tip.samples

    def fill_identity(self, response: Any, answer: Answer) -> None:
        """Write which registration the answer is about."""
        response.session_id, response.registration_id = pose_identity(self._node.session.status())
