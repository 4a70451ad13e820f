# SPDX-License-Identifier: Apache-2.0
"""The page of the console in a real browser, without ROS: buttons, layout, and what it requests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import CHROMIUM, MISSING, Watched, open_browser
from playwright.sync_api import Browser, expect

from gsdf_registration.common.result import InputError
from gsdf_registration.visualization import colours
from gsdf_registration.visualization.console_page import ConsolePage
from gsdf_registration.visualization.console_panel import Limits
from gsdf_registration.visualization.console_scene import LandmarkPlaces
from gsdf_registration.visualization.web_access import free_port
from msg_adapters import markers

pytestmark = pytest.mark.timeout(300)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason=MISSING)
STATUS = {'state': 'ready', 'collecting': 'true', 'received': '5', 'kept': '5', 'progress': '0.40',
          'landmarks': '1', 'touch_next': 'touch the rim', 'stroke.2': 'stroke 2: 5 points'}


@pytest.fixture(scope='module')
def browser() -> Iterator[Browser]:
    with open_browser() as browser:
        yield browser


class Operated:
    """A page with a femur, and what is pressed on it."""

    def __init__(self, surface: tuple[np.ndarray, np.ndarray], view_only: bool = False) -> None:
        self.pressed: list[Any] = []
        buttons: dict[str, Any] = {'actions': ()} if view_only else {
            'run': self._press, 'drop_stroke': self._press}
        self.page = ConsolePage(**buttons, port=free_port())
        vertices, faces = surface
        touch, normal = vertices[:1], np.array([[0.0, -1.0, 0.0]])
        self.page.show_status(STATUS, 'enough points; register now; the clock is late')
        self.page.show_settings(Limits(0.002, 0.002, 0.002),
                                LandmarkPlaces(('tip', 'neck'), ((0.0, 0.0, 0.0),) * 2))
        self.page.show_markers([
            *markers.bone(vertices, faces, np.tile(colours.rgb(colours.ERROR[0]),
                                                   (len(vertices), 1))),
            *markers.patches(touch, normal, 0.008, ['1: 0.4 mm'], colours.rgb(colours.NEXT))])
        self.url = f'http://127.0.0.1:{self.page.port}'

    def _press(self, what: Any) -> tuple[bool, str]:
        self.pressed.append(what)
        return True, f'{what} was pressed'


@contextmanager
def operated(surface: tuple[np.ndarray, np.ndarray], view_only: bool = False) -> Iterator[Operated]:
    given = Operated(surface, view_only)
    yield given
    given.page.stop()


@needs_chromium
def test_buttons_act_and_ask_before_anything_is_lost(
        femur_surface: tuple[np.ndarray, np.ndarray], browser: Browser, tmp_path: Path) -> None:
    with operated(femur_surface) as given:
        watched = Watched(browser, given.url, 390, 844)
        for text in ('Ready to register', 'Enough points', 'The clock is late', 'Touch the rim'):
            watched.shows(text)
        expect(watched.page.get_by_role('progressbar')).to_be_visible()
        watched.press('Register')
        watched.shows('register was pressed')
        watched.page.keyboard.press('u')
        watched.shows('undo was pressed')
        watched.open('More')
        watched.press('Clear')
        watched.shows('This drops all points')
        assert given.pressed == ['register', 'undo']
        watched.press('Cancel')
        watched.open('Points')
        watched.press('Exclude stroke 2')
        watched.shows('This drops the points of the stroke')
        watched.press('Exclude stroke 2')
        watched.shows('2 was pressed')
        assert given.pressed == ['register', 'undo', 2]
        # a gloved finger needs 44 px, and the panel leaves room for the picture
        heights = [each['height'] for each in map(
            lambda button: button.bounding_box(), watched.page.get_by_role('tab').all()
            + [watched.page.get_by_role('button', name='Register', exact=True)]) if each]
        assert min(heights) >= 44.0
        assert watched.bright_pixels(tmp_path / 'phone.png') > 1000, 'the canvas is blank'
        canvas = watched.page.locator('canvas').last.bounding_box()
        sheet = watched.page.locator('.mantine-Paper-root').filter(
            has=watched.page.locator('.gsdf')).first.bounding_box()
        assert canvas and sheet and canvas['y'] + canvas['height'] <= sheet['y']
        assert sheet['width'] == 390.0
        assert watched.errors == [] and watched.foreign == []
        watched.page.close()


@needs_chromium
def test_shows_no_buttons_to_those_who_only_view(
        femur_surface: tuple[np.ndarray, np.ndarray], browser: Browser) -> None:
    with operated(femur_surface, view_only=True) as given:
        watched = Watched(browser, given.url, 1280, 800)
        watched.shows('Ready to register')
        watched.open('Points')
        watched.shows('Stroke 2: 5 points')
        for label in ('Register', 'Undo stroke', 'Exclude stroke 2', 'Clear'):
            assert watched.page.get_by_role('button', name=label).count() == 0
        watched.page.close()


def test_a_port_in_use_is_reported() -> None:
    with operated((np.eye(3), np.array([[0, 1, 2]]))) as given, pytest.raises(
            InputError, match=f'port {given.page.port} is in use'):
        ConsolePage(port=given.page.port)
