# SPDX-License-Identifier: Apache-2.0
"""Import libraries of optional extras only when they are needed."""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

from gsdf_registration.common.result import InputError


def require(module: str, extra: str, what: str) -> None:
    """Raise `InputError` if a module of an extra is not installed; arguments as of `needed`."""
    if importlib.util.find_spec(module) is None:
        raise _missing(module, extra, what)


def needed(module: str, extra: str, what: str) -> Any:
    """
    Return a module of an extra.

    Parameters
    ----------
    module : name of the module
    extra : name of the extra of this package that installs it
    what : what it is needed for, as in ".vtk files"

    Raises
    ------
    InputError
        If it is not installed.

    """
    try:
        return importlib.import_module(module)
    except ImportError:
        raise _missing(module, extra, what) from None


def _missing(module: str, extra: str, what: str) -> InputError:
    return InputError(f'{what} need {module.partition(".")[0]}, which is not installed: '
                      f"pip install 'gsdf_registration[{extra}]'")
