# SPDX-License-Identifier: Apache-2.0
"""A browser without a window for the tests of web pages: Debian's chromium, drawn in software."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from re import Pattern
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, expect, sync_playwright

CHROMIUM = next(filter(None, map(shutil.which, ('chromium', 'chromium-browser',
                                                'google-chrome'))), None)
MISSING = 'chromium is not installed: apt-get install chromium'
SOFTWARE_GL = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
               '--enable-unsafe-swiftshader']
# five frames a second: drawn in software, sixty would take all cores from the tests beside these
FEW_FRAMES = """
window.requestAnimationFrame = draw => setTimeout(() => draw(performance.now()), 200);
window.cancelAnimationFrame = clearTimeout;
"""
PATIENCE = 90_000       # ms: the browser draws without a graphics card


@contextmanager
def open_browser() -> Iterator[Browser]:
    """Run a browser until the end of the block."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE_GL)
        yield browser
        browser.close()


class Watched:
    """A page, its errors, and the requests that leave this machine."""

    def __init__(self, browser: Browser, url: str, width: int, height: int) -> None:
        self.errors: list[str] = []
        self.foreign: list[str] = []
        self.page: Page = browser.new_page(viewport={'width': width, 'height': height})
        self.page.set_default_timeout(PATIENCE)
        self.page.on('console', self._on_console)
        self.page.on('pageerror', lambda error: self.errors.append(str(error)))
        self.page.on('request', self._on_request)
        self.page.add_init_script(FEW_FRAMES)
        self.page.goto(url)

    def _on_console(self, message: Any) -> None:
        if message.type == 'error':
            self.errors.append(message.text)

    def _on_request(self, request: Any) -> None:
        if not request.url.startswith(('http://127.0.0.1', 'ws://127.0.0.1', 'data:', 'blob:')):
            self.foreign.append(request.url)

    def shows(self, text: str | Pattern[str]) -> None:
        """Wait until the page shows a text."""
        expect(self.page.get_by_text(text).first).to_be_visible(timeout=PATIENCE)

    def press(self, label: str) -> None:
        """Press a button."""
        self.page.get_by_role('button', name=label, exact=True).last.click()

    def open(self, tab: str) -> None:
        """Open a tab of the panel."""
        self.page.get_by_role('tab', name=tab).click()

    def picture(self, path: Path) -> np.ndarray:
        """Return a screenshot (h, w, 3)."""
        self.page.screenshot(path=path)
        return np.asarray(Image.open(path).convert('RGB')).astype(int)

    def bright_pixels(self, path: Path) -> int:
        """Return how many pixels of the 3D view are as bright as a bone."""
        box = self.page.locator('canvas').last.bounding_box()
        assert box is not None
        x, y = int(box['x']), int(box['y'])
        view = self.picture(path)[y:y + int(box['height']), x:x + int(box['width'])]
        return int((view.min(axis=2) > 120).sum())
