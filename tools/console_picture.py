# SPDX-License-Identifier: Apache-2.0
"""
Write docs/console.png and docs/console.webp: a registration of bags/hip_optical in the console.

A node, the console and the recorded probe run in a private ROS domain; a browser without a window
shows the page. It needs the extras ros, console and test, and chromium.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, expect, sync_playwright

from gsdf_registration.clients.domain import private_domain
from gsdf_registration.visualization.web_access import free_port

ROOT = Path(__file__).parents[1]
SIZE = {'width': 1280, 'height': 800}
SHRUNK = (800, 500)     # px, of the moving picture
FRAME = 400             # ms, a picture of the moving picture is shown
LAST = 4000             # ms, the last one is shown
PATIENCE = 180_000      # ms
SOFTWARE_GL = ['--no-sandbox', '--use-gl=angle', '--use-angle=swiftshader',
               '--enable-unsafe-swiftshader']


def main() -> None:
    """Write both pictures."""
    port = str(free_port())
    with private_domain() as environment, tempfile.TemporaryDirectory() as folder:
        def start(module: str, *arguments: str) -> subprocess.Popen[bytes]:
            return subprocess.Popen([sys.executable, '-m', f'gsdf_registration.{module}',
                                     *arguments], env=environment, cwd=folder)

        def play() -> subprocess.Popen[bytes]:
            return start('clients.player', str(ROOT / 'bags/hip_optical'), '--topic', '/probe/tip',
                         '--rate', '0.5')
        running = [start('node.main', '--ros-args', '-p', f'model.path:={ROOT}/bags/hip.ply', '-p',
                         'model.unit:=mm'), start('node.console', '--port', port)]
        try:
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=shutil.which('chromium'),
                                                     args=SOFTWARE_GL)
                page = browser.new_page(viewport=SIZE)
                page.set_default_timeout(PATIENCE)
                _open(page, f'http://127.0.0.1:{port}')
                frames = _record(page, play())
                browser.close()
        finally:
            for each in running:
                each.terminate()
                each.wait()
    frames[-1].save(ROOT / 'docs/console.png', optimize=True)
    small = [frame.resize(SHRUNK, Image.Resampling.LANCZOS) for frame in frames]
    small[0].save(ROOT / 'docs/console.webp', save_all=True, append_images=small[1:],
                  duration=[FRAME] * (len(small) - 1) + [LAST], loop=0, quality=60, method=6)


def _open(page: Page, url: str) -> None:
    """Open the page as soon as it is served, and look at the bone from the left."""
    while True:
        try:
            page.goto(url)
            break
        except Exception:       # noqa: BLE001 - the console is not ready yet
            time.sleep(0.5)
    expect(page.get_by_text('Collecting').first).to_be_visible(timeout=PATIENCE)
    page.locator('.mantine-Notification-closeButton').first.click()     # on drawing in software
    page.get_by_role('tab', name='View').click()
    page.get_by_role('button', name=sys.argv[1] if len(sys.argv) > 1 else 'L', exact=True).click()
    page.get_by_role('tab', name='Accuracy').click()
    page.wait_for_timeout(1000)


def _record(page: Page, player: subprocess.Popen[bytes]) -> list[Image.Image]:
    """Register as soon as the recording is played; return pictures, the last one of the result."""
    frames = []
    while player.poll() is None:
        frames.append(_picture(page))
    page.get_by_role('button', name='Register', exact=True).click()
    done = page.get_by_text('Registered: grade').first
    while not done.is_visible():
        frames.append(_picture(page))
    page.wait_for_timeout(9000)     # until the answer has disappeared
    return [*frames, _picture(page)]


def _picture(page: Page) -> Image.Image:
    return Image.open(io.BytesIO(page.screenshot())).convert('RGB')


if __name__ == '__main__':
    main()
