# SPDX-License-Identifier: Apache-2.0
"""
The operator's console as a web page: the bone in 3D, the verdict, and a button for every service.

The page knows neither ROS nor the session. It draws markers, as of ``~/markers``, and the values of
``~/status``; whoever owns it provides the functions behind the buttons.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import trimesh
import viser
from trimesh.exchange.gltf import export_glb

from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization import colours, console_panel
from gsdf_registration.visualization.console_panel import Limits, Tracker
from msg_adapters.marker_cdr import Marker, Shape

TIP = 0.002         # m, radius of the ball that shows the tip
NEAR = 0.002        # m, of the camera
BACKGROUND = '#15181c'
# letter -> from where the camera looks, in a bone frame of which x is left, y posterior, z superior
VIEWS = {'A': (0, -1, 0), 'P': (0, 1, 0), 'L': (1, 0, 0), 'R': (-1, 0, 0), 'S': (0, 0, 1),
         'I': (0, 0, -1)}
RAS = np.diag([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Action:
    """
    A button: its service, label, icon and hotkey.

    confirm : what is lost, for a question before it; empty: none is asked
    often : whether the button is always visible, instead of in a tab
    """

    name: str
    label: str
    icon: str
    hotkey: Any
    color: Any = 'gray'
    confirm: str = ''
    often: bool = True


ACTIONS = (
    Action('register', 'Register', 'TARGET', 'R', 'green'),
    Action('collect', 'New stroke / pause', 'PLAYER_PLAY', 'space', 'blue'),
    Action('undo', 'Undo stroke', 'ARROW_BACK_UP', 'U'),
    Action('capture_landmark', 'Capture landmark', 'MAP_PIN', 'L'),
    Action('verify', 'Verify', 'CHECKS', 'V'),
    Action('calibrate_tip', 'Calibrate tip', 'TOOL', 'T', often=False),
    Action('find_joint_centre', 'Find joint centre', 'ROTATE', 'J', often=False),
    Action('save', 'Save session', 'DEVICE_FLOPPY', 'S', often=False),
    Action('load', 'Load session', 'FOLDER_OPEN', None, 'gray',
           'This replaces the points, landmarks and pose of this session by those of the file.',
           often=False),
    Action('clear', 'Clear', 'TRASH', None, 'red',
           'This drops all points, landmarks and verification points, and withdraws the pose.',
           often=False),
)


class ConsolePage:
    """
    The page and its web server; every method may be called from any thread.

    Parameters
    ----------
    run : callable
        Called with the name of an action when its button is pressed; returns the answer, success
        and one sentence.
    drop_stroke : callable
        Called with the number of a stroke.
    host, port : where the page is served
    view_only : bool
        Whether there are no buttons.
    ras : bool
        Whether x is right and y anterior in the bone frame, instead of left and posterior.

    """

    def __init__(self, run: Callable[[str], tuple[bool, str]],
                 drop_stroke: Callable[[int], tuple[bool, str]], *, host: str = '127.0.0.1',
                 port: int = 8080, view_only: bool = False, ras: bool = False) -> None:
        self._run, self._drop_stroke, self._view_only = run, drop_stroke, view_only
        self._axes = RAS if ras else np.eye(3)
        self._lock = threading.RLock()
        self._values: Mapping[str, str] | None = None
        self._message = ''
        self._limits, self._landmarks = Limits(), list[str]()
        self._extent: tuple[Array, float] | None = None     # centre and size of the bone, m
        self._tip: Array | None = None
        self._drawn: dict[str, Any] = {}
        self._stroke_rows: dict[int, str] = {}
        self._stroke_handles: list[Any] = []
        self._flash = False
        self.server = viser.ViserServer(host=host, port=port, label='Bone registration',
                                        verbose=False)
        self._build()

    @property
    def port(self) -> int:
        """Port on which the page is served."""
        return int(self.server.get_port())

    def stop(self) -> None:
        """Stop the web server."""
        self.server.stop()

    # ---- what the page shows

    def show_status(self, values: Mapping[str, str] | None, message: str = '') -> None:
        """Show a status; None: the node is not connected."""
        with self._lock, self.server.atomic():
            ready = values is not None and values.get('state') == 'ready'
            was_ready = self._values is not None and self._values.get('state') == 'ready'
            self._flash = ready and (self._flash or not was_ready)
            self._values, self._message = values, message
            self._refresh()

    def show_settings(self, limits: Limits, landmarks: Sequence[str]) -> None:
        """Show these limits beside the values, and these landmarks."""
        with self._lock:
            self._limits, self._landmarks = limits, list(landmarks)
            self._refresh()

    def show_tracker(self, tracker: Tracker) -> None:
        """Show whether the probe is seen."""
        self._set('tracking', console_panel.tracking(tracker))

    def show_answer(self, success: bool, sentence: str) -> None:
        """Show the answer of a service to everybody."""
        for client in self.server.get_clients().values():
            client.add_notification('Done' if success else 'Not done', sentence,
                                    auto_close_seconds=8.0 if success else 20.0,
                                    color='green' if success else 'yellow')

    def show_progress(self, share: float | None, words: str = '') -> None:
        """Show how far a search or a compilation is, 0 to 1; None: nothing runs."""
        with self._lock:
            self._progress.visible = share is not None
            self._progress.value = 100.0 * (share or 0.0)
            self._progress_words.content = words if share is not None else ''

    def show_tip(self, position: Array | None) -> None:
        """Show the tip at ``position`` (3,), m, bone frame; None: its place is not known."""
        self._tip = position
        if position is None:
            self._ball.visible = False
            return
        self._ball.position = np.asarray(position, dtype=np.float64)
        if not self._ball.visible:
            self._ball.visible = True

    def show_markers(self, markers: Iterable[Marker]) -> None:
        """Draw a complete scene, bone frame; what is not in it disappears."""
        with self._lock, self.server.atomic():
            shown = set()
            for marker in markers:
                if marker.shape is not None:
                    name = f'/{marker.ns}/{marker.id}'
                    shown.add(name)
                    self._draw(name, marker)
            for name in self._drawn.keys() - shown:
                self._drawn.pop(name).remove()

    # ---- construction

    def _build(self) -> None:
        gui, scene = self.server.gui, self.server.scene
        gui.configure_theme(dark_mode=True, control_layout='collapsible', control_width='large',
                            show_logo=False, show_share_button=False, brand_color=(108, 182, 255))
        gui.set_panel_label('Bone registration')
        scene.configure_environment_map(hdri=None)
        scene.configure_default_lights(False)
        scene.add_light_hemisphere('/light/sky', ground_color=(150, 150, 160), intensity=1.6)
        for number, place in enumerate(((1.0, -1.0, 1.0), (-1.0, 1.0, 0.3),
                                         (-1.0, -0.5, -1.0))):
            scene.add_light_directional(f'/light/{number}', color=(255, 250, 240), intensity=0.9,
                                        position=place)
        scene.set_background_image(np.full((1, 1, 3), 255 * colours.rgb(BACKGROUND),
                                           dtype=np.uint8))
        self._ball = scene.add_icosphere('/tip', TIP, (255, 255, 255), visible=False)
        self._html: dict[str, Any] = {'verdict': gui.add_html('')}
        self._progress: Any = gui.add_progress_bar(0.0, animated=True, visible=False)
        self._progress_words = gui.add_markdown('')
        self._html['tracking'] = gui.add_html('')
        self._add_buttons(often=True)
        tabs = gui.add_tab_group()
        for name, label in (('accuracy', 'Accuracy'), ('landmarks', 'Landmarks'),
                            ('verification', 'Verify'), ('counters', 'Points')):
            with tabs.add_tab(label):
                self._html[name] = gui.add_html('')
                if name == 'counters':
                    self._strokes = gui.add_folder('Strokes')
        with tabs.add_tab('View'):
            self._add_views()
        if not self._view_only:
            with tabs.add_tab('More'):
                self._add_buttons(often=False)
        self.server.on_client_connect(self._greet)
        self._refresh()

    def _add_buttons(self, often: bool) -> None:
        gui = self.server.gui
        for action in ACTIONS if not self._view_only else ():
            if action.often != often:
                continue
            button = gui.add_button(action.label, color=action.color,
                                    icon=getattr(viser.Icon, action.icon), hint=_hint(action))
            button.on_click(partial(self._press, action))
            if action.hotkey is not None:
                command = gui.add_command(action.label, hotkey=action.hotkey)
                command.on_trigger(partial(self._press, action))

    def _add_views(self) -> None:
        gui = self.server.gui
        for letters in (('A', 'P', 'L'), ('R', 'S', 'I')):
            group = gui.add_button_group('From', letters)
            group.on_click(lambda event: self._look(event.client, event.target.value))
        gui.add_button('From the probe').on_click(lambda event: self._look(event.client, 'probe'))
        self._alert = gui.add_checkbox('Flash when ready', False)

    # ---- actions

    def _press(self, action: Action, _: Any) -> None:
        if action.confirm:
            self._ask(action)
        else:
            self.show_answer(*self._run(action.name))

    def _ask(self, action: Action) -> None:
        gui = self.server.gui
        modal = gui.add_modal(action.label)
        with modal:
            gui.add_markdown(action.confirm)
            yes = gui.add_button(action.label, color='red')
            no = gui.add_button('Cancel')
        no.on_click(lambda _: modal.close())

        @yes.on_click
        def _(_: Any) -> None:
            modal.close()
            self.show_answer(*self._run(action.name))

    def _drop(self, number: int, _: Any) -> None:
        self.show_answer(*self._drop_stroke(number))

    # ---- drawing

    def _refresh(self) -> None:
        values = self._values
        flash = self._flash and self._alert.value
        self._set('verdict', console_panel.verdict(values, self._message, flash))
        known = values or {}
        self._set('accuracy', console_panel.accuracy(known, self._limits))
        self._set('landmarks', console_panel.landmarks(known, self._landmarks))
        self._set('verification', console_panel.verification(known))
        self._set('counters', console_panel.counters(known))
        self._list_strokes(console_panel.strokes(known))

    def _set(self, name: str, content: str) -> None:
        if self._html[name].content != content:
            self._html[name].content = content

    def _list_strokes(self, rows: dict[int, str]) -> None:
        if rows == self._stroke_rows:
            return
        for handle in self._stroke_handles:
            handle.remove()
        self._stroke_rows, self._stroke_handles = rows, []
        gui = self.server.gui
        with self._strokes:
            for number, sentence in rows.items():
                self._stroke_handles.append(gui.add_markdown(f'**Stroke {number}** {sentence}'))
                if not self._view_only:
                    button = gui.add_button(f'Drop stroke {number}')
                    button.on_click(partial(self._drop, number))
                    self._stroke_handles.append(button)

    def _draw(self, name: str, marker: Marker) -> None:
        scene = self.server.scene
        points = np.zeros((0, 3)) if marker.points is None else marker.points
        pose = np.eye(4) if marker.pose is None else marker.pose
        points = points @ pose[:3, :3].T + pose[:3, 3]
        shade = _bytes(marker.colours, len(points))
        handle: Any
        if marker.shape is Shape.TRIANGLE_LIST:
            vertices, first, faces = _weld(points)
            self._extent = _extent(vertices)
            handle = scene.add_glb(name, _glb(vertices, faces, shade[first]), cast_shadow=False,
                                   receive_shadow=False)
        elif marker.shape is Shape.SPHERE_LIST:
            handle = scene.add_point_cloud(name, points.astype(np.float32), shade,
                                           point_size=marker.scale[0], point_shape='circle',
                                           precision='float32')
        elif marker.shape is Shape.LINE_LIST:
            lines = points.reshape(-1, 2, 3).astype(np.float32)
            handle = scene.add_line_segments(name, lines, shade.reshape(-1, 2, 3),
                                             thickness=marker.scale[0])
        elif marker.shape is Shape.ARROW:
            handle = scene.add_arrows(name, points.reshape(1, 2, 3), _one(marker),
                                      shaft_radius=0.5 * marker.scale[0],
                                      head_radius=0.5 * marker.scale[1],
                                      head_length=marker.scale[2])
        elif marker.shape is Shape.TEXT:
            handle = scene.add_label(name, marker.text, position=tuple(pose[:3, 3]))
        else:
            return
        self._drawn[name] = handle

    # ---- cameras

    def _greet(self, client: Any) -> None:
        client.camera.near = NEAR
        self._look(client, 'A')

    def _look(self, client: Any, view: str) -> None:
        if client is None or self._extent is None:
            return
        centre, size = self._extent
        if view == 'probe':
            if self._tip is None:
                return
            out = self._tip - centre
            out = out / max(float(np.linalg.norm(out)), 1e-9)
            centre = self._tip
            distance = 0.4 * size
        else:
            out, distance = self._axes @ np.array(VIEWS[view], dtype=float), 1.4 * size
        up = np.array([0.0, 0.0, 1.0]) if abs(out[2]) < 0.9 else self._axes @ np.array(
            [0.0, -1.0, 0.0])
        with client.atomic():
            client.camera.up_direction = tuple(up)
            client.camera.position = tuple(centre + distance * out)
            client.camera.look_at = tuple(centre)


def _hint(action: Action) -> str | None:
    return None if action.hotkey is None else f'key {action.hotkey}'


def _bytes(shade: Array | None, count: int) -> np.ndarray:
    """Return a colour for each of ``count`` points, (count, 3) uint8."""
    every = np.ones(3) if shade is None else np.asarray(shade)[..., :3]
    return np.broadcast_to(np.clip(255.0 * every, 0.0, 255.0).astype(np.uint8), (count, 3)).copy()


def _one(marker: Marker) -> tuple[int, int, int]:
    red, green, blue = _bytes(marker.colours, 1)[0].tolist()
    return red, green, blue


def _weld(corners: Array) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the vertices of triangles (3 m, 3), the row of each among them, and the faces."""
    rounded = np.ascontiguousarray(np.round(corners, 7))
    _, first, inverse = np.unique(rounded.view(np.dtype((np.void, 24))).ravel(), return_index=True,
                                  return_inverse=True)
    return (corners[first].astype(np.float32), first,
            inverse.reshape(-1, 3).astype(np.uint32))


def _glb(vertices: np.ndarray, faces: np.ndarray, shade: np.ndarray) -> bytes:
    """Return a mesh with a colour for each vertex as GLB; glTF surfaces are metal by default."""
    def add_material(tree: dict[str, Any]) -> None:
        tree['materials'] = [{'doubleSided': True, 'pbrMetallicRoughness': {
            'metallicFactor': 0.0, 'roughnessFactor': 0.75}}]
        for mesh in tree['meshes']:
            for primitive in mesh['primitives']:
                primitive['material'] = 0

    scene = trimesh.Scene(trimesh.Trimesh(vertices, faces, vertex_colors=shade, process=False))
    return bytes(export_glb(scene, include_normals=True, tree_postprocessor=add_material))


def _extent(vertices: Array) -> tuple[Array, float]:
    """Return the centre of the bounding box (3,), m, and its longest side, m."""
    low, high = vertices.min(axis=0).astype(float), vertices.max(axis=0).astype(float)
    return 0.5 * (low + high), float((high - low).max())
