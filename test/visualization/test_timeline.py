# SPDX-License-Identifier: Apache-2.0
"""The clock of a recording: it runs, stops at the end, pauses, and jumps when a viewer asks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from gsdf_registration.visualization.timeline import Timeline


class Control:
    """A slider, button or dropdown."""

    def __init__(self, value: Any, label: str = '') -> None:
        self.value, self.label = value, label

    def on_update(self, callback: Any) -> None:
        self.act = callback

    on_click = on_update


class Gui:
    """The part of viser.GuiApi that is used."""

    def add_slider(self, label: str, low: float, high: float, step: float, value: float) -> Control:
        self.slider = Control(value)
        return self.slider

    def add_button(self, label: str, color: str) -> Control:
        self.button = Control(None, label)
        return self.button

    def add_dropdown(self, label: str, options: Any, initial_value: str) -> Control:
        self.speed = Control(initial_value)
        return self.speed


def test_the_clock_runs_at_its_speed_pauses_and_jumps() -> None:
    gui: Any = Gui()
    clock = Timeline(gui, 10.0)
    assert clock.advance(1.5) == 1.5
    gui.speed.value = '4'
    assert clock.advance(1.0) == 5.5
    clock.show()
    assert gui.slider.value == 5.5
    gui.button.act(None)
    assert clock.advance(1.0) == 5.5 and gui.button.label == 'Play'
    gui.slider.act(SimpleNamespace(client='a viewer', target=SimpleNamespace(value=2.0)))
    assert clock.advance(1.0) == 2.0
    gui.button.act(None)
    assert clock.advance(60.0) == pytest.approx(10.0)


def test_the_clock_ignores_the_slider_that_it_moved_itself() -> None:
    gui: Any = Gui()
    clock = Timeline(gui, 10.0)
    gui.slider.act(SimpleNamespace(client=None, target=SimpleNamespace(value=7.0)))
    assert clock.advance(0.0) == 0.0
