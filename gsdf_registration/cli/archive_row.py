# SPDX-License-Identifier: Apache-2.0
"""The row of one recording in the table of an archive; runs in a worker process."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration import __version__
from gsdf_registration.cli.archive_jobs import Job, key_of
from gsdf_registration.common.result import InputError

if TYPE_CHECKING:
    from gsdf_registration.cli.replay_bag import Outcome

Row = dict[str, Any]
# the reason of a row without an answer: a process that died, or an error of the program
CRASHED = 'crashed'
# name -> type; lengths in metres, angles in radians, times in seconds
COLUMNS: dict[str, type] = {
    'bag': str, 'label': str, 'model': str, 'setting': str,
    'reason': str, 'message': str, 'grade': str, 'complete': bool, 'notes': str,
    'received': int, 'used': int, 'inliers': int, 'left_out': int, 'rejected': int,
    'frame_id': str, 'x_m': float, 'y_m': float, 'z_m': float,
    'qx': float, 'qy': float, 'qz': float, 'qw': float,
    'required_p95_m': float, 'bone_p95_m': float, 'predicted_rms_m': float,
    'predicted_max_m': float, 'zone_distance_m': float, 'zone_share': float, 'sigma_m': float,
    'true_required_m': float, 'true_rms_m': float, 'true_max_m': float, 'true_rotation_rad': float,
    'load_s': float, 'search_s': float, 'solve_s': float, 'total_s': float,
    'bag_sha256': str, 'model_file_sha256': str, 'model_sha256': str, 'settings_sha256': str,
    'version': str, 'result': str, 'report': str,
    'places_m': str}
TIMES = ('load_s', 'search_s', 'solve_s', 'total_s')    # the only columns that differ between runs


def empty_row(job: Job) -> Row:
    """Return the row of a job before there is an answer."""
    options = job.options
    return {**dict.fromkeys(COLUMNS), 'bag': job.bag, 'label': options.label,
            'model': options.model, 'setting': options.setting,
            'model_file_sha256': options.model_file_sha256,
            'settings_sha256': options.settings_sha256, 'version': __version__}


def crashed_row(job: Job, message: str) -> Row:
    """Return the row of a job that ended without an answer."""
    return {**empty_row(job), 'reason': CRASHED, 'message': message}


def moved_row(row: Row, job: Job) -> Row:
    """Return the row of a recording for an equal one with another path."""
    moved = {name: value.replace(row['bag'], job.bag) if name in ('message', 'notes') else value
             for name, value in row.items()}
    return {**moved, 'bag': job.bag, 'model': job.options.model}


def hash_of_bag(path: str) -> str:
    """Return the hash of the content of a recording; empty if it cannot be read."""
    from msg_adapters.files import sha256_of
    try:
        return sha256_of(path)
    except OSError:
        return ''


def compute_row(job: Job) -> tuple[str, Row]:
    """
    Register a recording, write its JSON and its report, and return key and row.

    Nothing is raised: an error of any kind is a row with its reason.
    """
    from msg_adapters.files import describe_error
    bag_sha256 = hash_of_bag(job.path)
    key = key_of(job, bag_sha256)
    try:
        row = _row(job, key, bag_sha256)
    except InputError as error:     # as when the folder of the results cannot be written
        row = crashed_row(job, error.message)
    except Exception as error:      # noqa: BLE001 - an error of the program must not end the run
        row = crashed_row(job, f'error of the program, {type(error).__name__}: '
                          f'{describe_error(error)}')
    return key, {**row, 'bag_sha256': bag_sha256}


def _row(job: Job, key: str, bag_sha256: str) -> Row:
    from argparse import Namespace

    from gsdf_registration.cli.outputs import write_json
    from gsdf_registration.cli.replay_bag import replay_bag
    options, output = job.options, Path(job.options.output)
    name = f'{_file_name(job.bag)}-{key[:12]}'
    report = f'reports/{name}.html' if options.args.report is not None else None
    outcome = replay_bag(job.path, Namespace(**{
        **vars(options.args), 'report': None if report is None else str(output / report)}),
        options.threads, bag_sha256)
    # the same text wherever the archive is
    document = json.loads(json.dumps(outcome.document).replace(
        json.dumps(job.path)[1:-1], json.dumps(job.bag)[1:-1]))
    document['config'] |= {'model.path': options.model}
    write_json(str(output / 'results' / f'{name}.json'), document)
    if report is not None and not (output / report).is_file():
        report = None       # unreadable input
    return {**empty_row(job), **values_of(document), **_from_outcome(outcome),
            'result': f'results/{name}.json', 'report': report}


def values_of(document: dict[str, Any]) -> Row:
    """Return the columns that a JSON document of a result has."""
    pose, points, zone = document['bone_pose'], document['points'], document['zone']
    recording = document['recording'] or {'complete': None, 'notes': []}
    row: Row = {
        'reason': document['reason'], 'message': document['message'], 'grade': document['grade'],
        'complete': recording['complete'], 'notes': ' | '.join(recording['notes']),
        'received': points['received'], 'used': points['used'], 'inliers': points['inliers'],
        'left_out': sum(points['left_out'].values()),
        'rejected': sum(document['rejected'].values()),
        'predicted_rms_m': document['predicted_tre_m']['rms'],
        'predicted_max_m': document['predicted_tre_m']['max'], 'sigma_m': document['sigma_m'],
        **{f'{name}_s': document['timing_s'][name] for name in ('load', 'search', 'solve',
                                                                'total')},
        'model_sha256': document['inputs']['model_sha256'], 'version': document['version']}
    if pose is not None:
        row |= {'frame_id': pose['frame_id']}
        row |= dict(zip(('x_m', 'y_m', 'z_m', 'qx', 'qy', 'qz', 'qw'),
                        [*pose['position'], *pose['orientation']]))
    if zone is not None:
        row |= {'zone_distance_m': zone['distance_m'], 'zone_share': zone['bone_share'],
                'bone_p95_m': zone['bone_p95_m'],
                'required_p95_m': _required_p95(zone, document['config']['limits.require'])}
    return row


def _required_p95(zone: dict[str, Any], require: str) -> float | None:
    """Return the largest 95 % error in the part of the bone that `limits.require` names."""
    if zone['p95_m'] and require in ('', 'targets'):
        return max(zone['p95_m'].values())
    return zone['bone_p95_m'] if require == 'bone' else zone['touched_p95_m']


def _from_outcome(outcome: Outcome) -> Row:
    """Return the columns that a JSON document does not have."""
    error, row = outcome.error, Row()
    if error is not None:
        row |= {'true_required_m': outcome.required_error, 'true_rms_m': error.rms_m,
                'true_max_m': error.max_m, 'true_rotation_rad': error.rotation}
    if outcome.places is not None:
        row['places_m'] = json.dumps(outcome.places.round(5).tolist())
    return row


def _file_name(bag: str) -> str:
    """Return a part of the name of a file from the name of a recording."""
    return re.sub(r'[^\w.-]', '_', Path(bag).name)[:64]
