# SPDX-License-Identifier: Apache-2.0
"""The status message: one sentence for the operator, key-value pairs for programs."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from gsdf_registration.live import LiveStatus
from gsdf_registration.session.status import Status
from gsdf_registration.session.status_values import pose_kept, status_values
from msg_adapters.ros import diagnostic_status

LEVELS = {'no_model': DiagnosticStatus.ERROR, 'refused': DiagnosticStatus.WARN}     # else OK


def status_message(status: Status, live: LiveStatus, name: str) -> DiagnosticStatus:
    """Return ``status`` as a message from the node ``name``. Values are SI units or plain text."""
    values = status_values(status, live)
    message = status.message + (pose_kept(status) if status.state == 'refused' else '')
    level = LEVELS.get(status.state, DiagnosticStatus.OK)
    full = status.full and status.state in ('collecting', 'idle', 'ready')
    if level == DiagnosticStatus.OK and (full or status.warning):
        level = DiagnosticStatus.WARN
    return diagnostic_status(name, level, message, values)


def with_stamp(status: DiagnosticStatus, stamp: Time) -> DiagnosticStatus:
    """Return a copy with the value ``stamp``, seconds and nanoseconds: it has no header."""
    value = KeyValue(key='stamp', value=f'{stamp.sec}.{stamp.nanosec:09d}')
    return DiagnosticStatus(level=status.level, name=status.name, message=status.message,
                            hardware_id=status.hardware_id, values=[value, *status.values])
