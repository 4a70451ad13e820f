# SPDX-License-Identifier: Apache-2.0
"""The time line of a recording on the page of the console: pause, speed and jump."""

from __future__ import annotations

import threading
from typing import Any

import viser

SPEEDS = ('0.25', '0.5', '1', '2', '4', '8')


class Timeline:
    """
    The clock of a recording and its controls.

    Parameters
    ----------
    gui : viser.GuiApi
    duration : float, s

    """

    def __init__(self, gui: viser.GuiApi, duration: float) -> None:
        self._duration, self._moment, self._paused = duration, 0.0, False
        self._lock = threading.Lock()
        self._slider: Any = gui.add_slider('Time (s)', 0.0, max(round(duration, 1), 0.1), 0.1,
                                            0.0)
        self._slider.on_update(self._jump)
        self._button = gui.add_button('Pause', color='gray')
        self._button.on_click(self._toggle)
        self._speed = gui.add_dropdown('Speed', SPEEDS, initial_value='1')

    def advance(self, elapsed: float) -> float:
        """Return the time in the recording after ``elapsed`` seconds more, s."""
        with self._lock:
            if not self._paused:
                self._moment = min(self._moment + float(self._speed.value) * elapsed,
                                   self._duration)
            return self._moment

    def show(self) -> None:
        """Show the time on the slider."""
        moment = round(self._moment, 1)
        if self._slider.value != moment:
            self._slider.value = moment

    def _jump(self, event: Any) -> None:
        if event.client is not None:    # else the page itself moved the slider
            with self._lock:
                self._moment = float(event.target.value)

    def _toggle(self, _: Any) -> None:
        with self._lock:
            self._paused = not self._paused
        self._button.label = 'Play' if self._paused else 'Pause'
