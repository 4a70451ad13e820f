# SPDX-License-Identifier: Apache-2.0
"""
Who may connect to a page: pages of this machine, and from elsewhere those who know the token.

A browser sends along which page opens a connection (``Origin``, RFC 6454). The connection of the
console presses buttons, so one that a page of another site opens is refused, see `accept_only`.

The page itself is served on the loopback interface. The gate accepts connections from elsewhere,
reads the head of the first request of each, and forwards the connection if the request carries the
token: in the address (``?token=SECRET``), which sets a cookie, or in that cookie.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import importlib.util
import re
import secrets
import socket
import threading
from collections.abc import Iterator
from functools import partial
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from gsdf_registration.common.result import InputError

COOKIE = 'gsdf_token'
MAX_HEAD = 65_536   # bytes
PATIENCE = 10.0     # s, for the head of a request
CHUNK = 65_536      # bytes
# pages of this machine, whatever their port: it may be forwarded
LOCAL = re.compile(r'http://(localhost|127\.0\.0\.1|\[::1\])(:[0-9]+)?')
FORBIDDEN = (b'HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain; charset=utf-8\r\n'
             b'Connection: close\r\n\r\n')
REFUSED = FORBIDDEN + (b'Open this page with ?token=SECRET at the end of the address, as '
                       b'registration_console was started with --token SECRET.\n')
FOREIGN = FORBIDDEN + b'A page of another site may not use this one.\n'


def require_viser() -> None:
    """Raise an `InputError` that says what to install if viser is missing."""
    if importlib.util.find_spec('viser') is None:
        raise InputError('the console needs viser, which is not installed: '
                         "pip install 'gsdf_registration[console]'")


def free_port() -> int:
    """Return a port of this machine that is free at the moment."""
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def accept_only(origin: str | re.Pattern[str]) -> Iterator[None]:
    """
    Let the websocket servers that start in the block accept only connections of these pages.

    websockets can check the origin, but viser has no argument for it. A page of another site could
    else press buttons, also under a name that it has redirected to 127.0.0.1 (DNS rebinding).
    """
    from websockets.asyncio import server
    original: Any = server.serve
    module: Any = server        # its function is replaced for as long as viser starts
    module.serve = partial(original, origins=[origin])
    try:
        yield
    finally:
        module.serve = original


class Gate:
    """
    Forwards connections at ``host`` and ``port`` to a page on this machine.

    Parameters
    ----------
    host, port : where connections are accepted
    token : str
    page_port : int
        Port of the page at 127.0.0.1.
    origin : str
        That the page accepts: a secret, so that nothing passes by the gate, see `accept_only`.

    Raises
    ------
    InputError
        If the address or the token cannot be used.

    """

    def __init__(self, host: str, port: int, token: str, page_port: int, origin: str) -> None:
        if not re.fullmatch(r'[A-Za-z0-9_-]{8,}', token):
            raise InputError('the token must have 8 or more letters, digits, - and _')
        self._token, self._page_port, self._origin = token, page_port, origin
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(
                asyncio.start_server(self._accept, host, port, limit=MAX_HEAD))
        except OSError as error:
            self._loop.close()
            raise InputError(f'the page cannot be served on {host}:{port}: '
                             f'{error.strerror or error}; give another --host or --port') from None
        self._thread = threading.Thread(target=self._loop.run_forever, name='gate', daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Port at which connections are accepted."""
        return int(self._server.sockets[0].getsockname()[1])

    def stop(self) -> None:
        """Accept no more connections and end those that are open."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._server.close()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.closing(writer), contextlib.suppress(
                OSError, asyncio.TimeoutError, asyncio.IncompleteReadError,
                asyncio.LimitOverrunError):
            head = await asyncio.wait_for(reader.readuntil(b'\r\n\r\n'), PATIENCE)
            answer = check_request(head, self._token)
            if answer is not None:
                writer.write(answer)
                await writer.drain()
                return
            page_reader, page_writer = await asyncio.open_connection('127.0.0.1', self._page_port)
            with contextlib.closing(page_writer):
                page_writer.write(with_origin(head, self._origin))
                both = [asyncio.ensure_future(_copy(reader, page_writer)),
                        asyncio.ensure_future(_copy(page_reader, writer))]
                await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
                for one in both:
                    one.cancel()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while chunk := await reader.read(CHUNK):
            writer.write(chunk)
            await writer.drain()


def check_request(head: bytes, token: str) -> bytes | None:
    """
    Return the answer to a request that is not forwarded; None: forward it.

    Parameters
    ----------
    head : bytes
        Request line and headers.
    token : str

    """
    request, *lines = head.decode('latin-1').split('\r\n')
    target = (request.split(' ') + ['', ''])[1]
    given = parse_qs(urlsplit(target).query).get('token', [''])[0]
    if _same(given, token):
        return ('HTTP/1.1 303 See Other\r\nLocation: /\r\n'
                f'Set-Cookie: {COOKIE}={token}; HttpOnly; SameSite=Strict; Path=/\r\n'
                'Content-Length: 0\r\nConnection: close\r\n\r\n').encode()
    headers = {name.lower(): value.strip() for name, colon, value in (
        line.partition(':') for line in lines) if colon}
    try:
        cookie = SimpleCookie(headers.get('cookie', '')).get(COOKIE)
    except CookieError:
        cookie = None
    if cookie is None or not _same(cookie.value, token):
        return REFUSED
    # the cookie is sent for pages of every port of this host
    origin = urlsplit(headers.get('origin', '')).netloc
    return None if origin in ('', headers.get('host')) else FOREIGN


def with_origin(head: bytes, origin: str) -> bytes:
    """Return the head of a request with this origin in place of its own."""
    first, *lines = head.split(b'\r\n')
    kept = [line for line in lines if not line.lower().startswith(b'origin:')]
    return b'\r\n'.join([first, f'Origin: {origin}'.encode(), *kept])


def secret_origin() -> str:
    """Return an origin that no page has and nobody can guess."""
    return f'http://{secrets.token_hex(16)}.invalid'


def _same(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())
