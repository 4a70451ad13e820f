# SPDX-License-Identifier: Apache-2.0
"""Estimate the pose from a first guess near it."""

from gsdf_registration.solver.local_solver import (
    Estimates,
    Solution,
    allow_for_model_error,
    refine,
    solve,
)
from gsdf_registration.solver.model_error import ModelError
from gsdf_registration.solver.neighbourhood import Neighbourhood, nearest_neighbours

__all__ = [
    'Estimates', 'ModelError', 'Neighbourhood', 'Solution', 'allow_for_model_error',
    'nearest_neighbours', 'refine', 'solve'
]
