# SPDX-License-Identifier: Apache-2.0
"""
The scene of ~/markers as a PNG: three views, a legend, and the next touches.

The bone is rendered from its field, see `raycast`; matplotlib adds text and scales and needs no
display for this.
"""

from __future__ import annotations

import io
import os
import textwrap
from typing import TYPE_CHECKING

import numpy as np

from gsdf_registration.common.result import INLIER_WEIGHT, InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.raycast import looking_at
from gsdf_registration.visualization.render import Scene, View, render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 100
SIZE = (1320, 840)      # width and height of the picture, pixels
SHAPE = (560, 420)      # height and width of a view, pixels
BELOW = 176             # pixels below the views, for scales and text
OVERSAMPLING = 2        # rays per pixel and direction, for smooth edges
SHADES = 63             # levels per colour channel: hardly visible, and the file is small
CLOSE_MARGIN = 0.012    # m around the touched area
WHOLE_MARGIN = 0.006    # m around the whole bone
FRONT = np.array([0.0, -1.0, 0.0])      # default direction to the viewer
GOOD, BAD = '#0b6e4f', '#b3120f'


def require_matplotlib() -> None:
    """Raise an `InputError` that says what to install if matplotlib is missing."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise InputError('a picture needs matplotlib, which is not installed: '
                         "pip install 'gsdf_registration[report]'") from None


def write_picture(path: str | os.PathLike[str], scene: Scene, title: str, good: bool) -> None:
    """
    Write a scene as a PNG; an existing file is replaced.

    Parameters
    ----------
    path : str or path
    scene : Scene
    title : str
        One sentence above the views.
    good : bool
        Whether the title reports an accepted pose; it sets the colour.

    Raises
    ------
    InputError
        If matplotlib is not installed or the file cannot be written.

    """
    require_matplotlib()
    from matplotlib.figure import Figure

    from msg_adapters.files import write_atomically
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI)
    figure.text(0.015, 0.985, textwrap.fill(title, 150), fontsize=11, va='top', linespacing=1.4,
                color=GOOD if good else BAD)
    for number, (name, view) in enumerate(views(scene).items()):
        _draw_view(figure, number, name, view, scene)
    _draw_legend(figure, scene)
    picture = io.BytesIO()
    figure.savefig(picture, format='png', dpi=DPI, pil_kwargs={'optimize': True})
    write_atomically(path, picture.getvalue())


def views(scene: Scene) -> dict[str, View]:
    """Return views of the touched area, of the whole bone, and of what these two do not show."""
    surface = scene.field.surface_points.astype(np.float64)
    touches = scene.next_touches
    touched = _touched(scene)
    if len(touched):
        outward = _direction(scene, touched)
        shown = np.vstack([touched, *(touch.position for touch in touches)])
        views = {'touched area': _view(scene, shown, outward, CLOSE_MARGIN),
                 'whole bone, same direction': _view(scene, surface, outward, WHOLE_MARGIN)}
    else:
        outward = touches[0].normal if touches else FRONT
        views = {'bone': _view(scene, surface, outward, WHOLE_MARGIN)}
    hidden = next((k for k, touch in enumerate(touches)
                   if not any(view.sees(touch) for view in views.values())), None)
    if hidden is None:
        name, direction = 'opposite side', -outward
    else:
        name, direction = f'side of next touch {hidden + 1}', touches[hidden].normal
    return views | {name: _view(scene, surface, direction, WHOLE_MARGIN)}


def whole_bone(scene: Scene) -> View:
    """Return a view of the whole bone from the side that was touched."""
    return _view(scene, scene.field.surface_points.astype(np.float64),
                 _direction(scene, _touched(scene)), WHOLE_MARGIN)


def _touched(scene: Scene) -> Array:
    """Return the points on the bone (n, 3), m, bone frame; none without a pose."""
    if scene.T_tracker_bone is None:
        return np.zeros((0, 3))
    return scene.points[scene.weights > INLIER_WEIGHT]


def _direction(scene: Scene, touched: Array) -> Array:
    """Return the direction (3,) from which most of the touched places are seen."""
    if not len(touched):
        return FRONT
    outward: Array = scene.field.sample(touched)[1].mean(axis=0)
    return FRONT if np.linalg.norm(outward) < 0.1 else outward     # touched on all sides


def _view(scene: Scene, places: Array, direction: Array, margin: float) -> View:
    shape = OVERSAMPLING * SHAPE[0], OVERSAMPLING * SHAPE[1]
    return render(scene, looking_at(places, direction, shape, margin))


def _draw_view(figure: Figure, number: int, name: str, view: View, scene: Scene) -> None:
    """Draw a view beside the others, with a scale bar and the numbers of the next touches."""
    gap = (SIZE[0] - 3 * SHAPE[1]) // 4
    left = gap + number * (gap + SHAPE[1])
    # pixel by pixel, so that nothing is resampled, and below the text
    figure.figimage(downsample(view.image), left, BELOW, zorder=-1)
    axes = figure.add_axes((left / SIZE[0], BELOW / SIZE[1], SHAPE[1] / SIZE[0],
                            SHAPE[0] / SIZE[1]))
    right, bottom = OVERSAMPLING * SHAPE[1], OVERSAMPLING * SHAPE[0]
    axes.set_title(name, fontsize=11, color='#444444')
    axes.set_axis_off()
    badge = {'boxstyle': 'circle,pad=0.15', 'facecolor': '#00664a', 'edgecolor': 'white'}
    for k, touch in enumerate(scene.next_touches, start=1):
        if view.sees(touch):
            column, row, _ = view.camera.project(touch.position[None])
            axes.text(column[0], row[0], str(k), ha='center', va='center', color='white',
                      fontsize=10, fontweight='bold', bbox=badge)
    length, foot = 0.02 / view.camera.pixel, bottom - 12
    axes.plot([12, 12 + length], [foot, foot], color='black', linewidth=3, solid_capstyle='butt')
    axes.text(12 + 0.5 * length, foot - 10, '20 mm', ha='center', fontsize=9)
    axes.set_xlim(0, right)
    axes.set_ylim(bottom, 0)


def downsample(image: Array) -> Array:
    """Return an image with the mean of every OVERSAMPLING x OVERSAMPLING pixels."""
    rows, columns, channels = image.shape
    rows, columns = rows // OVERSAMPLING, columns // OVERSAMPLING
    mean = image.reshape(rows, OVERSAMPLING, columns, OVERSAMPLING, channels).mean(axis=(1, 3))
    return np.round(SHADES * np.clip(mean, 0.0, 1.0)) / SHADES


def _draw_legend(figure: Figure, scene: Scene) -> None:
    """Draw the scales of the colours and the gain of each next touch."""
    lines = [f'{k}: {touch.expected_gain}' for k, touch in enumerate(scene.next_touches, start=1)]
    if lines:
        figure.text(0.7, 0.175, '\n'.join(['green: where to touch next', *lines]), fontsize=10,
                    va='top', color='#00664a', linespacing=1.6)
    if scene.T_tracker_bone is None:
        figure.text(0.02, 0.15, 'no pose: the points cannot be placed on the bone', fontsize=11,
                    color='#444444')
        return
    used = scene.weights > INLIER_WEIGHT
    _draw_scale(figure, 0.02, colours.RESIDUAL, colours.max_residual(scene.limits),
                'points: distance from the surface, mm (NOT the accuracy)')
    _draw_scale(figure, 0.36, colours.ERROR, colours.max_error(scene.limits),
                'bone: 95 % of the errors are smaller, mm; line: border of the zone')
    figure.text(0.02, 0.03, f'{used.sum()} points on the bone; grey: {(~used).sum()} not used',
                fontsize=10, color='#444444')


def _draw_scale(figure: Figure, left: float, scale: tuple[str, ...], limit: float,
                label: str) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap, Normalize
    bar = figure.add_axes((left, 0.115, 0.3, 0.024))
    steps = colours.on_scale(np.linspace(0.0, limit, 256), scale, limit)
    figure.colorbar(ScalarMappable(Normalize(0.0, 1e3 * limit), ListedColormap(steps)), cax=bar,
                    orientation='horizontal', extend='max')
    bar.set_title(label, fontsize=10, loc='left')
