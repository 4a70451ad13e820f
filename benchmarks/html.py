# SPDX-License-Identifier: Apache-2.0
"""HTML pages of plots; needs plotly."""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go


def document(title: str, plots: Sequence[go.Figure]) -> str:
    """Return a self-contained HTML page with plots."""
    return f'<!DOCTYPE html>\n<meta charset="utf-8">\n<title>{title}</title>\n' + '\n'.join(
        plot.to_html(full_html=False, include_plotlyjs=number == 0)
        for number, plot in enumerate(plots))
