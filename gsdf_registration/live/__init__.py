# SPDX-License-Identifier: Apache-2.0
"""A pose that is kept up while points come in."""

from gsdf_registration.live.live import Job, LivePose, LiveRegistration, LiveStatus

__all__ = ['Job', 'LivePose', 'LiveRegistration', 'LiveStatus']
