# SPDX-License-Identifier: Apache-2.0
"""``gsdf pivot``: the files it reads, what it prints and writes, and its exit codes."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsdf_registration.cli.main import main
from gsdf_registration.simulation.pivoting import (
    PIVOT_PLACE,
    TIP,
    PivotRecording,
    PoseFaults,
    Turning,
    pivoting,
)
from msg_adapters.bag_writer import BagWriter
from msg_adapters.settings_file import read_config

KEYS = {'schema', 'success', 'reason', 'message', 'tip_m', 'pivot_m', 'covariance',
        'expected_error_m', 'residual_rms_m', 'angle_range_deg', 'angle_ranges_xyz_deg', 'poses',
        'rejected', 'tool'}
NDI_BLOCK = 'Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers'
NDI_ANGLES = 'Frame,Time [sec],Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers'


def record(**options: Any) -> PivotRecording:
    return pivoting(np.random.default_rng(0), 15.0, 20.0, **options)


def write_csv(path: Path, recording: PivotRecording, scale: float = 1e3) -> Path:
    T = recording.T_tracker_body
    rows = np.c_[scale * T[:, :3, 3], Rotation.from_matrix(T[:, :3, :3]).as_quat()]
    np.savetxt(path, rows, delimiter=',', header='tx,ty,tz,qx,qy,qz,qw', comments='')
    return path


def write_ndi(path: Path, recording: PivotRecording, angles: bool = False) -> Path:
    """Write an NDI tracker CSV with an array at rest and the probe."""
    block = NDI_ANGLES if angles else NDI_BLOCK
    lines = [f'Tools,Port 0x01: Array,{block},Port 0x02: Probe,{block}']
    rest = '0,0,0' if angles else '1,0,0,0'
    for i, (stamp, T) in enumerate(zip(recording.stamps, recording.T_tracker_body)):
        turn = Rotation.from_matrix(T[:3, :3])
        x, y, z, w = turn.as_quat()
        words = turn.as_euler('ZYX', degrees=True) if angles else (w, x, y, z)
        values = ','.join(f'{value:.6f}' for value in (*words, *(1e3 * T[:3, 3])))
        lines.append(f'2,Port 0x01: Array,{i},{stamp:.3f},1,OK,{rest},9,9,9,0.1,0,'
                     f'Port 0x02: Probe,{i},{stamp:.3f},1,OK,{values},0.1,0')
    lines.append(f'1,Port 0x02: Probe,{i + 1},{stamp + 1:.3f},1,Missing'
                 + ',' * block.count(','))
    path.write_text('\n'.join(lines) + '\n')
    return path


def write_bag(path: Path, recording: PivotRecording, *topics: str) -> Path:
    with BagWriter(path) as bag:
        for stamp, T in zip(recording.stamps, recording.T_tracker_body):
            for topic in topics:
                bag.write_pose(topic, 1.7e9 + stamp, T, 'camera')
            bag.write_point('/other', 1.7e9 + stamp, T[:3, 3], 'camera')
    return path


def outcome(tmp_path: Path, *args: object) -> tuple[int, dict[str, Any]]:
    status = main(['pivot', *map(str, args), '--json', str(tmp_path / 'out.json')])
    return status, json.loads((tmp_path / 'out.json').read_text())


def assert_tip(document: dict[str, Any]) -> None:
    assert document.keys() == KEYS
    assert document['success'] and document['reason'] == 'converged'
    assert np.linalg.norm(np.subtract(document['tip_m'], TIP)) < 3e-4
    assert np.linalg.norm(np.subtract(document['pivot_m'], PIVOT_PLACE)) < 3e-4
    assert np.shape(document['covariance']) == (3, 3)
    assert 0.0 < document['expected_error_m'] < 5e-4
    assert 0.0 < document['residual_rms_m'] < 1e-3
    assert 40.0 < document['angle_range_deg'] < 70.0
    assert document['poses'] == {'received': 300, 'used': 300}


@pytest.mark.parametrize('unit, scale', [('mm', 1e3), ('m', 1.0)])
def test_finds_the_tip_in_a_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str], unit: str,
                                scale: float) -> None:
    path = write_csv(tmp_path / 'poses.csv', record(), scale)
    status, document = outcome(tmp_path, path, '--unit', unit)
    assert status == 0
    assert_tip(document)
    printed = capsys.readouterr().out
    assert printed.startswith('tip found: expected error 0.2 mm (95 %), 300 of 300 poses')
    assert 'tip in the tool frame' in printed and 'left out' not in printed


def test_units_give_the_same_tip(tmp_path: Path) -> None:
    tips = [outcome(tmp_path, write_csv(tmp_path / 'poses.csv', record(), scale), '--unit',
                    unit)[1]['tip_m'] for unit, scale in (('mm', 1e3), ('m', 1.0))]
    np.testing.assert_allclose(*tips, atol=1e-12)


@pytest.mark.parametrize('angles', [False, True], ids=['quaternions', 'angles'])
def test_finds_the_tip_of_one_of_several_ndi_tools(tmp_path: Path, angles: bool) -> None:
    path = write_ndi(tmp_path / 'ndi.csv', record(), angles)
    status, document = outcome(tmp_path, path, '--unit', 'mm', '--tool', 'probe')
    assert status == 0
    assert document['tool'] == 'Port 0x02: Probe' and document['rejected']['tracking_state'] == 1
    assert_tip(document)


def test_finds_the_tip_in_a_bag(tmp_path: Path) -> None:
    path = write_bag(tmp_path / 'bag', record(), '/tool/pose')
    status, document = outcome(tmp_path, path)
    assert status == 0 and document['tool'] == '/tool/pose'
    assert_tip(document)


def test_takes_the_topic_that_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_bag(tmp_path / 'bag', record(), '/tool/pose', '/array/pose')
    assert main(['pivot', str(path)]) == 2
    error = capsys.readouterr().err
    assert 'choose one with --topic' in error and '/array/pose' in error
    assert_tip(outcome(tmp_path, path, '--topic', '/tool/pose')[1])


def test_json_on_standard_output_leaves_it_to_the_json(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_csv(tmp_path / 'poses.csv', record())
    assert main(['pivot', str(path), '--unit', 'mm', '--json', '-']) == 0
    output = capsys.readouterr()
    assert_tip(json.loads(output.out))
    assert 'tip found' in output.err


def test_a_rejection_has_exit_code_1_and_no_tip(tmp_path: Path) -> None:
    path = write_csv(tmp_path / 'poses.csv', record(turning=Turning(0.0, 0.0)))
    status, document = outcome(tmp_path, path, '--unit', 'mm')
    assert status == 1 and document.keys() == KEYS
    assert document['reason'] == 'stood_still' and not document['success']
    assert document['tip_m'] is None and document['covariance'] is None


def test_a_slip_is_printed_and_the_rest_counted(tmp_path: Path,
                                                capsys: pytest.CaptureFixture[str]) -> None:
    recording = record(faults=PoseFaults(slips=((5.0, 0.008),)))
    path = write_bag(tmp_path / 'bag', recording, '/tool/pose')
    status, document = outcome(tmp_path, path)
    assert status == 0 and document['rejected']['elsewhere'] == 100
    printed = capsys.readouterr().out
    assert 'the tip slipped by 8.' in printed or 'the tip slipped by 7.' in printed
    assert 'poses left out: 100 elsewhere' in printed


def test_invalid_quaternions_are_counted(tmp_path: Path,
                                         capsys: pytest.CaptureFixture[str]) -> None:
    path = write_csv(tmp_path / 'poses.csv', record())
    lines = path.read_text().splitlines()
    lines[5] = ','.join([*lines[5].split(',')[:3], '0,0,0,0'])
    lines[6] = ','.join([*lines[6].split(',')[:3], '0,0,0,1.5'])
    lines[7] = ','.join([*lines[7].split(',')[:3], 'nan,0,0,1'])
    lines[8] = ','.join(['', *lines[8].split(',')[1:]])
    path.write_text('\n'.join(lines))
    status, document = outcome(tmp_path, path, '--unit', 'mm')
    assert status == 0 and document['poses'] == {'received': 300, 'used': 296}
    assert document['rejected']['not_unit'] == 2 and document['rejected']['not_finite'] == 2
    assert 'poses left out: 2 not finite, 2 not unit' in capsys.readouterr().out


@pytest.mark.parametrize('scale, unit, other', [(1e3, 'm', 'mm'), (1.0, 'mm', 'm')])
def test_a_wrong_unit_is_named(tmp_path: Path, scale: float, unit: str, other: str) -> None:
    path = write_csv(tmp_path / 'poses.csv', record(), scale)
    status, document = outcome(tmp_path, path, '--unit', unit)
    assert status == 1 and document['reason'] == 'wrong_unit'
    assert document['message'].endswith(f'use --unit {other}') and document['tip_m'] is None


def test_bad_input_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = record()
    csv = write_csv(tmp_path / 'poses.csv', recording)
    ndi = write_ndi(tmp_path / 'ndi.csv', recording)
    bag = write_bag(tmp_path / 'bag', recording)
    short = tmp_path / 'short.csv'
    short.write_text('tx,ty,tz\n1,2,3\n')
    empty = tmp_path / 'none.csv'
    empty.write_text('tx,ty,tz,qx,qy,qz,qw\n')
    broken = tmp_path / 'broken.csv'
    broken.write_text(csv.read_text().replace(',', ';').replace('.', ','))
    for args, words in [
            ((csv,), 'the unit of the lengths is missing'),
            ((csv, '--unit', 'mm', '--tool', 'x'), 'omit --tool'),
            ((ndi,), 'Port 0x01: Array; Port 0x02: Probe'),
            ((ndi, '--tool', 'saw'), 'Port 0x01: Array; Port 0x02: Probe'),
            ((ndi, '--unit', 'm', '--tool', 'probe'), 'which is in mm'),
            ((ndi, '--topic', '/x'), '--topic does not apply'),
            ((bag,), 'no topics with poses'),
            ((bag, '--topic', '/other'), 'no poses on /other'),
            ((bag, '--tool', 'probe'), '--tool does not apply'),
            ((short, '--unit', 'mm'), 'missing: qx, qy, qz, qw'),
            ((empty, '--unit', 'mm'), 'has no poses'),
            ((broken, '--unit', 'mm'), 'line 2'),
            ((tmp_path / 'nothing',), 'does not exist')]:
        assert main(['pivot', *map(str, args)]) == 2, args
        error = capsys.readouterr().err
        assert words in error and len(error.splitlines()) == 1, (args, error)


def test_writes_the_tip_as_settings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csv, out = write_csv(tmp_path / 'pivot.csv', record()), tmp_path / 'tip.yaml'
    words = ['pivot', str(csv), '--unit', 'mm', '-o', str(out)]
    assert main(words) == 0 and f'tip written to {out}' in capsys.readouterr().out
    assert np.linalg.norm(np.array(read_config(str(out)).probe.tip) - TIP) < 3e-4
    assert main(words) == 0 and 'is kept as' in capsys.readouterr().out
    still = write_csv(tmp_path / 'still.csv', record(turning=Turning(0.0, 0.0)))
    before = out.read_text()
    assert main(['pivot', str(still), '--unit', 'mm', '-o', str(out)]) == 1
    assert out.read_text() == before and 'tip written' not in capsys.readouterr().out
    assert main(['pivot', str(csv), '--unit', 'mm', '-o', str(csv)]) == 2
    assert 'ends with .yaml' in capsys.readouterr().err


def test_another_unit_is_proposed_only_if_it_is_plausible(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # a tool that moves through 0.5 m and never pivots: in mm, it would hardly move at all
    recording = record()
    T = recording.T_tracker_body.copy()
    T[:, :3, 3] = np.random.default_rng(1).uniform(-0.25, 0.25, (len(T), 3))
    moving = dataclasses.replace(recording, T_tracker_body=T)
    path = write_ndi(tmp_path / 'moving.csv', moving)
    assert main(['pivot', str(path), '--tool', 'Probe']) == 1
    output = capsys.readouterr().out
    assert 'no point of the tool stays still' in output and '--unit' not in output
