# SPDX-License-Identifier: Apache-2.0
"""
The operator's console as a web page: the bone in 3D, the verdict, and a button for every service.

The page knows neither ROS nor the session. It draws markers, as of ``~/markers``, and the values of
``~/status``; whoever owns it provides the functions behind the buttons.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import viser

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization import console_panel
from gsdf_registration.visualization.console_panel import Limits, Tracker
from gsdf_registration.visualization.console_scene import ConsoleScene, LandmarkPlaces
from gsdf_registration.visualization.timeline import Timeline
from gsdf_registration.visualization.web_access import LOCAL, accept_only
from msg_adapters.marker_cdr import Marker

PANEL = 385     # px, width of the panel on a wide screen


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
    Action('collect', 'New stroke', 'PLAYER_PLAY', 'space', 'blue'),
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
ALL_ACTIONS = frozenset(each.name for each in ACTIONS)


class ConsolePage:
    """
    The page and its web server; every method may be called from any thread.

    Parameters
    ----------
    run : callable
        Called with the name of an action when its button is pressed; returns the answer, success
        and one sentence.
    drop_stroke : callable
        Called with the number of a stroke; None: strokes cannot be excluded.
    host, port : where the page is served
    actions : of str
        Names of the actions that have a button.
    ras : bool
        Whether x is right and y anterior in the bone frame, instead of left and posterior.
    origin : str or pattern
        Pages that may connect, see `accept_only`; the default are those of this machine.

    Raises
    ------
    InputError
        If the port is in use.

    """

    def __init__(self, run: Callable[[str], tuple[bool, str]] | None = None,
                 drop_stroke: Callable[[int], tuple[bool, str]] | None = None, *,
                 host: str = '127.0.0.1', port: int = 8080,
                 actions: Container[str] = ALL_ACTIONS,
                 ras: bool = False, origin: str | re.Pattern[str] = LOCAL) -> None:
        self._run, self._drop_stroke = run or _refuse, drop_stroke
        self._actions = [each for each in ACTIONS if each.name in actions]
        self._lock = threading.RLock()
        self._values: Mapping[str, str] | None = None
        self._message, self._flash = '', False
        self._limits, self._places = Limits(), LandmarkPlaces()
        self._tracker: Tracker | None = Tracker()
        self._buttons: dict[str, Any] = {}
        self._stroke_rows: dict[int, str] = {}
        self._stroke_handles: list[Any] = []
        with accept_only(origin):
            self.server = viser.ViserServer(host=host, port=port, label='Bone registration',
                                            verbose=False)
        if self.server.get_port() != port:      # viser takes the next one that is free
            self.server.stop()
            raise InputError(f'port {port} is in use; give another --port')
        self.scene = ConsoleScene(self.server, ras)
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

    def show_settings(self, limits: Limits, places: LandmarkPlaces) -> None:
        """Show these limits beside the values, and these landmarks."""
        with self._lock, self.server.atomic():
            self._limits, self._places = limits, places
            self._set('legend', console_panel.legend(limits))
            self._refresh()

    def show_tracker(self, tracker: Tracker | None) -> None:
        """Show whether the probe is seen; None: there is no tracker."""
        self._tracker = tracker
        self._set('tracking', console_panel.tracking(tracker, self._values))

    def show_answer(self, success: bool, sentence: str) -> None:
        """Show the answer to an action to everybody; of a success the first part is enough."""
        if success:
            sentence = sentence.split('; ')[0]
        for client in self.server.get_clients().values():
            client.add_notification('Done' if success else 'Not done', sentence,
                                    auto_close_seconds=8.0 if success else 20.0,
                                    color='green' if success else 'yellow')

    def show_tip(self, position: Array | None) -> None:
        """Show the tip at ``position`` (3,), m, bone frame; None: its place is not known."""
        self.scene.show_tip(position)

    def show_markers(self, markers: Iterable[Marker]) -> None:
        """Draw a complete scene, bone frame; what is not in it disappears."""
        self.scene.show_markers(markers)

    def add_timeline(self, duration: float) -> Timeline:
        """Add the time line of a recording of ``duration``, s."""
        with self._timeline:
            timeline = Timeline(self.server.gui, duration)
        self._timeline.visible = True
        return timeline

    # ---- construction

    def _build(self) -> None:
        gui = self.server.gui
        gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False,
                            brand_color=(108, 182, 255))
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL)
        gui.set_panel_label('Bone registration')
        gui.add_html(console_panel.STYLE)
        self._html: dict[str, Any] = {'verdict': gui.add_html('')}
        self._progress: Any = gui.add_progress_bar(0.0, animated=True, visible=False)
        self._html['tracking'] = gui.add_html('')
        self._add_buttons(often=True)
        self._timeline = gui.add_folder('Recording', visible=False)
        self._html['hints'] = gui.add_html('')
        tabs = gui.add_tab_group()
        for name, label in (('accuracy', 'Accuracy'), ('counters', 'Points'),
                            ('landmarks', 'Landmarks'), ('verification', 'Verify')):
            with tabs.add_tab(label):
                self._html[name] = gui.add_html('')
                if name == 'accuracy':
                    self._html['legend'] = gui.add_html('')
                if name == 'counters':
                    self._strokes = gui.add_folder('Strokes')
        with tabs.add_tab('View'):
            self._add_views()
        if any(not each.often for each in self._actions):
            with tabs.add_tab('More'):
                self._add_buttons(often=False)
        self._refresh()

    def _add_buttons(self, often: bool) -> None:
        gui = self.server.gui
        for action in self._actions:
            if action.often != often:
                continue
            button = gui.add_button(action.label, color=action.color,
                                    icon=getattr(viser.Icon, action.icon), hint=_hint(action))
            button.on_click(partial(self._press, action))
            self._buttons[action.name] = button
            if action.hotkey is not None:
                command = gui.add_command(action.label, hotkey=action.hotkey)
                command.on_trigger(partial(self._press, action))

    def _add_views(self) -> None:
        gui = self.server.gui
        for letters in (('A', 'P', 'L'), ('R', 'S', 'I')):
            group = gui.add_button_group('From', letters)
            group.on_click(lambda event: self._look(event, event.target.value))
        gui.add_button('From the probe', color='gray').on_click(
            lambda event: self._look(event, 'probe'))
        self._alert = gui.add_checkbox('Flash when ready', False)

    def _look(self, event: Any, view: str) -> None:
        if not self.scene.look(event.client, view):
            event.client.add_notification('Not done', 'the place of the bone or tip is not known '
                                          'yet', auto_close_seconds=8.0, color='yellow')

    # ---- actions

    def _press(self, action: Action, _: Any) -> None:
        if action.confirm:
            self._ask(action.label, action.confirm, lambda: self._run(action.name))
        else:
            self.show_answer(*self._run(action.name))

    def _press_drop(self, drop: Callable[[int], tuple[bool, str]], number: int, _: Any) -> None:
        self._ask(f'Exclude stroke {number}', 'This drops the points of the stroke. A pose that '
                  'used them is registered again or withdrawn.', lambda: drop(number))

    def _ask(self, label: str, consequence: str, act: Callable[[], tuple[bool, str]]) -> None:
        """Ask before points are lost."""
        gui = self.server.gui
        modal = gui.add_modal(label)
        with modal:
            gui.add_markdown(consequence)
            yes = gui.add_button(label, color='red')
            no = gui.add_button('Cancel')
        no.on_click(lambda _: modal.close())

        @yes.on_click
        def _(_: Any) -> None:
            modal.close()
            self.show_answer(*act())

    # ---- drawing

    def _refresh(self) -> None:
        values, known = self._values, self._values or {}
        self._set('verdict', console_panel.verdict(values, self._message,
                                                   self._flash and self._alert.value))
        self._set('tracking', console_panel.tracking(self._tracker, values))
        self._set('hints', console_panel.hints(values, self._message))
        self._set('accuracy', console_panel.accuracy(known, self._limits))
        self._set('landmarks', console_panel.landmarks(known, list(self._places.names)))
        self._set('verification', console_panel.verification(known, self._limits))
        self._set('counters', console_panel.counters(known))
        share = known.get('progress', '')
        self._progress.visible = bool(share)
        self._progress.value = 100.0 * float(share or 0.0)
        for name, label in console_panel.labels(known).items():
            if name in self._buttons and self._buttons[name].label != label:
                self._buttons[name].label = label
        self._list_strokes(console_panel.strokes(known))
        self.scene.show_landmarks(self._places, int(known.get('landmarks', '0')))

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
                self._stroke_handles.append(gui.add_html(console_panel.stroke(sentence)))
                if self._drop_stroke is not None:
                    button = gui.add_button(f'Exclude stroke {number}', color='gray')
                    button.on_click(partial(self._press_drop, self._drop_stroke, number))
                    self._stroke_handles.append(button)


def _refuse(_: str) -> tuple[bool, str]:
    return False, 'this page only shows'


def _hint(action: Action) -> str | None:
    return None if action.hotkey is None else f'key {action.hotkey}'
