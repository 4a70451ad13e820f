# SPDX-License-Identifier: Apache-2.0
"""The pictures of the report: the views of `picture` as WebP in the page; needs Pillow."""

from __future__ import annotations

import base64
import html
import io
from dataclasses import replace

import numpy as np

from gsdf_registration.common.result import NextTouch
from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization import picture
from gsdf_registration.visualization.render import Scene, View
from gsdf_registration.visualization.report_content import ReportContent

MAX_RIVALS = 3      # more pictures of them would not help
QUALITY = 88        # of WebP
SCALE_BAR = 0.02    # m


def pictures(content: ReportContent) -> str:
    """Return the views as HTML figures; empty without a bone or a pose."""
    pose = content.pose
    if content.field is None or pose is None:
        return ''
    considered = content.result.considered
    touches = () if considered is None else considered.next_touches
    scene = Scene(content.field, content.config.limits, pose, content.covariance,
                  content.points.positions, content.residuals, content.weights, touches)
    shown = picture.views(scene)
    if len(content.poses) > 1:
        first, *rest = shown
        shown = {f'pose 1: {first}': shown[first], **{name: shown[name] for name in rest}}
        for number, rival in enumerate(content.poses[1:MAX_RIVALS + 1], start=2):
            shown[f'pose {number} fits about as well'] = picture.whole_bone(_at(scene, rival))
    return '\n'.join(_figure(name, view, touches) for name, view in shown.items())


def _at(scene: Scene, pose: Array) -> Scene:
    """Return the scene with the points at another pose."""
    moved = replace(scene, T_tracker_bone=pose, covariance=None)
    points = moved.points
    finite = np.isfinite(points).all(axis=1) & np.isfinite(scene.residuals)
    residuals = np.full(len(points), np.nan)
    residuals[finite] = scene.field.for_tip(0.0).sample(points[finite])[0]
    return replace(moved, residuals=residuals)


def _figure(name: str, view: View, touches: tuple[NextTouch, ...]) -> str:
    """Return a view with a scale bar and the numbers of the places to touch next."""
    rows, columns = view.height.shape
    marks = []
    for number, touch in enumerate(touches, start=1):
        if view.sees(touch):
            x, y, _ = (float(value[0]) for value in view.camera.project(touch.position[None]))
            marks.append(f'<g class="badge"><circle cx="{x:.0f}" cy="{y:.0f}" r="24"/>'
                         f'<text x="{x:.0f}" y="{y + 11:.0f}">{number}</text></g>')
    length = SCALE_BAR / view.camera.pixel
    marks.append(f'<g class="bar"><path d="M16 {rows - 18}h{length:.0f}"/><text x="16" '
                 f'y="{rows - 30}">{1e3 * SCALE_BAR:.0f} mm</text></g>')
    label = html.escape(name)
    return (f'<figure><div><img alt="{label}" width="{columns // picture.OVERSAMPLING}" '
            f'height="{rows // picture.OVERSAMPLING}" src="data:image/webp;base64,{_webp(view)}">'
            f'<svg viewBox="0 0 {columns} {rows}" aria-hidden="true">{"".join(marks)}</svg></div>'
            f'<figcaption>{label}</figcaption></figure>')


def _webp(view: View) -> str:
    """Return the picture in base64, with a transparent background."""
    from PIL import Image
    opaque = np.isfinite(view.height)[..., None]
    image = picture.downsample(np.concatenate([view.image * opaque, opaque], axis=2))
    colour, alpha = image[..., :3], image[..., 3:]
    image = np.concatenate([colour / np.maximum(alpha, 1e-9), alpha], axis=2)
    file = io.BytesIO()
    Image.fromarray(np.round(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8), 'RGBA').save(
        file, 'WEBP', quality=QUALITY)
    return base64.b64encode(file.getvalue()).decode('ascii')
