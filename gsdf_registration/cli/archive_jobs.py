# SPDX-License-Identifier: Apache-2.0
"""The jobs of an archive: each recording with each combination of the settings to compare."""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from gsdf_registration import __version__
from gsdf_registration.cli import inputs
from gsdf_registration.cli.archive import Case, find_bags, read_cases
from gsdf_registration.common.result import InputError

# options that a registration depends on, beside its settings and files
VALUES = ('topic', 'events', 'unit', 'model_axes', 'tracker_axes')
# settings that are no property of a registration
FOREIGN = ('model.path', 'session.', 'search.threads')
# options of a whole run
OF_RUN = ('bags', 'cases', 'run', 'sweep', 'scheduler', 'jobs', 'output')


@dataclass(frozen=True)
class Options:
    """
    What jobs have in common.

    args : the options of `replay_bag`, with absolute paths
    model : as it was given
    label : of the case
    setting : of the sweep, as in 'solver.method=paper'; empty without a sweep
    config : all settings, by dotted name
    model_file_sha256 : of the file of the model
    settings_sha256 : of settings, options and their files, and of the version
    output : absolute, folder of the results
    threads : of the search; 0: one per core
    """

    args: argparse.Namespace
    model: str
    label: str
    setting: str
    config: dict[str, Any]
    model_file_sha256: str
    settings_sha256: str
    output: str
    threads: int


@dataclass(frozen=True)
class Job:
    """A recording: the path that was given, the absolute one, and its options."""

    bag: str
    path: str
    options: Options


def jobs_of(args: argparse.Namespace, threads: int) -> list[Job]:
    """
    Return the jobs in the order of the table: by recording, then by setting.

    Raises
    ------
    InputError
        If there is no recording or no model, or a setting is not valid.

    """
    if bool(args.cases) == bool(args.bags):
        raise InputError('give recordings, or a table of them with --cases CSV'
                         + (', not both' if args.cases else ''))
    cases = read_cases(args.cases) if args.cases else [
        Case(bag) for bag in find_bags(args.bags)]
    combinations = settings_of_sweep(args.sweep or [])
    shared: dict[tuple[Any, ...], Options] = {}
    jobs = []
    for case in cases:
        for number, values in enumerate(combinations):
            key = (case.model, case.landmarks, case.config, case.label, number)
            if key not in shared:
                shared[key] = _options(case, values, args, threads)
            jobs.append(Job(_printable(case.bag), _absolute(case.bag), shared[key]))
    return jobs


def settings_of_sweep(texts: Sequence[str]) -> list[dict[str, Any]]:
    """
    Return all combinations of the values to compare, by dotted name.

    ``texts``: as in 'solver.method=mixture,paper', one for each setting.

    Raises
    ------
    InputError
        If a setting is unknown or given twice, or a value is not valid.

    """
    options: dict[str, list[Any]] = {}
    for text in texts:
        name, equals, values = text.partition('=')
        if not equals or not values:
            raise InputError(f'--sweep {text}: give a setting and its values, as in '
                             'solver.method=mixture,paper')
        if name in options:
            raise InputError(f'--sweep {name} is given twice; give all values at once, with commas')
        options[name] = [_value(name, value.strip()) for value in values.split(',')]
    return [dict(zip(options, values)) for values in itertools.product(*options.values())]


def key_of(job: Job, bag_sha256: str) -> str:
    """Return what identifies the content of a row: the hashes of all that it depends on."""
    from msg_adapters.truth import truth_path
    truth = truth_path(job.path)
    options = job.options
    return _hash([bag_sha256, options.model_file_sha256, options.settings_sha256, options.label,
                  options.setting, _hash_of_file(str(truth)) if truth.is_file() else '',
                  options.args.report is not None])[:32]


def _value(name: str, text: str) -> Any:
    """Return a value of a setting; its type is that of the default."""
    from gsdf_registration.common.config import Config
    config = Config()
    default = config.flat().get(name)
    if isinstance(default, list):
        raise InputError(f'--sweep {name}: lists cannot be compared; use --config in two runs, and '
                         'compare the runs')
    try:
        value = ({'true': True, 'false': False}[text] if isinstance(default, bool)
                 else text if default is None else type(default)(text))
    except (KeyError, ValueError):
        value = text        # `replaced` says what is wrong
    return config.replaced({name: value}).flat()[name]


def _options(case: Case, values: Mapping[str, Any], args: argparse.Namespace,
             threads: int) -> Options:
    """Return the options of a case with the values of one combination."""
    from gsdf_registration.field.model import find_model
    model = case.model or args.model
    if not model:
        raise InputError('give the bone with --model MODEL, or in a column "model" of --cases')
    label = args.case if case.label is None else case.label
    config = [*(args.config or ()), *([case.config] if case.config else ())]
    landmarks = [case.landmarks] if case.landmarks else args.landmarks or []
    own = argparse.Namespace(**{
        **{name: value for name, value in vars(args).items() if name not in OF_RUN},
        'model': _absolute(model), 'config': [_absolute(path) for path in config],
        'landmarks': [_absolute(path) for path in landmarks],
        'initial': _absolute(args.initial) if args.initial else None, 'case': label,
        'settings': dict(values)})
    flat = inputs.effective_config(own).flat()
    own_settings = {name: value for name, value in flat.items() if not name.startswith(FOREIGN)}
    files = [_hash_of_file(path) for path in (
        *own.landmarks, *([own.initial] if own.initial else ()))]
    return Options(
        own, model, label, ', '.join(f'{name}={_shown(value)}' for name, value in values.items()),
        flat, _hash_of_file(str(find_model(own.model))),
        _hash([__version__, own_settings, files, {name: getattr(args, name) for name in VALUES}]),
        _absolute(args.output), threads)


def _absolute(path: str) -> str:
    return path if path.startswith('package://') else os.path.abspath(os.path.expanduser(path))


def _printable(path: str) -> str:
    """Return a path as valid text: the name of a file can be any bytes."""
    return path.encode('utf-8', 'backslashreplace').decode()


def _shown(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


@lru_cache(maxsize=4096)
def _hash_of_file(path: str) -> str:
    from msg_adapters.files import sha256_of
    return sha256_of(path)


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
