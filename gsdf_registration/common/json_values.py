# SPDX-License-Identifier: Apache-2.0
"""Convert values to plain values for JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Container, Mapping
from enum import Enum
from typing import Any

import numpy as np


def plain(value: Any, without: Container[str] = ()) -> Any:
    """
    Return dataclasses, arrays and enums as dicts, lists and numbers; non-finite numbers as None.

    Fields of dataclasses with a name in ``without`` are omitted.
    """
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {key: plain(item, without) for key, item in vars(value).items()
                if key not in without}
    if isinstance(value, Mapping):
        return {str(key): plain(item, without) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, without) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    return None if isinstance(value, float) and not math.isfinite(value) else value
