# SPDX-License-Identifier: Apache-2.0
"""Wait for what another thread or process does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

PATIENCE = 30.0     # s


def until(condition: Callable[[], Any], *steps: Callable[[], Any]) -> None:
    """Take the steps again and again until a condition holds."""
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        for step in steps:
            step()
