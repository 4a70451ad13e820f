# SPDX-License-Identifier: Apache-2.0
"""Functions that the tests of the runner execute in other processes."""

from __future__ import annotations

import os
import threading
from pathlib import Path

from gsdf_registration.common.result import InputError


def squared(number: int) -> dict[str, int]:
    return {'square': number * number, 'process': os.getpid()}


def noted(job: tuple[Path, int]) -> dict[str, int]:
    """Write a file for each call."""
    folder, number = job
    (folder / f'{number}-{os.getpid()}-{threading.get_ident()}').touch()
    return {'number': number}


def fails_at_three(number: int) -> dict[str, int]:
    if number == 3:
        raise InputError('three is not allowed')
    return {'number': number}


def dies_at_three(number: int) -> dict[str, int]:
    if number == 3:
        os._exit(9)
    return {'number': number}


def first_only(number: int) -> dict[str, int]:
    """Return at once for 0, and never for others."""
    if number:
        threading.Event().wait()
    return {'number': number, 'process': os.getpid()}


def environment(name: str) -> dict[str, str | None]:
    return {'value': os.environ.get(name)}
