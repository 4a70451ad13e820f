# SPDX-License-Identifier: Apache-2.0
"""What an operator does, and all that must be held for it; no ROS, no files."""

from gsdf_registration.session.session import Answer, LandmarkPairs, Session, Status

__all__ = ['Answer', 'LandmarkPairs', 'Session', 'Status']
