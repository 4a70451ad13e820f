# SPDX-License-Identifier: Apache-2.0
"""Estimate the pose from an initial pose near it."""

from gsdf_registration.solver.local_solver import allow_for_model_error, refine, solve
from gsdf_registration.solver.mixture import patch_likelihood
from gsdf_registration.solver.model_error import ModelError
from gsdf_registration.solver.neighbourhood import Neighbourhood, nearest_neighbours
from gsdf_registration.solver.solution import Estimates, Solution
from gsdf_registration.solver.touches import NO_TOUCHES, PARAMETERS, before, touch_deviations

__all__ = [
    'NO_TOUCHES', 'PARAMETERS', 'Estimates', 'ModelError', 'Neighbourhood', 'Solution',
    'allow_for_model_error', 'before', 'nearest_neighbours', 'patch_likelihood', 'refine', 'solve',
    'touch_deviations'
]
