# SPDX-License-Identifier: Apache-2.0
"""Test import of the tool transforms of PLUS recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gsdf_registration.cli.main import main
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import exp
from msg_adapters.plus import read_plus
from msg_adapters.tool_poses import read_tool_poses

SCALE = np.diag([1e3, 1e3, 1e3, 1.0])
POSES = [exp([0.1 * i, -0.2, 0.3, 0.1, 0.02 * i, -0.4]) for i in range(4)]
HEADER = """ObjectType = Image
NDims = 3
DimSize = 4 4 4
ElementType = MET_UCHAR
UltrasoundImageOrientation = MF
"""
STATUS = ['OK', 'OK', 'INVALID', 'OK']


def text_of(T: np.ndarray) -> str:
    return ' '.join(f'{value:.6g}' for value in (SCALE @ T @ np.linalg.inv(SCALE)).ravel())


def fields(separator: str = ' = ') -> str:
    lines = []
    for i, (T, status) in enumerate(zip(POSES, STATUS)):
        prefix = f'Seq_Frame{i:04d}'
        lines += [f'{prefix}_FrameNumber{separator}{100 + i}',
                  f'{prefix}_ReferenceToTrackerTransform{separator}{text_of(np.eye(4))}',
                  f'{prefix}_ReferenceToTrackerTransformStatus{separator}OK',
                  f'{prefix}_StylusToTrackerTransform{separator}{text_of(T)}',
                  f'{prefix}_StylusToTrackerTransformStatus{separator}{status}',
                  f'{prefix}_Timestamp{separator}{0.05 * i:.6f}',
                  f'{prefix}_ImageStatus{separator}OK']
    return '\n'.join(lines) + '\n'


def recording(path: Path, text: str = '') -> Path:
    """Write a recording with a binary image behind the header."""
    body = text or fields(':=' if path.suffix == '.nrrd' else ' = ')
    if path.suffix == '.nrrd':
        content = f'NRRD0004\ntype: uchar\n{body}\n'
    else:
        content = f'{HEADER}{body}ElementDataFile = LOCAL\n'
    path.write_bytes(content.encode() + bytes(range(256)) * 4 + b'\nSeq_Frame0009_Timestamp = x\n')
    return path


@pytest.mark.parametrize('name', ['a.igs.mha', 'a.nrrd'])
def test_reads_the_transforms_of_every_tool(tmp_path: Path, name: str) -> None:
    reference, stylus = read_plus(recording(tmp_path / name))
    assert (reference.label, stylus.label) == ('ReferenceToTracker', 'StylusToTracker')
    assert len(reference) == 4 and stylus.dropped == {'tracking_state': 1}
    assert stylus.stamps is not None and stylus.stamps.tolist() == [0.0, 0.05, 0.15]
    np.testing.assert_allclose(stylus.positions, [POSES[i][:3, 3] for i in (0, 1, 3)], atol=1e-6)


def test_import_writes_a_topic_for_each_tool(tmp_path: Path,
                                             capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['import-plus', str(recording(tmp_path / 'a.mha')), '-o', str(tmp_path / 'bag')
                 ]) == 0
    assert '/stylus/measured_cp: 3 samples of StylusToTracker; left out: 1 tracking state' in \
        capsys.readouterr().out
    poses = read_tool_poses(tmp_path / 'bag', topic='/stylus/measured_cp')
    np.testing.assert_allclose(poses.T_tracker_body, [POSES[i] for i in (0, 1, 3)], atol=1e-5)


def test_a_tool_in_several_frames_has_several_topics(tmp_path: Path) -> None:
    text = fields() + fields().replace('StylusToTracker', 'StylusToReference')
    path = recording(tmp_path / 'a.mha', text)
    assert main(['import-plus', str(path), '-o', str(tmp_path / 'bag')]) == 0
    for topic in ('/stylus_to_tracker/measured_cp', '/stylus_to_reference/measured_cp'):
        assert len(read_tool_poses(tmp_path / 'bag', topic=topic).T_tracker_body) == 3
    assert [tool.label for tool in read_plus(path, 'StylusToRef')] == ['StylusToReference']


@pytest.mark.parametrize(('name', 'text', 'wanted', 'words'), [
    ('a.mha', 'Comment = none\n', None, 'no tool transforms'),
    ('a.mha', '', 'Saw', "no transforms that match 'Saw'"),
    ('a.mha', '', 'Tracker', "2 transforms that match 'Tracker'"),
    ('a.mha', fields().replace('OK', 'INVALID'), None, 'was never tracked (4 frames)'),
    ('a.mha', fields().replace('Timestamp = 0.05', 'Timestamp = x'), None,
     'frame 1: the Timestamp is missing'),
    ('a.mha', fields().replace('ReferenceToTrackerTransform = 1 0', 'ReferenceToTrackerTransform ='
                               ), None, 'frame 0: ReferenceToTrackerTransform is not 16 numbers'),
    ('a.csv', '', None, 'is no recording of PLUS'),
])
def test_message_names_the_defect(tmp_path: Path, name: str, text: str, wanted: str | None,
                                  words: str) -> None:
    with pytest.raises(InputError) as caught:
        read_plus(recording(tmp_path / name, text), wanted)
    assert words in caught.value.message and '\n' not in caught.value.message


def test_a_transform_that_is_no_motion_is_counted(tmp_path: Path) -> None:
    text = fields().replace(f'StylusToTrackerTransform = {text_of(POSES[1])}',
                            'StylusToTrackerTransform = ' + '0 ' * 16)
    stylus = read_plus(recording(tmp_path / 'a.mha', text), 'Stylus')[0]
    assert stylus.dropped == {'not_rigid': 1, 'tracking_state': 1}
