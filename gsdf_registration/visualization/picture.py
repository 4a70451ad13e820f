# SPDX-License-Identifier: Apache-2.0
"""
The scene of ~/markers as a PNG: three views, what the colours mean, what to do next.

The bone is drawn from its field, see `raycast`; matplotlib, which needs no display for it, adds
words and scales.
"""

from __future__ import annotations

import io
import os
import textwrap
from typing import TYPE_CHECKING

import numpy as np

from gsdf_registration.common.result import ON_BONE, InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.raycast import looking_at
from gsdf_registration.visualization.view import Scene, View, paint

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DPI = 100
SIZE = (1320, 840)      # of the picture, pixels, across and down
SHAPE = (560, 420)      # of a view, pixels, down and across
BELOW = 176             # pixels: where scales and words are
FINER = 2               # rays a pixel, across and down: smooth edges
SHADES = 63             # of a colour: an eye hardly tells more apart, and the file is small
CLOSE = 0.012           # m of bone shown round what was touched
WHOLE = 0.006           # m of nothing round the whole bone
FRONT = np.array([0.0, -1.0, 0.0])      # where we look from if nothing tells of a better place
GOOD, BAD = '#0b6e4f', '#b3120f'


def require_matplotlib() -> None:
    """Raise an `InputError` that says what to install if no picture can be drawn."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise InputError('a picture needs matplotlib, which is not installed: '
                         "pip install 'gsdf_registration[report]'") from None


def write_picture(path: str | os.PathLike[str], scene: Scene, verdict: str, good: bool) -> None:
    """
    Write a scene as a PNG; a file that is there is replaced.

    Parameters
    ----------
    path : str or path
    scene : Scene
    verdict : str
        One sentence above all.
    good : bool
        Whether it is a good one.

    Raises
    ------
    InputError
        When matplotlib is not installed or the file cannot be written.

    """
    require_matplotlib()
    from matplotlib.figure import Figure

    from msg_adapters.files import write_atomically
    figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI)
    figure.text(0.015, 0.985, textwrap.fill(verdict, 150), fontsize=11, va='top', linespacing=1.4,
                color=GOOD if good else BAD)
    for number, (title, view) in enumerate(_views(scene).items()):
        _draw_view(figure, number, title, view, scene)
    _draw_words(figure, scene)
    picture = io.BytesIO()
    figure.savefig(picture, format='png', dpi=DPI, pil_kwargs={'optimize': True})
    write_atomically(path, picture.getvalue())


def _views(scene: Scene) -> dict[str, View]:
    """Return what was touched, the whole bone, and the bone from where all else is seen."""
    surface = scene.field.surface_points.astype(np.float64)
    touched = scene.positions[scene.found.weights > ON_BONE]
    touches = scene.found.touches
    if len(touched):
        outward = scene.field.sample(touched)[1].mean(axis=0)
        if np.linalg.norm(outward) < 0.1:       # touched all round
            outward = FRONT
        shown = np.vstack([touched, *(touch.position for touch in touches)])
        views = {'where it was touched': _view(scene, shown, outward, CLOSE),
                 'the whole bone from there': _view(scene, surface, outward, WHOLE)}
    else:
        outward = touches[0].normal if touches else FRONT
        views = {'the bone': _view(scene, surface, outward, WHOLE)}
    hidden = next((k for k, touch in enumerate(touches)
                   if not any(view.sees(touch) for view in views.values())), None)
    if hidden is None:
        title, aside = 'from the other side', -outward
    else:
        title, aside = f'from where {hidden + 1} can be seen', touches[hidden].normal
    return views | {title: _view(scene, surface, aside, WHOLE)}


def _view(scene: Scene, places: Array, direction: Array, margin: float) -> View:
    return paint(scene, looking_at(places, direction, (FINER * SHAPE[0], FINER * SHAPE[1]), margin))


def _draw_view(figure: Figure, number: int, title: str, view: View, scene: Scene) -> None:
    """Put a view beside the others, with a length to compare and the patches' numbers."""
    gap = (SIZE[0] - 3 * SHAPE[1]) // 4
    left = gap + number * (gap + SHAPE[1])
    # pixel by pixel: nothing is resampled; below all that is written on it
    figure.figimage(_coarser(view.image), left, BELOW, zorder=-1)
    axes = figure.add_axes((left / SIZE[0], BELOW / SIZE[1], SHAPE[1] / SIZE[0],
                            SHAPE[0] / SIZE[1]))
    right, bottom = FINER * SHAPE[1], FINER * SHAPE[0]
    axes.set_title(title, fontsize=11, color='#444444')
    axes.set_axis_off()
    badge = {'boxstyle': 'circle,pad=0.15', 'facecolor': '#00664a', 'edgecolor': 'white'}
    for k, touch in enumerate(scene.found.touches, start=1):
        if view.sees(touch):
            column, row, _ = view.camera.project(touch.position[None])
            axes.text(column[0], row[0], str(k), ha='center', va='center', color='white',
                      fontsize=10, fontweight='bold', bbox=badge)
    length, foot = 0.02 / view.camera.pixel, bottom - 12
    axes.plot([12, 12 + length], [foot, foot], color='black', linewidth=3, solid_capstyle='butt')
    axes.text(12 + 0.5 * length, foot - 10, '20 mm', ha='center', fontsize=9)
    axes.set_xlim(0, right)
    axes.set_ylim(bottom, 0)


def _coarser(image: Array) -> Array:
    """Return an image with the mean of every FINER x FINER pixels."""
    rows, columns = image.shape[0] // FINER, image.shape[1] // FINER
    mean = image.reshape(rows, FINER, columns, FINER, 3).mean(axis=(1, 3))
    return np.round(SHADES * np.clip(mean, 0.0, 1.0)) / SHADES


def _draw_words(figure: Figure, scene: Scene) -> None:
    """Say what the colours mean, and what to do next."""
    found = scene.found
    lines = [f'{k}: {touch.promise}' for k, touch in enumerate(found.touches, start=1)]
    if lines:
        figure.text(0.7, 0.175, '\n'.join(['green: where to touch next', *lines]), fontsize=10,
                    va='top', color='#00664a', linespacing=1.6)
    if found.covariance is None:
        figure.text(0.02, 0.15, 'no pose: nobody knows where on the bone the points are',
                    fontsize=11, color='#444444')
        return
    used = found.weights > ON_BONE
    _draw_scale(figure, 0.02, colours.RESIDUAL, colours.most_residual(scene.limits),
                'points: how far off the surface, mm (NOT the accuracy)')
    _draw_scale(figure, 0.36, colours.ERROR, colours.most_error(scene.limits),
                'bone: error to expect there (predicted TRE), mm')
    figure.text(0.02, 0.03, f'{used.sum()} points lie on the bone; grey: {(~used).sum()} not used',
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
