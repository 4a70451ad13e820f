# SPDX-License-Identifier: Apache-2.0
"""A registration that is updated while points arrive."""

from gsdf_registration.live.live_registration import LivePose, LiveRegistration, LiveStatus

__all__ = ['LivePose', 'LiveRegistration', 'LiveStatus']
