# SPDX-License-Identifier: Apache-2.0
"""The status message: one sentence for the operator, key-value pairs for programs."""

from __future__ import annotations

from gsdf_registration.session.status import Status
from gsdf_registration.session.status_values import (
    LiveState,
    level_name,
    shown_message,
    status_values,
)
from msg_adapters.messages import DiagnosticStatus
from msg_adapters.ros import diagnostic_status


def status_message(status: Status, live: LiveState, name: str) -> DiagnosticStatus:
    """Return ``status`` as a message from the node ``name``. Values are SI units or plain text."""
    return diagnostic_status(name, getattr(DiagnosticStatus, level_name(status)),
                             shown_message(status), status_values(status, live))
