# SPDX-License-Identifier: Apache-2.0
"""A process runs during a block, and its output explains an error in it."""

from __future__ import annotations

import sys

import pytest

from gsdf_registration.clients.processes import running
from gsdf_registration.common.result import InputError

SLEEP = [sys.executable, '-c', 'import threading; threading.Event().wait()']


def test_process_ends_with_the_block() -> None:
    with running(SLEEP, 'the node') as process:
        assert process.poll() is None
    assert process.poll() is not None


def test_process_ends_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), running(SLEEP, 'the node') as process:
        raise ZeroDivisionError
    assert process.poll() is not None


def test_error_contains_the_last_lines_of_the_output() -> None:
    with pytest.raises(InputError, match=r'no response; the node printed: b \| c$'), \
            running([sys.executable, '-c', 'print("b"); print("c")'], 'the node') as process:
        process.wait()
        raise InputError('no response')


def test_error_without_output() -> None:
    with pytest.raises(InputError, match='the node printed: nothing'), \
            running([sys.executable, '-c', ''], 'the node') as process:
        process.wait()
        raise InputError('no response')
