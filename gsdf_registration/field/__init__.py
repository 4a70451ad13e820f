# SPDX-License-Identifier: Apache-2.0
"""The gradient-SDF of a bone: build, sample, save and load."""

from gsdf_registration.field.build import build_field
from gsdf_registration.field.cache import cached_field
from gsdf_registration.field.field import Field
from gsdf_registration.field.store import load_field, save_field

__all__ = ['Field', 'build_field', 'cached_field', 'load_field', 'save_field']
