# SPDX-License-Identifier: Apache-2.0
"""What the subcommands share: options, and reading what they name; heavy imports come in use."""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError, Reason, Refusal

if TYPE_CHECKING:
    from gsdf_registration.common.result import RegistrationResult
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field
    from gsdf_registration.session import LandmarkPairs
    from msg_adapters.recording import Recording


def example(text: str) -> dict[str, Any]:
    """Return the parser arguments that show an example below the help."""
    return {
        'epilog': f'example:\n  {text}', 'formatter_class': argparse.RawDescriptionHelpFormatter
    }


def add_registration_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that `register` and `replay` have in common."""
    add_start_options(parser)
    parser.add_argument('--json',
                        metavar='OUT',
                        help='write the outcome as JSON; - for standard output')
    parser.add_argument('--report', metavar='OUT.html', help='write a page to look at: what was '
                        'found, how good it is, the points on the bone (needs the extra "report")')


def add_start_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what a registration starts from."""
    parser.add_argument('--model-unit', choices=('mm', 'm'),
                        help='unit of the lengths in MODEL (default: mm)')
    parser.add_argument(
        '--landmarks',
        metavar='FILE',
        help='touched landmarks for a first guess: CSV with header name,model_x,model_y,'
        'model_z,tracker_x,tracker_y,tracker_z, or the ground truth YAML of a recording')
    parser.add_argument('--initial',
                        metavar='JSON',
                        help='first guess: {"T_tracker_bone": 4x4, metres}')
    parser.add_argument('--config', metavar='YAML', help='settings, as in config/registration.yaml')


def read_config(path: str | None) -> Config:
    """Return the settings of a YAML file, or the defaults."""
    if path is None:
        return Config()
    import yaml

    from msg_adapters.files import read_text
    try:
        values = yaml.safe_load(read_text(path))
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        where = '' if mark is None else f', line {mark.line + 1}'
        raise InputError(f'{path}{where}: this is no valid YAML') from None
    if not isinstance(values, dict):
        raise InputError(f'{path} holds no settings; give sections with names and values, as in '
                         'config/registration.yaml')
    try:
        return Config.from_nested(values)
    except InputError as error:
        raise InputError(f'{path}: {error.message}') from None


def effective_config(args: argparse.Namespace) -> Config:
    """Return the settings of ``--config`` with what the command line says of the model put in."""
    config = read_config(args.config)
    changes = {'model.path': args.model}
    if args.model_unit:
        changes['model.unit'] = args.model_unit
    return config.replaced(changes)


def field_or_refusal(config: Config) -> Field | Refusal:
    """
    Return the bone of the settings, or that its size is not a bone's: an answer, no error.

    Raises
    ------
    InputError
        When the model cannot be read.

    """
    from gsdf_registration.field.model import load_model
    try:
        return load_model(config.model.path, config.model.unit, config.model.voxel_size)
    except InputError as error:
        if error.reason is not Reason.WRONG_UNIT:
            raise
        return error


def read_recording(path: str, config: Config, topics: Sequence[str] | None = None) -> Recording:
    """Return the points of a bag, with the motions by which the settings say to carry them."""
    from msg_adapters.bag import read_bag
    return read_bag(path, topics, config.reference.topic, frames=bool(config.points_frame))


def read_initial(path: str | None) -> Array | None:
    """Return the pose of a JSON file; an outcome written by ``--json`` will do."""
    if path is None:
        return None
    import numpy as np

    from gsdf_registration.common.rigid import is_rigid, orthonormalized
    from msg_adapters.files import read_text
    try:
        T = np.array(json.loads(read_text(path))['T_tracker_bone'], dtype=np.float64)
    except json.JSONDecodeError as error:
        raise InputError(f'{path}, line {error.lineno}: this is no valid JSON') from None
    except (KeyError, TypeError, ValueError, RecursionError):
        raise InputError(
            f'{path} holds no pose; give {{"T_tracker_bone": [4 rows of 4 numbers]}}') from None
    if not is_rigid(T, tolerance=1e-3):
        raise InputError(
            f'{path}: T_tracker_bone is not a rigid motion; give a 4x4 of a rotation and a '
            'translation in metres')
    return orthonormalized(T)


def read_landmark_pairs(path: str | None, model_unit: str, unit: str) -> LandmarkPairs | None:
    """Return model and tracker positions, m, of a landmark CSV in these units or a truth YAML."""
    if path is None:
        return None
    from msg_adapters.points import read_landmarks
    from msg_adapters.truth import read_truth
    if Path(path).suffix.lower() in ('.yaml', '.yml'):
        truth = read_truth(path)
        return truth.landmarks_model, truth.landmarks_tracker
    landmarks = read_landmarks(path, model_unit, unit)
    return landmarks.model, landmarks.tracker


def sha256_of(path: str) -> str:
    """Return the SHA-256 of a file, or of all files of a bag directory in order of their names."""
    root = Path(path)
    digest = hashlib.sha256()
    for file in sorted(p for p in root.iterdir() if p.is_file()) if root.is_dir() else [root]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def require_report(path: str | None) -> None:
    """Say what is missing for ``--report``, if it is wanted, before any work is done."""
    if path is not None:
        from gsdf_registration.visualization import require_plotly
        require_plotly()


def write_report(path: str | None, result: RegistrationResult, field: Field | None, points: Array,
                 document: dict[str, Any], about: Mapping[str, str]) -> None:
    """
    Write a page where ``--report`` says, if it says so.

    ``points`` (n, 3), m, are those the result speaks of, ``document`` is its JSON, and ``about``
    what to tell of the inputs, the model and the points first.
    """
    if path is None:
        return
    from gsdf_registration.visualization import write_report as write
    model, touched = (Path(name).name for name in list(about.values())[:2])
    hashes = {key.replace('_sha256', ' SHA-256'): sha256
              for key, sha256 in document['inputs'].items() if sha256}
    times = {'time to load': f'{document["timing_s"]["load"]:.2f} s'}
    write(path, result, field, points, title=f'{model} from {touched}',
          about={**about, **hashes, **times})


def counts_by_cause(rejected: Mapping[str, int]) -> str:
    """Return counts in words, those of zero left out."""
    return ', '.join(f'{count} {cause.replace("_", " ")}'
                     for cause, count in rejected.items() if count)


@contextmanager
def busy(what: str) -> Iterator[None]:
    """Say on a terminal ``what`` takes a while; silent elsewhere."""
    if not sys.stderr.isatty() or importlib.util.find_spec('rich') is None:
        yield
        return
    from rich.console import Console
    with Console(stderr=True).status(what):
        yield


def write_json(path: str | None, document: Any) -> None:
    """Write a document where ``--json`` says, if it says so; never NaN, which is no JSON."""
    if path is None:
        return
    text = json.dumps(document, indent=1, allow_nan=False) + '\n'
    if path == '-':
        sys.stdout.write(text)
        return
    from msg_adapters.files import write_atomically
    write_atomically(path, text)
