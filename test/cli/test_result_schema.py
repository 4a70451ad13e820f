# SPDX-License-Identifier: Apache-2.0
"""What register and replay write with --json follows docs/result.schema.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from gsdf_registration.cli.main import main
from gsdf_registration.common.result import Reason
from msg_adapters.bag import read_bag

SCHEMA = json.loads((Path(__file__).parents[2] / 'docs/result.schema.json').read_text())
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


@pytest.fixture(autouse=True)
def in_empty_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'cache'))
    monkeypatch.chdir(tmp_path)


def written() -> dict[str, Any]:
    """Return the JSON document that was written, after its check."""
    document: dict[str, Any] = json.loads(Path('out.json').read_text())
    VALIDATOR.validate(document)
    return document


def test_the_schema_is_valid_and_lists_every_reason() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    assert SCHEMA['properties']['reason']['enum'] == [str(reason) for reason in Reason]


def test_results_of_replay_follow_it(bags: Path, hip_bone: Path) -> None:
    command = ['replay', str(bags / 'hip_optical'), '--model', str(hip_bone), '--landmarks',
               str(bags / 'hip_optical.yaml'), '--json', 'out.json']
    assert main(command) == 0
    accepted = written()
    assert accepted['success'] and accepted['grade'] == 'A'
    points = accepted['points']
    assert points['received'] == points['used'] + sum(points['left_out'].values()) + sum(
        accepted['rejected'].values())
    assert main([*command, '--model-unit', 'm']) == 1
    assert written()['reason'] == 'wrong_unit'


def test_results_of_register_follow_it(bags: Path, hip_bone: Path) -> None:
    positions = read_bag(bags / 'hip_optical', ['/probe/tip']).positions
    reasons = []
    for count in (len(positions), 120, 3):
        np.savetxt('points.csv', positions[:count], delimiter=',', header='x,y,z', comments='')
        main(['register', str(hip_bone), 'points.csv', '--unit', 'm', '--json', 'out.json'])
        reasons.append(written()['reason'])
    assert reasons == ['converged', 'ambiguous', 'too_few_points']


@pytest.mark.parametrize('change', [
    {'success': True}, {'reason': 'unknown'}, {'T_tracker_bone': np.eye(4).tolist()},
    {'extra': 1}, {'points': {'received': -1, 'used': 0, 'inliers': 0, 'left_out': {}}}])
def test_a_refusal_with_another_value_does_not_follow_it(
        change: dict[str, Any], hip_bone: Path) -> None:
    Path('points.csv').write_text('x,y,z\n0,0,0\n')
    main(['register', str(hip_bone), 'points.csv', '--unit', 'm', '--json', 'out.json'])
    document = written() | change
    assert not VALIDATOR.is_valid(document)
