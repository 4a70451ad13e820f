# SPDX-License-Identifier: Apache-2.0
"""Loads the bone model for the node, logs the warnings and compiles the kernels."""

from __future__ import annotations

import gc
import logging
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.field import Field
from gsdf_registration.field.model import load_model
from gsdf_registration.live.warm_pose import WarmPose
from gsdf_registration.registration.pipeline import register
from gsdf_registration.solver import solve


def load(config: Config, log: RcutilsLogger) -> Field | None:
    """
    Return the field of ``model.path``; if that is empty, log a warning and return None.

    Raises
    ------
    InputError
        As `load_model`; reason `no_model` or `wrong_unit`.

    """
    path = config.model.path
    if not path:
        log.warning('no bone model: model.path is empty; points are collected nevertheless')
        return None
    log.info(f'loading {path}')
    try:
        with _warnings_to(log):
            field = load_model(path, config.model.unit, config.model.voxel_size)
    except InputError as error:
        reason = Reason.NO_MODEL if error.reason is Reason.BAD_INPUT else error.reason
        raise InputError(error.message, reason) from None
    _compile(field, config)
    # The objects that exist now are permanent. Without this, each full garbage collection would
    # scan them again and stop all threads for a tenth of a second.
    gc.collect()
    gc.freeze()
    log.info(f'{path} is loaded')
    return field


def _compile(field: Field, config: Config) -> None:
    """Compile all kernels, so that the first registration takes no longer than later ones."""
    points = field.surface_points[::50].astype(np.float64)
    short = config.replaced({'search.rotations': 1, 'search.places': 1, 'search.parts': 0})
    register(points, field, short)
    solution = solve(points, field, np.eye(4), config.solver)
    WarmPose(points, field, solution, config).add(np.tile(points[0], (10, 1)))


class _RosHandler(logging.Handler):
    def __init__(self, log: RcutilsLogger) -> None:
        super().__init__(logging.WARNING)
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        self._log.warning(record.getMessage())


@contextmanager
def _warnings_to(log: RcutilsLogger) -> Iterator[None]:
    """Forward warnings of the package, which are logged without ROS, to the log of the node."""
    package, handler = logging.getLogger('gsdf_registration'), _RosHandler(log)
    package.addHandler(handler)
    try:
        yield
    finally:
        package.removeHandler(handler)
