# SPDX-License-Identifier: Apache-2.0
"""Read what the command line names; heavy imports are deferred, so that --help is fast."""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from gsdf_registration.common.result import InputError, Reason, Refusal

if TYPE_CHECKING:
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field
    from gsdf_registration.session.operator_replay import Settle
    from msg_adapters.recording import Recording

METRES = {'mm': 1e-3, 'm': 1.0}     # of a unit


def effective_config(args: argparse.Namespace, base: Config | None = None) -> Config:
    """Return ``base`` with the settings of ``--config`` and those that the command line names."""
    from gsdf_registration.common.config import Config
    from msg_adapters.settings_file import read_config
    config = base or Config()
    for path in args.config or ():
        config = read_config(path, config)
    changes: dict[str, Any] = {'model.path': args.model}
    if args.model_unit:
        changes['model.unit'] = args.model_unit
    changes |= {f'model.{name}': getattr(args, name) for name in ('label', 'body')
                if getattr(args, name) is not None}
    if getattr(args, 'tip', None) is not None:
        changes['probe.tip'] = [value * METRES[args.unit] for value in args.tip]
    if getattr(args, 'reference', None) is not None:
        changes['reference.topic'] = args.reference
    if getattr(args, 'tip_radius', None) is not None:
        changes['probe.tip_radius'] = args.tip_radius * METRES[args.unit]
    return config.replaced(changes | getattr(args, 'settings', {}))


def field_or_refusal(config: Config) -> Field | Refusal:
    """
    Return the field of the model for the tip of the probe.

    If the model is not as large as a bone, the refusal is returned.

    Raises
    ------
    InputError
        When the model cannot be read.

    """
    field = timed_field(config)[0]
    return field if isinstance(field, Refusal) else field.for_tip(config.probe.tip_radius)


def timed_field(config: Config) -> tuple[Field | Refusal, float]:
    """
    Return the field of the surface of the model, and the time it took to load, s.

    A process loads the field of a file once, as long as the file does not change.  Errors as in
    `field_or_refusal`.
    """
    from gsdf_registration.field.model import find_model
    model, found = config.model, find_model(config.model.path).stat()
    return _loaded(model.path, model.unit, model.voxel_size, model.label, model.body,
                   (found.st_mtime_ns, found.st_size))


@functools.lru_cache(maxsize=2)
def _loaded(path: str, unit: str, voxel_size: float, label: str, body: str,
            stamp: tuple[int, int]) -> tuple[Field | Refusal, float]:
    """Load a field; ``stamp`` of the file distinguishes its versions."""
    from gsdf_registration.field.model import load_model
    started = time.perf_counter()
    field: Field | Refusal
    try:
        field = load_model(path, unit, voxel_size, label, body)
    except InputError as error:
        if error.reason is not Reason.WRONG_UNIT:
            raise
        field = error
    return field, time.perf_counter() - started


def prepare_kernels(config: Config) -> None:
    """
    Compile the kernels if they are not in the cache.

    This comes before the times of a registration are measured.

    Raises
    ------
    InputError
        If there is no model, before any compilation.

    """
    from gsdf_registration.cli import warm_up
    from gsdf_registration.field.model import find_model
    find_model(config.model.path)
    warm_up.prepare_kernels()


def read_recording(path: str, config: Config, topics: Sequence[str] | None = None,
                   events: str | None = '') -> Recording:
    """
    Return the points of a bag, with the poses of the reference array if the settings ask.

    ``topics``: of the probe; ``events``: of the operator, see `read_bag`.
    """
    from gsdf_registration.common.config import ProbeConfig
    from msg_adapters.bag import read_bag
    if topics is None and config.probe.topics != ProbeConfig().topics:
        topics = config.probe.topics
    return read_bag(path, topics, config.reference.topic, frames=bool(config.points_frame),
                    events=events)


def config_of(recording: Recording, config: Config, settle: Settle) -> Config:
    """Return the settings of a node whose events were recorded, or ``config`` without events."""
    from gsdf_registration.session.operator_replay import recorded_config
    from msg_adapters.recorded_events import settings_of
    if not recording.events:
        return config
    return recorded_config(settings_of([each.event for each in recording.events]), settle)


def read_initial(path: str | None) -> Array | None:
    """
    Return T_tracker_bone (4, 4), m, of a JSON file, or None if there is no file.

    Raises
    ------
    InputError
        If the file cannot be read or does not contain a rigid transform.

    """
    if path is None:
        return None
    import numpy as np

    from gsdf_registration.common.rigid import is_rigid, orthonormalized
    from msg_adapters.files import read_json
    try:
        T = np.array(read_json(path)['T_tracker_bone'], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        raise InputError(
            f'{path} contains no pose; give {{"T_tracker_bone": [4 rows of 4 numbers]}}') from None
    if not is_rigid(T, tolerance=1e-3):
        raise InputError(f'{path}: T_tracker_bone is not a rigid transform; give a 4x4 matrix with '
                         'a rotation and a translation in metres')
    return orthonormalized(T)
