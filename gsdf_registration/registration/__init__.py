# SPDX-License-Identifier: Apache-2.0
"""The pipeline: search, solve, select, assess, accept or reject."""

from gsdf_registration.registration.pipeline import register

__all__ = ['register']
