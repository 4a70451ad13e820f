# SPDX-License-Identifier: Apache-2.0
"""The session: points, landmarks, strokes, registrations and verification, without ROS or files."""

from gsdf_registration.session.session import (
    Answer,
    Session,
    Status,
    restart_notice,
)

__all__ = ['Answer', 'Session', 'Status', 'restart_notice']
