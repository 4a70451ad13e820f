# SPDX-License-Identifier: Apache-2.0
"""The message of ``~/result`` from the status of a session; see `results`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.common.withdrawal import Withdrawal
from msg_adapters import results
from msg_adapters.messages import Time

NOT_REGISTERED = 'the bone is not registered yet'


class SessionStatus(Protocol):
    """What is used of the status of a session."""

    @property
    def pose_result(self) -> RegistrationResult | None:
        """The accepted registration."""

    @property
    def withdrawn(self) -> Any:
        """The withdrawal of the last pose: reason, sentence, session, number, frame; or None."""

    @property
    def session_id(self) -> str:
        """Name of the session."""

    @property
    def registration_id(self) -> int:
        """Number of the accepted registration."""

    @property
    def pose_frame_id(self) -> str:
        """Frame of the pose."""

    @property
    def frame_id(self) -> str | None:
        """Frame of the points."""

    @property
    def pose_stamp(self) -> float:
        """Time of the newest point that the pose was found from, s."""

    @property
    def rejected(self) -> Mapping[str, int]:
        """Samples by cause."""

    @property
    def stroke_reports(self) -> Sequence[results.Stroke]:
        """Strokes at the accepted registration."""

    @property
    def captured(self) -> Sequence[results.Landmark]:
        """Captured landmarks."""


def header_of(status: SessionStatus, bone_frame: str, stamp: Time) -> results.ResultHeader:
    """Return the header of a message on the registration in force."""
    return results.ResultHeader(stamp, status.pose_frame_id or status.frame_id or '', bone_frame,
                                status.session_id, status.registration_id, status.pose_stamp)


def registration_msg(result: RegistrationResult, status: SessionStatus,
                     header: results.ResultHeader) -> Any:
    """Return the message of a registration, accepted or rejected, in a session."""
    return results.result_msg(result, header, rejected={**status.rejected, **result.left_out},
                              strokes=status.stroke_reports if result.success else (),
                              landmarks=status.captured)


def current_msg(status: SessionStatus, bone_frame: str, stamp: Time) -> Any:
    """Return the message of the accepted registration, or of why there is none."""
    header = header_of(status, bone_frame, stamp)
    if status.pose_result is not None:
        return registration_msg(status.pose_result, status, header)
    if status.withdrawn is None:
        return results.withdrawal_msg(Withdrawal.NOT_REGISTERED, NOT_REGISTERED, header)
    reason, sentence, session_id, number, frame_id = status.withdrawn
    return results.withdrawal_msg(reason, sentence, results.ResultHeader(
        stamp, frame_id, bone_frame, session_id, number))
