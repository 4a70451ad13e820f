# SPDX-License-Identifier: Apache-2.0
"""Loads the bone model and the kernels for the node, and logs the warnings."""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rclpy.impl.rcutils_logger import RcutilsLogger

from gsdf_registration.common.config import Config
from gsdf_registration.common.kernel_cache import kernels_compiled
from gsdf_registration.common.result import InputError, Reason
from gsdf_registration.common.settings_schema import shortened
from gsdf_registration.field import Field
from gsdf_registration.field.model import find_model, load_model
from gsdf_registration.node.memory import release_compiler
from gsdf_registration.registration.kernels import compile_kernels, load_kernels

COMPILATION = 0.9   # share of the time that the kernels take, if they are compiled
Show = Callable[[float, str], None]


def load(config: Config, log: RcutilsLogger,
         show: Show = lambda share, sentence: None) -> Field | None:
    """
    Return the field of ``model.path``; if that is empty, log a warning and return None.

    It runs in the background; ``show`` receives how far it is, 0 to 1, and a sentence on what is
    being done.

    Raises
    ------
    InputError
        As `load_model`; reason `no_model` or `wrong_unit`.

    """
    path = config.model.path
    if not path:
        log.warning('no bone model: model.path is empty; points are still collected')
        return None
    _find(path)     # before a minute of compilation
    with _no_collection(), _warnings_to(log):
        _compile(show)
        log.info(f'loading {path}')
        show(COMPILATION, f'loading {path}; wait a moment')
        field = _load(config)
        load_kernels()
        release_compiler()
    log.info(f'{path} is loaded')
    return field


def _find(path: str) -> None:
    try:
        find_model(path)
    except InputError as error:
        raise InputError(error.message, Reason.NO_MODEL) from None


def _load(config: Config) -> Field:
    model = config.model
    try:
        return load_model(model.path, model.unit, model.voxel_size, model.label, model.body)
    except InputError as error:
        reason = Reason.NO_MODEL if error.reason is Reason.BAD_INPUT else error.reason
        raise InputError(error.message, reason) from None
    except (MemoryError, OSError, RecursionError) as error:
        raise InputError(f'{shortened(model.path)} cannot be loaded: '
                         f'{error or type(error).__name__}', Reason.NO_MODEL) from None


def _compile(show: Show) -> None:
    """Compile the kernels in other processes, and show the progress."""
    def progress(share: float) -> None:
        show(COMPILATION * share,
             f'compiling, once on this machine ({100.0 * share:.0f} %); wait a moment')
    if not kernels_compiled():
        progress(0.0)
        compile_kernels(progress)


@contextmanager
def _no_collection() -> Iterator[None]:
    """
    Suspend the garbage collection, and make the objects that exist at the end permanent.

    A full collection stops all threads for a tenth of a second or more, and would scan these
    objects again each time.
    """
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


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
