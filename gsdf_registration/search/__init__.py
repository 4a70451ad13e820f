# SPDX-License-Identifier: Apache-2.0
"""Find start poses for the local solver, with or without an initial pose."""

from gsdf_registration.search.consensus import POSE_ERROR, consensus
from gsdf_registration.search.global_search import find_start_poses

__all__ = ['POSE_ERROR', 'consensus', 'find_start_poses']
