# SPDX-License-Identifier: Apache-2.0
"""Check before a long run that plots can be drawn."""

from __future__ import annotations

from gsdf_registration.common.result import InputError


def require_plotly() -> None:
    """Raise an `InputError` that says what to install if plotly is missing."""
    try:
        import plotly.graph_objects  # noqa: F401
    except ImportError:
        raise InputError('plots need plotly, which is not installed: '
                         "pip install 'gsdf_registration[bench]'") from None
