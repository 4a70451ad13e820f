# SPDX-License-Identifier: Apache-2.0
"""
The process of the operator's console: a web page for a running registration node.

It uses only the ROS interface of the node, so it may run on another machine, restart, or be opened
twice.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
from typing import TYPE_CHECKING, Any

from gsdf_registration.common.command_line import positive_number
from gsdf_registration.common.result import InputError
from gsdf_registration.visualization.web_access import (
    Gate,
    free_port,
    require_viser,
    secret_origin,
)

if TYPE_CHECKING:
    from gsdf_registration.node.console_link import ConsoleLink
    from gsdf_registration.visualization.console_page import ConsolePage

LOOPBACK = ('127.0.0.1', 'localhost', '::1')
STOP_PATIENCE = 3.0     # s, for the page and its browsers


def main(args: list[str] | None = None) -> int:
    """Run the console until SIGINT or SIGTERM; return 2 if it cannot start."""
    from rclpy.utilities import remove_ros_args
    options = _parse(remove_ros_args(sys.argv if args is None else ['', *args])[1:])
    try:
        require_viser()
        return _run(options, args)
    except InputError as error:
        print(f'registration_console: {error.message}', file=sys.stderr)
        return 2


def _parse(args: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='registration_console',
        description='Serve a page for the operator of a running registration node.')
    parser.add_argument('--node', default='/registration', metavar='NAME',
                        help='name of the node (default: /registration)')
    parser.add_argument('--host', default='127.0.0.1', metavar='ADDRESS',
                        help='address to serve the page on; any but 127.0.0.1 needs --token '
                        '(default: 127.0.0.1)')
    parser.add_argument('--port', type=positive_number, default=8080, metavar='N',
                        help='port of the page (default: 8080)')
    parser.add_argument('--token', default='', metavar='SECRET',
                        help='the page is shown only to those who open it with ?token=SECRET')
    parser.add_argument('--view-only', action='store_true', help='show no buttons')
    parser.add_argument('--model-axes', choices=('lps', 'ras'), default='lps',
                        help='axes of the bone model, for the views A P L R S I (default: lps)')
    return parser.parse_args(args)


def _run(options: argparse.Namespace, args: list[str] | None) -> int:
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    from gsdf_registration.node.console_link import ConsoleLink

    if options.host not in LOOPBACK and not options.token:
        raise InputError(f'--host {options.host} shows the page to other machines: give a --token '
                         'too')
    rclpy.init(args=args)
    link = served = None
    try:
        link = ConsoleLink(options.node)
        served = ServedPage(options, link)
        link.connect(served.page, pedals=not options.view_only)
        executor = SingleThreadedExecutor()
        executor.add_node(link.node)
        signal.signal(signal.SIGTERM, lambda *_: rclpy.try_shutdown())
        print(f'registration_console: open {served.url}', flush=True)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        stopping = threading.Thread(target=_stop, args=(served, link), daemon=True)
        stopping.start()
        stopping.join(STOP_PATIENCE)
        rclpy.try_shutdown()
        if link is not None and served is not None:
            # at once: a thread may wait for the answer of a node that has ended
            sys.stdout.flush()
            os._exit(0)
    return 0


def _stop(*parts: ServedPage | ConsoleLink | None) -> None:
    for part in parts:
        if part is not None:
            part.stop()


class ServedPage:
    """
    The page; with a token, behind a gate.

    Attributes
    ----------
    page : ConsolePage
    url : str
        Address of the page.

    Raises
    ------
    InputError
        If the page cannot be served there.

    """

    def __init__(self, options: argparse.Namespace, link: ConsoleLink) -> None:
        from gsdf_registration.visualization.console_page import ConsolePage

        gated = bool(options.token)
        buttons: dict[str, Any] = {'actions': ()} if options.view_only else {
            'run': link.run, 'drop_stroke': link.drop_stroke}
        ras, origin = options.model_axes == 'ras', secret_origin()
        self.page: ConsolePage = (
            ConsolePage(**buttons, port=free_port(), ras=ras, origin=origin) if gated
            else ConsolePage(**buttons, host=options.host, port=options.port, ras=ras))
        self._gate: Any = None
        port = self.page.port
        if gated:
            try:
                self._gate = Gate(options.host, options.port, options.token, port, origin)
            except InputError:
                self.page.stop()
                raise
            port = self._gate.port
        self.url = f'http://{options.host}:{port}'

    def stop(self) -> None:
        """Stop the page and the gate."""
        if self._gate is not None:
            self._gate.stop()
        self.page.stop()


if __name__ == '__main__':
    sys.exit(main())
