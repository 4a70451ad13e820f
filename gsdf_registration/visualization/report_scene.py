# SPDX-License-Identifier: Apache-2.0
"""Plot the bone and the points in 3D, in millimetres; needs plotly."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from gsdf_registration.common.result import INLIER_WEIGHT, RegistrationResult, WeakestDirection
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.field import Field
from gsdf_registration.registration.confidence import error_bound
from gsdf_registration.visualization.decimation import decimate

BONE, GREY = '#d8d3c8', '#6e7781'
SIGNED = 'RdYlBu_r'     # yellow: on the surface
HEAT = [[0, '#fff3b0'], [0.5, '#fb8d3c'], [1, '#99000d']]
MAX_POINTS = 20_000     # more would only make the file larger
MAX_FACES = 30_000
HEIGHT = 620            # pixels


def bone_scene(result: RegistrationResult, field: Field, points: Array) -> go.Figure:
    """
    Return the plot of the points on the bone, in the bone frame.

    Parameters
    ----------
    result : RegistrationResult
        With a pose.
    field : Field
        For the tip of the probe; points are drawn where the tip touches the bone.
    points : (n, 3) float, m, tracker frame
        In the order of the residuals.

    """
    assert result.T_bone_tracker is not None
    on_bone = field.contacts(transform(result.T_bone_tracker, points))
    traces = [_bone(field), *_points(result, on_bone)]
    if result.weakest_direction is not None:
        traces.append(_axis(result.weakest_direction, field))
    figure = go.Figure(traces, _layout(camera=_camera(field, on_bone)))
    if result.covariance is not None and len(field.faces):
        _add_tre_button(figure, result)
    return figure


def tracker_scene(points: Array) -> go.Figure:
    """Return the plot of points (n, 3), m, tracker frame, without the bone."""
    points = _downsample(points, np.ones(len(points), bool))[0]
    return go.Figure([_dots(points, 'points', size=2.5, color='#0969da')], _layout())


def _bone(field: Field) -> go.Mesh3d | go.Scatter3d:
    """Return the mesh of the bone, or its points if it is a point cloud."""
    if not len(field.faces):
        return _dots(field.surface_points, 'bone', size=1.5, color=BONE)
    vertices, faces = decimate(field.vertices, field.faces, MAX_FACES)
    x, y, z = _mm(vertices)
    i, j, k = np.ascontiguousarray(faces.T)
    return go.Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, name='bone', color=BONE, showlegend=True,
                     hoverinfo='skip', lighting={'ambient': 0.7, 'diffuse': 0.5, 'specular': 0.05})


def _points(result: RegistrationResult, points: Array) -> list[go.Scatter3d]:
    """Return the inliers, coloured by residual, and the other points, hollow."""
    if result.residuals_m is None or result.weights is None:
        return [_dots(points, 'points', size=3, color='#0969da')]
    inlier = np.asarray((result.weights > INLIER_WEIGHT) & np.isfinite(result.residuals_m))
    inside, residuals = _downsample(points, inlier, 1e3 * result.residuals_m)
    limit = float(np.percentile(np.abs(residuals), 98)) if len(residuals) else 1.0
    coloured = _dots(inside, 'inliers, by residual', size=3.5, color=residuals.astype(np.float32),
                     colorscale=SIGNED, cmin=-limit, cmax=limit,
                     colorbar=_bar('residual, mm<br>(fit, NOT<br>accuracy)'))
    coloured.hovertemplate = 'residual %{marker.color:.2f} mm<extra></extra>'
    others = _dots(_downsample(points, ~inlier)[0], 'outliers or not used (hollow)', size=3.5,
                   color=GREY, symbol='circle-open')
    return [coloured, others]


def _axis(weakest: WeakestDirection, field: Field) -> go.Scatter3d:
    """Return the axis of the motion that the points constrain least."""
    ends = weakest.point + np.outer([-0.6, 0.6], field.extent * weakest.axis)
    x, y, z = _mm(ends)
    return go.Scatter3d(x=x, y=y, z=z, mode='lines', name='axis of the least constrained motion',
                        hovertemplate=f'{weakest.sentence}<extra></extra>',
                        line={'color': '#8250df', 'width': 4, 'dash': 'dash'})


def _dots(points: Array, name: str, **marker: Any) -> go.Scatter3d:
    x, y, z = _mm(points)
    return go.Scatter3d(x=x, y=y, z=z, mode='markers', name=name, marker=marker,
                        hovertemplate='(%{x:.1f}, %{y:.1f}, %{z:.1f}) mm<extra></extra>')


def _downsample(points: Array, chosen: NDArray[np.bool_],
           values: Array | None = None) -> tuple[Array, Array]:
    """Return the chosen points and their values, downsampled evenly if there are too many."""
    rows = np.flatnonzero(chosen & np.isfinite(points).all(axis=1))
    rows = rows[::-(-len(rows) // MAX_POINTS) or 1]
    return points[rows], np.zeros(len(rows)) if values is None else values[rows]


def _mm(points: Array) -> NDArray[np.float32]:
    """Return metres (n, 3) as columns (3, n) of millimetres, rounded to 0.01 mm."""
    return np.ascontiguousarray(np.round(1e3 * np.asarray(points, np.float64), 2).T, np.float32)


def _bar(title: str, x: float = 1.0) -> dict[str, Any]:
    return {'title': {'text': title}, 'x': x, 'len': 0.6, 'thickness': 14}


def _camera(field: Field, points: Array) -> dict[str, Any]:
    """Return a camera that looks at the touched side of the bone."""
    _, outward = field.sample(points[np.isfinite(points).all(axis=1)])
    x, y, z = (float(value) for value in 1.5 * outward.mean(axis=0)
               / max(float(np.linalg.norm(outward.mean(axis=0))), 0.1))
    upright = abs(z) < 1.3
    return {'eye': {'x': x, 'y': y, 'z': z},
            'up': {'x': 0, 'y': 0 if upright else 1, 'z': 1 if upright else 0}}


def _layout(**scene: Any) -> go.Layout:
    axes = {f'{name}axis': {'title': {'text': f'{name}, mm'}} for name in 'xyz'}
    return go.Layout(height=HEIGHT, margin={'l': 0, 'r': 0, 't': 40, 'b': 0},
                     legend={'orientation': 'h', 'y': 0, 'yanchor': 'top',
                             'itemsizing': 'constant'},
                     scene={'aspectmode': 'data', **axes, **scene})


def _add_tre_button(figure: go.Figure, result: RegistrationResult) -> None:
    """Add buttons to colour the bone by predicted TRE or the points by residual."""
    bone = figure.data[0]
    corners = np.stack([bone.x, bone.y, bone.z], axis=1).astype(np.float64) / 1e3
    assert result.T_tracker_bone is not None and result.covariance is not None
    tre = 1e3 * error_bound(result.T_tracker_bone, result.covariance, corners)
    plain = [[0, BONE], [1, BONE]]
    bone.update(intensity=tre.astype(np.float32), colorscale=plain, showscale=False, hoverinfo=None,
                colorbar=_bar('predicted<br>TRE, mm', x=-0.02),
                hovertemplate='predicted TRE %{intensity:.2f} mm<extra></extra>')
    views = {'fit: residual of the points': (plain, False, True),
             'expected accuracy: predicted TRE': (HEAT, True, 'legendonly')}
    figure.update_layout(updatemenus=[{
        'type': 'buttons', 'direction': 'right', 'x': 0, 'xanchor': 'left', 'y': 1,
        'yanchor': 'bottom', 'buttons': [{'label': label, 'method': 'restyle', 'args': [
            {'colorscale': [scale], 'showscale': [shown], 'visible': [True, points]}, [0, 1]]}
            for label, (scale, shown, points) in views.items()]}])
