# SPDX-License-Identifier: Apache-2.0
"""The 3D view of the operator's console: markers, the tip of the probe, landmarks and cameras."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
import viser
from trimesh.exchange.gltf import export_glb
from trimesh.visual import ColorVisuals

from gsdf_registration.common.rigid import Array, quaternion_from_rotation
from gsdf_registration.visualization import colours
from msg_adapters.marker_cdr import Marker, Shape

TIP = 0.002         # m, radius of the ball that shows the tip
LANDMARK = 0.003    # m, radius of a landmark
NEAR = 0.002        # m, of the camera
FILLED = 0.85       # share of the view that the bone takes
BACKGROUND = '#15181c'
OTHER_LANDMARKS = '#6cb6ff'
# letter -> from where the camera looks, in a bone frame of which x is left, y posterior, z superior
VIEWS = {'A': (0, -1, 0), 'P': (0, 1, 0), 'L': (1, 0, 0), 'R': (-1, 0, 0), 'S': (0, 0, 1),
         'I': (0, 0, -1)}
RAS = np.diag([-1.0, -1.0, 1.0])
# from where the lamps shine, beside light from everywhere
LAMPS = ((1.0, -1.0, 1.0), (-1.0, 1.0, 0.3), (-1.0, -0.5, -1.0))


@dataclass(frozen=True)
class LandmarkPlaces:
    """The landmarks of the model: names, and positions x y z, m, bone frame."""

    names: tuple[str, ...] = ()
    positions: tuple[tuple[float, float, float], ...] = ()


class ConsoleScene:
    """
    Draws in the bone frame, in metres; every method may be called from any thread.

    Parameters
    ----------
    server : viser.ViserServer
    ras : bool
        Whether x is right and y anterior in the bone frame, instead of left and posterior.

    """

    def __init__(self, server: viser.ViserServer, ras: bool) -> None:
        self._server, self._axes = server, RAS if ras else np.eye(3)
        self._lock = threading.RLock()
        self._corners: Array | None = None      # (2, 3) m, of the box around the bone
        self._tip: Array | None = None
        self._drawn: dict[str, tuple[Marker, Any]] = {}
        # corners of the bone's triangles, the row of each vertex among them, and the surface
        self._welded: tuple[Array, np.ndarray, trimesh.Trimesh] | None = None
        self._landmarks: list[Any] = []
        self._shown_landmarks: tuple[Any, int] | None = None
        self._light()
        self._ball = server.scene.add_icosphere('/tip', TIP, (255, 255, 255), visible=False)
        server.on_client_connect(self._greet)

    def show_markers(self, markers: Iterable[Marker]) -> None:
        """Draw a complete scene; what is not in it disappears."""
        with self._lock, self._server.atomic():
            first, shown = self._corners is None, set()
            for marker in markers:
                name = f'/{marker.ns}/{marker.id}'
                if marker.shape is None:
                    continue
                shown.add(name)
                before = self._drawn.get(name)
                if before is None or not _same(before[0], marker):
                    self._drawn[name] = marker, self._draw(name, marker)
            for name in self._drawn.keys() - shown:
                self._drawn.pop(name)[1].remove()
        if first and self._corners is not None:     # the bone came after the clients
            for client in self._server.get_clients().values():
                self.look(client, 'A')

    def show_tip(self, position: Array | None) -> None:
        """Show the tip at ``position`` (3,), m; None: its place is not known."""
        self._tip = position
        if position is not None:
            self._ball.position = np.asarray(position, dtype=np.float64)
        if self._ball.visible != (position is not None):
            self._ball.visible = position is not None

    def show_landmarks(self, places: LandmarkPlaces, captured: int) -> None:
        """Show the landmarks; the one after ``captured`` others is next and shows its name."""
        with self._lock:
            if self._shown_landmarks == (places, captured):
                return
            self._shown_landmarks = places, captured
            for handle in self._landmarks:
                handle.remove()
            self._landmarks = []
            scene = self._server.scene
            for number, (name, place) in enumerate(zip(places.names, places.positions)):
                following = number == captured
                shade = colours.rgb(colours.NEXT if following else OTHER_LANDMARKS)
                self._landmarks.append(scene.add_icosphere(
                    f'/landmark/{number}', (1.5 if following else 1.0) * LANDMARK,
                    _one(shade), position=place))
                if following:
                    self._landmarks.append(scene.add_label(f'/landmark_name/{number}', name,
                                                           position=place))

    def look(self, client: viser.ClientHandle, view: str) -> bool:
        """Place a camera: a letter of `VIEWS`, or 'probe'; False if that is not known yet."""
        corners, tip = self._corners, self._tip
        if corners is None or (view == 'probe' and tip is None):
            return False
        centre = corners.mean(axis=0)
        if view == 'probe' and tip is not None:
            out = tip - centre
        else:
            out = self._axes @ np.array(VIEWS[view], dtype=float)
        out = out / max(float(np.linalg.norm(out)), 1e-9)
        up = np.array([0.0, 0.0, 1.0]) if abs(out[2]) < 0.9 else self._axes @ np.array(
            [0.0, -1.0, 0.0])
        distance = _distance(corners - centre, out, up, client.camera.fov, client.camera.aspect)
        if view == 'probe' and tip is not None:
            centre, distance = tip, 0.4 * distance
        with client.atomic():
            client.camera.up_direction = tuple(up)
            client.camera.position = tuple(centre + distance * out)
            client.camera.look_at = tuple(centre)
        return True

    def _greet(self, client: viser.ClientHandle) -> None:
        client.camera.near = NEAR
        self.look(client, 'A')

    def _light(self) -> None:
        scene = self._server.scene
        scene.configure_environment_map(hdri=None)
        scene.configure_default_lights(False)
        scene.add_light_hemisphere('/light/sky', ground_color=(170, 170, 180), intensity=2.0)
        for number, place in enumerate(LAMPS):
            scene.add_light_directional(f'/light/{number}', color=(255, 250, 240), intensity=1.2,
                                        position=place)
        scene.set_background_image(np.full((1, 1, 3), 255 * colours.rgb(BACKGROUND),
                                           dtype=np.uint8))

    def _draw(self, name: str, marker: Marker) -> Any:
        """Draw a marker and return its handle."""
        scene = self._server.scene
        pose = np.eye(4) if marker.pose is None else marker.pose
        points = np.zeros((0, 3)) if marker.points is None else marker.points
        points = points @ pose[:3, :3].T + pose[:3, 3]
        shade = _bytes(marker.colours, len(points))
        if marker.shape is Shape.TRIANGLE_LIST:
            if self._welded is None or not np.array_equal(self._welded[0], points):
                self._welded = (points, *_weld(points))     # else only its colours have changed
            _, first, surface = self._welded
            self._corners = np.array(surface.bounds, dtype=float)
            return scene.add_glb(name, _glb(surface, _linear(shade[first])), cast_shadow=False,
                                 receive_shadow=False)
        if marker.shape is Shape.SPHERE_LIST:
            if marker.ns == 'bone':     # a model without faces
                self._corners = np.array([points.min(axis=0), points.max(axis=0)])
            return scene.add_point_cloud(name, points.astype(np.float32), shade,
                                         point_size=marker.scale[0], point_shape='circle',
                                         precision='float32')
        if marker.shape is Shape.LINE_LIST:
            lines = points.reshape(-1, 2, 3).astype(np.float32)
            return scene.add_line_segments(name, lines, shade.reshape(-1, 2, 3),
                                           thickness=marker.scale[0])
        colour = _one(np.ones(3) if marker.colours is None else marker.colours)
        if marker.shape is Shape.ARROW:
            return scene.add_arrows(name, points.reshape(1, 2, 3), colour,
                                    shaft_radius=0.5 * marker.scale[0],
                                    head_radius=0.5 * marker.scale[1], head_length=marker.scale[2])
        if marker.shape is Shape.CYLINDER:
            x, y, z, w = quaternion_from_rotation(pose[:3, :3])
            return scene.add_cylinder(name, 0.5 * marker.scale[0], marker.scale[2], colour,
                                      opacity=0.75, wxyz=(w, x, y, z), position=pose[:3, 3],
                                      side='double', cast_shadow=False, receive_shadow=False)
        return scene.add_label(name, marker.text, position=pose[:3, 3])


def _distance(corners: Array, out: Array, up: Array, fov: float, aspect: float) -> float:
    """
    Return the distance from which a camera sees a box, m.

    corners : (2, 3) float, m, relative to the point that the camera looks at
    out, up : (3,) float, towards the camera, and upright in its picture
    fov : rad, vertical; aspect : width of the picture divided by its height
    """
    box = np.array([[x, y, z] for x in corners[:, 0] for y in corners[:, 1] for z in corners[:, 2]])
    right = np.cross(up, out)
    high = FILLED * np.tan(0.5 * fov)
    return float((box @ out + np.maximum(np.abs(box @ up) / high,
                                         np.abs(box @ right) / (high * aspect))).max())


def _same(a: Marker, b: Marker) -> bool:
    """Return whether two markers look the same."""
    return (a.shape, a.scale, a.text) == (b.shape, b.scale, b.text) and all(
        np.array_equal(one, other) if one is not None and other is not None else one is other
        for one, other in ((a.points, b.points), (a.colours, b.colours), (a.pose, b.pose)))


def _bytes(shade: Array | None, count: int) -> np.ndarray:
    """Return a colour for each of ``count`` points, (count, 3) uint8."""
    every = np.ones(3) if shade is None else np.asarray(shade)[..., :3]
    return np.broadcast_to(np.clip(255.0 * every, 0.0, 255.0).astype(np.uint8), (count, 3)).copy()


def _one(shade: Array) -> tuple[int, int, int]:
    red, green, blue = _bytes(shade, 1)[0].tolist()
    return red, green, blue


def _linear(shade: np.ndarray) -> np.ndarray:
    """Return sRGB colours (n, 3) uint8 in the linear space of glTF (IEC 61966-2-1)."""
    share = np.arange(256) / 255.0
    table = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055)**2.4)
    found: np.ndarray = np.round(255.0 * table).astype(np.uint8)[shade]
    return found


def _weld(corners: Array) -> tuple[np.ndarray, trimesh.Trimesh]:
    """Return the row of each vertex among the corners (3 m, 3) of triangles, and the surface."""
    rounded = np.ascontiguousarray(np.round(corners, 7))
    _, first, inverse = np.unique(rounded.view(np.dtype((np.void, 24))).ravel(), return_index=True,
                                  return_inverse=True)
    return first, trimesh.Trimesh(corners[first].astype(np.float32), inverse.reshape(-1, 3),
                                  process=False)


def _glb(surface: trimesh.Trimesh, shade: np.ndarray) -> bytes:
    """Return a surface with a colour for each vertex as GLB; glTF surfaces are metal by default."""
    def add_material(tree: dict[str, Any]) -> None:
        tree['materials'] = [{'doubleSided': True, 'pbrMetallicRoughness': {
            'metallicFactor': 0.0, 'roughnessFactor': 0.75}}]
        for mesh in tree['meshes']:
            for primitive in mesh['primitives']:
                primitive['material'] = 0

    surface.visual = ColorVisuals(surface, vertex_colors=shade)
    return bytes(export_glb(trimesh.Scene(surface), include_normals=True,
                            tree_postprocessor=add_material))
