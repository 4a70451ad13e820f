# SPDX-License-Identifier: Apache-2.0
"""The messages of the typed services."""

from __future__ import annotations

from typing import Any

from gsdf_registration.common.result import RegistrationResult
from gsdf_registration.session import Session
from gsdf_registration.session.status import Status
from msg_adapters import ros
from msg_adapters.session_result import header_of, registration_msg


def attempt_message(result: RegistrationResult, session: Session, now: float) -> Any:
    """Return the message of one attempt at time ``now``, s, accepted or rejected."""
    status = session.status()
    header = header_of(status, session.config.bone_frame, ros.seconds_to_stamp(now))
    if not result.success:
        header = header._replace(registration_id=0, pose_stamp=0.0)
    return registration_msg(result, status, header)


def pose_identity(status: Status) -> tuple[str, int]:
    """Return session and number of the registration in force, or of the one withdrawn last."""
    if status.pose_result is None and status.withdrawn is not None:
        return status.withdrawn.session_id, status.withdrawn.registration_id
    return status.session_id, status.registration_id
