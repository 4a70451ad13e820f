# SPDX-License-Identifier: Apache-2.0
"""A browser without a window that opens the console, and counts what arrives and is drawn."""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from gsdf_registration.common.result import InputError
from msg_adapters.extras import needed

SIZE = (1280, 800)      # px
# drawn by the processor, as there is no graphics card
SOFTWARE_GL = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
               '--enable-unsafe-swiftshader']
BRIGHT = 120            # of 255: only the bone is as bright, in the middle of the view
SHARE = 0.02            # of the middle of the view that the bone covers at least
MIDDLE = {'x': 250, 'y': 200, 'width': 400, 'height': 400}      # px, left of the panel
PATIENCE = 120.0        # s
# counts the batches of messages that the page receives from its worker, and the pictures it draws
COUNTERS = """
window.counted = {batches: 0, pictures: 0};
const Original = window.Worker;
window.Worker = class extends Original {
    constructor(...given) {
        super(...given);
        this.addEventListener('message', () => { window.counted.batches += 1; });
    }
};
const count = () => { window.counted.pictures += 1; requestAnimationFrame(count); };
requestAnimationFrame(count);
"""


class Counts(NamedTuple):
    """Batches of messages and pictures since the page was opened, at a time, s."""

    time: float
    batches: int
    pictures: int


class Console:
    """A page of the console in a browser."""

    def __init__(self, page: Any) -> None:
        self._page = page
        # s, from the start to open it until it has a canvas, and until the bone is visible
        self.framed = self.opened = 0.0

    def open(self, url: str) -> None:
        """Open the page and wait until the bone is visible."""
        start = time.monotonic()
        self._page.goto(url, wait_until='commit')
        self._page.wait_for_selector('canvas', timeout=1e3 * PATIENCE)
        self.framed = time.monotonic() - start
        while not self._bone_is_visible():
            if time.monotonic() - start > PATIENCE:
                raise InputError('the page shows no bone')
        self.opened = time.monotonic() - start

    def _bone_is_visible(self) -> bool:
        from PIL import Image
        picture = Image.open(io.BytesIO(self._page.screenshot(clip=MIDDLE))).convert('RGB')
        return bool((np.asarray(picture).min(axis=2) > BRIGHT).mean() > SHARE)

    def counts(self) -> Counts:
        """Return what has arrived and been drawn so far."""
        found = self._page.evaluate('window.counted')
        return Counts(time.monotonic(), found['batches'], found['pictures'])


@contextmanager
def browser() -> Iterator[Console]:
    """
    Run a browser during the block.

    Raises
    ------
    InputError
        If playwright, Pillow or chromium is not installed.

    """
    api = needed('playwright.sync_api', 'test', 'the benchmark of the console')
    needed('PIL', 'test', 'the benchmark of the console')
    program = next(filter(None, map(shutil.which, ('chromium', 'chromium-browser',
                                                   'google-chrome'))), None)
    if program is None:
        raise InputError('chromium is not installed: apt-get install chromium')
    with api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program, args=SOFTWARE_GL)
        page = chromium.new_page(viewport={'width': SIZE[0], 'height': SIZE[1]})
        page.add_init_script(COUNTERS)
        yield Console(page)
        chromium.close()
