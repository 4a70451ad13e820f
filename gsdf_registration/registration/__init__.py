# SPDX-License-Identifier: Apache-2.0
"""The registration pipeline: search, solve, select a pose, assess it, accept or reject it."""

from gsdf_registration.registration.pipeline import register

__all__ = ['register']
