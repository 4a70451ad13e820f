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
# Counts the batches of messages that the page receives from its worker, and the pictures it draws,
# and notes when the bone, by far the largest mesh, has been drawn: a screenshot takes longer.
COUNTERS = """
window.counted = {batches: 0, pictures: 0, bone: 0};
const draw = WebGL2RenderingContext.prototype.drawElements;
WebGL2RenderingContext.prototype.drawElements = function(mode, count, ...given) {
    draw.call(this, mode, count, ...given);
    if (count < 10000 || this.drawn) return;
    this.drawn = this.fenceSync(this.SYNC_GPU_COMMANDS_COMPLETE, 0);
    const look = () => {
        if (this.getSyncParameter(this.drawn, this.SYNC_STATUS) === this.SIGNALED)
            window.counted.bone = performance.timeOrigin + performance.now();
        else
            setTimeout(look, 5);
    };
    setTimeout(look);
};
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

    def open(self, url: str) -> float:
        """
        Open the page and wait until the bone is visible; return the time that took, s.

        Raises
        ------
        InputError
            If the page shows no bone.

        """
        from playwright.sync_api import TimeoutError as Timeout
        start = time.time()
        self._page.goto(url, wait_until='commit')
        try:
            drawn = self._page.wait_for_function('window.counted.bone', timeout=1e3 * PATIENCE)
        except Timeout:
            raise InputError('the page draws no bone') from None
        if not self._bone_is_visible():
            raise InputError('the page shows no bone')
        return 1e-3 * float(drawn.json_value()) - start

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
