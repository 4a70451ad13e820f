# SPDX-License-Identifier: Apache-2.0
"""
Find a bone under a tracked probe: partial-to-full registration on gradient-SDFs.

The names in ``__all__`` are the public interface. Each is imported on first access, so that
importing the package is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = '0.1.0'

_MODULE_OF = {
    'Bone': 'mesh.bone', 'make_bone': 'mesh.bone',
    'Config': 'common.config',
    'Field': 'field', 'build_field': 'field', 'cached_field': 'field',
    'load_field': 'field', 'save_field': 'field',
    'load_model': 'field.model',
    'pose_from_landmarks': 'registration.landmarks',
    'register': 'registration',
    'InputError': 'common.result', 'Reason': 'common.result', 'Refusal': 'common.result',
    'RegistrationResult': 'common.result',
    'Session': 'session',
}
__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> Any:
    """Import a public name from its module (PEP 562)."""
    if name not in _MODULE_OF:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(import_module(f'{__name__}.{_MODULE_OF[name]}'), name)
