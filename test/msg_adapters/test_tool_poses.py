# SPDX-License-Identifier: Apache-2.0
"""Test reading of tool poses from tables, NDI tracker recordings and bags."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsdf_registration.common.result import InputError
from msg_adapters.bag_writer import BagWriter
from msg_adapters.tool_poses import read_tool_poses

# the angles of an NDI tracker CSV: the rotation is Rz Ry Rx
TURN = Rotation.from_euler('ZYX', [90.0, 0.0, 30.0], degrees=True)
ANGLES = """Tools,Port 0x01: Probe,Frame,Time [sec],Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers
1,Port 0x01: Probe,1,2.5,1,OK,90,0,30,100,200,-300,0.1,0
1,Port 0x01: Probe,2,2.6,1,Missing,,,,,,,,0
1,Port 0x01: Probe,3,2.7,1,OK,nan,0,30,100,200,-300,0.1,0
"""


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def table(rows: list[Any], header: str = 'tx,ty,tz,qx,qy,qz,qw,time') -> str:
    return '\n'.join([header, *(','.join(map(str, row)) for row in rows)])


def test_reads_a_table_in_any_order_of_columns(tmp_path: Path) -> None:
    quaternion = TURN.as_quat()
    poses = read_tool_poses(
        write(tmp_path / 'poses.csv', table([[1.5, *quaternion, 100, 200, -300]],
                                            'time,qx,qy,qz,qw,tx,ty,tz')), 'mm')
    np.testing.assert_allclose(poses.T_tracker_body[0, :3, 3], [0.1, 0.2, -0.3])
    np.testing.assert_allclose(poses.T_tracker_body[0, :3, :3], TURN.as_matrix(), atol=1e-12)
    assert poses.stamps is not None and poses.stamps.tolist() == [1.5]
    assert poses.name == 'poses.csv'


def test_a_table_without_times_has_no_stamps(tmp_path: Path) -> None:
    path = write(tmp_path / 'poses.csv', table([[1, 2, 3, 0, 0, 0, 1]], 'tx,ty,tz,qx,qy,qz,qw'))
    assert read_tool_poses(path, 'm').stamps is None


def test_invalid_poses_are_nan_and_counted_by_cause(tmp_path: Path) -> None:
    rows = [[0, 0, 1, 0, 0, 0, 1, 1], [0, 'nan', 1, 0, 0, 0, 1, 2], [0, 0, 1, 0, 0, 0, 2, 3]]
    poses = read_tool_poses(write(tmp_path / 'poses.csv', table(rows)), 'm')
    assert np.isnan(poses.T_tracker_body).all(axis=(1, 2)).tolist() == [False, True, True]
    assert poses.rejected == {'not_finite': 1, 'not_unit': 1}


def test_reads_the_angles_of_an_ndi_file(tmp_path: Path) -> None:
    poses = read_tool_poses(write(tmp_path / 'ndi.csv', ANGLES))
    np.testing.assert_allclose(poses.T_tracker_body[0, :3, :3], TURN.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(poses.T_tracker_body[0, :3, 3], [0.1, 0.2, -0.3])
    assert np.isnan(poses.T_tracker_body[1]).all()
    assert poses.stamps is not None and poses.stamps.tolist() == [2.5, 2.7]
    assert poses.rejected == {'not_finite': 1, 'not_unit': 0, 'tracking_state': 1}
    assert poses.name == 'Port 0x01: Probe'


def test_reads_the_only_topic_with_poses_of_a_bag(tmp_path: Path) -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = TURN.as_matrix(), [0.1, 0.2, -0.3]
    with BagWriter(tmp_path / 'bag') as bag:
        bag.write_pose('/tool', 5.0, T, 'camera')
        bag.write_point('/tip', 5.0, T[:3, 3], 'camera')
    poses = read_tool_poses(tmp_path / 'bag')
    np.testing.assert_allclose(poses.T_tracker_body[0], T, atol=1e-12)
    assert poses.stamps is not None and poses.stamps.tolist() == [5.0] and poses.name == '/tool'


@pytest.mark.parametrize(('name', 'text', 'options', 'message'), [
    ('poses.csv', table([[0, 0, 1, 0, 0, 0, 1, 1]]), {}, 'the unit of the lengths is missing'),
    ('poses.csv', 'tx,ty,tz\n1,2,3\n', {'unit': 'm'}, 'missing: qx, qy, qz, qw'),
    ('poses.csv', table([]), {'unit': 'm'}, 'has no poses'),
    ('poses.csv', table([[0, 0, 1, 0, 0, 0, 1, 1]]), {'unit': 'm', 'tool': 'Probe'},
     'omit --tool and --topic'),
    ('ndi.csv', ANGLES, {'unit': 'm'}, 'use --unit mm'),
    ('ndi.csv', ANGLES, {'topic': '/tool'}, '--topic does not apply'),
    ('ndi.csv', ANGLES.replace('Rz,Ry,Rx', 'A,B,C'), {}, 'has no orientation'),
    ('ndi.csv', ANGLES.replace(',90,0,30', ',90,x,30'), {},
     "line 2: the state is OK but Ry is 'x'"),
])
def test_message_names_the_defect(tmp_path: Path, name: str, text: str, options: dict[str, str],
                                  message: str) -> None:
    with pytest.raises(InputError) as caught:
        read_tool_poses(write(tmp_path / name, text), **options)
    assert message in caught.value.message and '\n' not in caught.value.message
