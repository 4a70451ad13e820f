# SPDX-License-Identifier: Apache-2.0
"""
Run a command, such as ``ros2 bag play``, once a node is active; for the launch file.

Run it as ``python -m gsdf_registration.clients.play_when_active NODE COMMAND...``. The node ignores
points until it is active. The command replaces this process, so that one signal ends either.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from collections.abc import Sequence

from gsdf_registration.clients.operator import Operator
from gsdf_registration.common.result import InputError

TIMEOUT = 180.0     # s; on the first start the node compiles its kernels
PERIOD = 0.2        # s between two requests for the state of the node
PATIENCE = 2.0      # s to wait for the answer


def main(args: Sequence[str] | None = None) -> int:
    """Wait and run the command; return 1 if the node does not become active in time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('node', help='fully qualified name, such as /femur/registration')
    parser.add_argument('--timeout', type=float, default=TIMEOUT,
                        help=f'time to wait, s (default: {TIMEOUT:g})')
    parser.add_argument('command', nargs=argparse.REMAINDER, help='command with its arguments')
    options = parser.parse_args(args)
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, lambda *_: os._exit(0))     # at once; there is nothing to clean up
    try:
        wait_until_active(options.node, options.timeout)
        os.execvp(options.command[0], options.command)
    except InputError as error:
        print(error.message, file=sys.stderr)
    except OSError as error:
        print(f'{options.command[0]} cannot be run: {error.strerror}', file=sys.stderr)
    return 1


def wait_until_active(name: str, timeout: float) -> None:
    """Print what is awaited whenever it changes; raise `InputError` after ``timeout`` seconds."""
    deadline, before = time.monotonic() + timeout, ''
    with Operator(name, PATIENCE) as operator:
        while True:
            try:
                found = f'it is {operator.state()}'
            except InputError:
                found = 'it does not answer'
            if found == 'it is active':
                return
            if time.monotonic() > deadline:
                raise InputError(f'{name} did not become active within {timeout:g} s ({found}); '
                                 'nothing is played')
            if found != before:
                print(f'waiting at most {timeout:g} s for {name} to become active: {found}',
                      flush=True)
            before = found
            time.sleep(PERIOD)


if __name__ == '__main__':
    sys.exit(main())
