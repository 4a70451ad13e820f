# SPDX-License-Identifier: Apache-2.0
"""Plot the residuals in the order of the points, which reveals drift; needs plotly."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go

from gsdf_registration.common.result import INLIER_WEIGHT, RegistrationResult


def residual_figure(result: RegistrationResult) -> go.Figure:
    """Return the plot, scaled to the inliers; a double click shows all."""
    assert result.residuals_m is not None and result.weights is not None
    known = np.isfinite(result.residuals_m)
    residuals = 1e3 * result.residuals_m
    inlier = known & (result.weights > INLIER_WEIGHT)
    groups = {'inliers': (inlier, {'color': '#0969da', 'size': 4}),
             'outliers (weight 0.5 or less)':
             (known & ~inlier, {'color': '#6e7781', 'size': 5, 'symbol': 'circle-open'})}
    figure = go.Figure([
        go.Scattergl(x=np.flatnonzero(chosen).astype(np.int32), mode='markers', name=name,
                     y=residuals[chosen].astype(np.float32), marker=marker,
                     hovertemplate='point %{x}: %{y:.2f} mm<extra></extra>')
        for name, (chosen, marker) in groups.items()])
    reach = 1.3 * float(np.abs(residuals[inlier]).max()) if inlier.any() else 1.0
    figure.update_layout(
        height=340, margin={'l': 60, 'r': 20, 't': 40, 'b': 50}, plot_bgcolor='#f6f8fa',
        legend={'orientation': 'h', 'x': 0, 'y': 1, 'yanchor': 'bottom', 'itemsizing': 'constant'},
        xaxis={'title': {'text': 'number of the point'}, 'zeroline': False},
        yaxis={'title': {'text': 'residual, mm (outside positive)'}, 'range': [-reach, reach]})
    if result.sigma_m is not None:
        sigma = 1e3 * result.sigma_m
        figure.add_hrect(-sigma, sigma, fillcolor='#0969da', opacity=0.1, line_width=0,
                         annotation_text='± sigma', annotation_position='top left')
    return figure
