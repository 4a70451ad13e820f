# SPDX-License-Identifier: Apache-2.0
"""The gate in front of the console: who knows the token passes, others do not."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from gsdf_registration.common.result import InputError
from gsdf_registration.visualization.web_access import (
    COOKIE,
    FOREIGN,
    Gate,
    check_request,
    free_port,
    require_viser,
    secret_origin,
)

TOKEN = 'correct-horse'


class Page(BaseHTTPRequestHandler):
    """A page that shows its path, and the origin that a request names."""

    def do_GET(self) -> None:   # the name that http.server calls
        body = f'page {self.path} {self.headers["Origin"]}'.encode()
        self.send_response(200)
        self.send_header('Content-Length', str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


@pytest.fixture(scope='module')
def gate() -> Iterator[Gate]:
    page = HTTPServer(('127.0.0.1', 0), Page)
    threading.Thread(target=page.serve_forever, daemon=True).start()
    gate = Gate('127.0.0.1', 0, TOKEN, page.server_port, 'http://gate.invalid')
    yield gate
    gate.stop()
    page.shutdown()
    page.server_close()


def get(gate: Gate, path: str, cookie: str = '') -> tuple[int, str, str]:
    """Return status, body and cookie of an answer."""
    connection = HTTPConnection('127.0.0.1', gate.port, timeout=10)
    connection.request('GET', path, headers={'Cookie': cookie} if cookie else {})
    answer = connection.getresponse()
    body, given = answer.read().decode(), answer.getheader('Set-Cookie') or ''
    connection.close()
    return answer.status, body, given


def test_the_token_in_the_address_becomes_a_cookie(gate: Gate) -> None:
    status, _, cookie = get(gate, f'/?token={TOKEN}')
    assert status == 303 and 'HttpOnly' in cookie and 'SameSite=Strict' in cookie
    assert get(gate, '/view', cookie.split(';')[0])[:2] == (200, 'page /view http://gate.invalid')


@pytest.mark.parametrize(('path', 'cookie'), [
    ('/', ''), ('/?token=wrong', ''), ('/', f'{COOKIE}=wrong'), ('/', f'other={TOKEN}'),
    ('/', '=;,"'), (f'/{TOKEN}', '')])
def test_nobody_passes_without_the_token(gate: Gate, path: str, cookie: str) -> None:
    status, body, _ = get(gate, path, cookie)
    assert status == 403 and '?token=SECRET' in body and 'page' not in body.split('Open this')[0]


@pytest.mark.parametrize(('origin', 'answer'), [
    ('http://robot:8080', None), ('http://robot:9000', FOREIGN), ('http://evil.example', FOREIGN)])
def test_a_page_of_another_site_does_not_pass_with_the_cookie(origin: str,
                                                              answer: bytes | None) -> None:
    head = (f'GET / HTTP/1.1\r\nhost: robot:8080\r\nOrigin: {origin}\r\n'
            f'Cookie: {COOKIE}={TOKEN}\r\n\r\n').encode()
    assert check_request(head, TOKEN) == answer


def greeting(port: int, origin: str | None, cookie: str = '') -> str | bytes:
    """Return the first message of a page to a browser that shows a page of ``origin``."""
    import viser
    from websockets.sync.client import connect
    with connect(f'ws://127.0.0.1:{port}', origin=origin,
                 additional_headers={'Cookie': cookie} if cookie else {},
                 subprotocols=[f'viser-v{viser.__version__}']) as socket:
        return socket.recv(timeout=30)


def test_only_pages_of_this_machine_may_press_buttons() -> None:
    pytest.importorskip('viser')
    from websockets.exceptions import InvalidStatus

    from gsdf_registration.visualization.console_page import ConsolePage
    page = ConsolePage(port=free_port())
    try:
        for name in ('localhost', '127.0.0.1'):
            assert greeting(page.port, f'http://{name}:{page.port}')
        # also under a name that leads to 127.0.0.1, and without a page
        for origin in (f'http://evil.example:{page.port}', 'http://localhost.evil.example', 'null',
                       None):
            with pytest.raises(InvalidStatus, match='403'):
                greeting(page.port, origin)
    finally:
        page.stop()


def test_nothing_passes_by_the_gate() -> None:
    pytest.importorskip('viser')
    from websockets.exceptions import InvalidStatus

    from gsdf_registration.visualization.console_page import ConsolePage
    secret = secret_origin()
    page = ConsolePage(port=free_port(), origin=secret)
    gate = Gate('127.0.0.1', 0, TOKEN, page.port, secret)
    try:
        own = f'http://127.0.0.1:{gate.port}'
        assert greeting(gate.port, own, f'{COOKIE}={TOKEN}')
        for port, origin, cookie in ((gate.port, own, ''), (page.port, own, f'{COOKIE}={TOKEN}'),
                                     (gate.port, 'http://evil.example', f'{COOKIE}={TOKEN}')):
            with pytest.raises(InvalidStatus, match='403'):
                greeting(port, origin, cookie)
    finally:
        gate.stop()
        page.stop()


def test_an_incomplete_request_is_not_forwarded() -> None:
    assert check_request(b'\r\n\r\n', TOKEN) is not None


@pytest.mark.parametrize('token', ['', 'short', 'with space', 'sémantique', 'a;b;c;d;e'])
def test_a_token_that_a_cookie_cannot_hold_is_rejected(token: str) -> None:
    with pytest.raises(InputError, match='the token must have 8 or more'):
        Gate('127.0.0.1', 0, token, free_port(), '')


def test_an_address_in_use_is_reported(gate: Gate) -> None:
    with pytest.raises(InputError, match='cannot be served'):
        Gate('127.0.0.1', gate.port, TOKEN, free_port(), '')


def test_says_what_to_install_without_viser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('importlib.util.find_spec', lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'gsdf_registration\[console\]'"):
        require_viser()
