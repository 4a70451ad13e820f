# SPDX-License-Identifier: Apache-2.0
"""Test reading of NDI tracker recordings."""

from __future__ import annotations

import numpy as np
import pytest

from gsdf_registration.cli.main import make_parser
from gsdf_registration.common.result import InputError
from msg_adapters.bag import read_bag
from msg_adapters.ndi import is_ndi, read_ndi

LABEL = 'Port 0x0A: PROBE-5D  s/n:00C0FFEE Channel:0'
EM = """Tools,LABEL,Frame,Time [sec],Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers
1,LABEL,100,12.000,1,OK,75.4,-47.2,137.1,10.5,-20.25,-30.0,0.08,0
1,LABEL,108,12.025,1,Missing,,,,,,,,0
1,LABEL,116,12.050,1,OK,75.4,-47.2,137.1,11,-20.5,-30.5,0.19,0
1,LABEL,124,12.075,1,DISABLED,0,0,0,0,0,0,0,0
1,LABEL,132,12.100,1,,0,0,0,0,0,0,0,0
1,LABEL,140
""".replace('LABEL', LABEL)
# an optical tracker with two tools and their markers; line 2 lacks a marker of the first tool
BLOCK = ('Frame,Time [sec],Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers,'
         'State,Tx,Ty,Tz,State,Tx,Ty,Tz')
OPTICAL = f"""Tools,Port 0x01: Probe,{BLOCK},Port 0x02: Array,{BLOCK}
2,Port 0x01: Probe,5,1.5,1,OK,1,0,0,0,1,2,3,0.2,2,OK,9,9,9,OK,9,9,9,\
Port 0x02: Array,5,1.5,1,OK,1,0,0,0,4,5,6,0.3,0
2,Port 0x01: Probe,6,1.6,1,OK,1,0,0,0,1,2,4,0.2,1,OK,9,9,9,\
Port 0x02: Array,6,1.6,1,OK,1,0,0,0,4,5,7,0.3,0
2,Port 0x01: Probe,7,1.7,1,Too Few Markers,\
-3.697314E28,-3.697314E28,-3.697314E28,-3.697314E28,-3.697314E28,\
-3.697314E28,-3.697314E28,0,2,OK,9,9,9,OK,9,9,9,Port 0x02: Array,7,1.7,1,OK,1,0,0,0,4,5,8,0.3,0
1,Port 0x02: Array,8,1.8,1,OK,1,0,0,0,4,5,9,0.3,0
"""


def write(path, text):
    path.write_bytes(text.encode())
    return path


def refusal(*args, **options):
    with pytest.raises(InputError) as caught:
        read_ndi(*args, **options)
    assert '\n' not in caught.value.message
    return caught.value.message


def test_reads_valid_samples_and_counts_lost_ones(tmp_path):
    for text in (EM, EM.replace('\n', '\r\n'), '\ufeff' + EM, EM.replace('OK', 'ok')):
        path = write(tmp_path / 'em.csv', text)
        assert is_ndi(path)
        points = read_ndi(path)
        np.testing.assert_allclose(points.positions,
                                   [[0.0105, -0.02025, -0.03], [0.011, -0.0205, -0.0305]])
        np.testing.assert_allclose(points.quality, [0.00008, 0.00019])
        assert points.stamps.tolist() == [12.0, 12.05]
        assert points.dropped == {'tracking_state': 4}
        assert points.source_names == [LABEL]


def test_reads_each_tool_by_its_label(tmp_path):
    path = write(tmp_path / 'optical.csv', OPTICAL)
    probe, array = read_ndi(path, 'probe'), read_ndi(path, '0x02')
    np.testing.assert_allclose(probe.positions * 1000, [[1, 2, 3], [1, 2, 4]])
    np.testing.assert_allclose(array.positions * 1000, [[4, 5, 6], [4, 5, 7], [4, 5, 8], [4, 5, 9]])
    assert probe.dropped == {'tracking_state': 2} and array.dropped == {}
    assert array.stamps.tolist() == [1.5, 1.6, 1.7, 1.8]


def test_rejects_an_ambiguous_tool(tmp_path):
    path = write(tmp_path / 'optical.csv', OPTICAL)
    for message in (refusal(path), refusal(path, 'port'), refusal(path, 'saw')):
        assert 'Probe' in message and 'Array' in message
    assert "no tools that match 'saw'" in refusal(path, 'saw')


def test_file_without_times_has_no_stamps(tmp_path):
    old = ('Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error\n'
           '1,Port 1,1,1,OK,1,0,0,0,1,2,3,0.1\n')
    assert read_ndi(write(tmp_path / 'old.csv', old)).stamps is None
    blank = EM.replace('12.000', '').replace('12.050', '')
    assert read_ndi(write(tmp_path / 'blank.csv', blank)).stamps is None


def test_reads_files_without_labels(tmp_path):
    bare = ('Tools,Frame,Time [sec],Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers\n'
            '1,9,0.5,1,OK,0,0,0,1,2,3,0.1,0\n')
    points = read_ndi(write(tmp_path / 'bare.csv', bare))
    np.testing.assert_allclose(points.positions, [[0.001, 0.002, 0.003]])
    assert points.stamps.tolist() == [0.5]
    other = EM.replace(f'\n1,{LABEL}', '\n1,10')     # only the number of the port
    assert len(read_ndi(write(tmp_path / 'other.csv', other))) == 2


@pytest.mark.parametrize('text, words', [
    ('x,y,z\n1,2,3\n', 'not an NDI tracker CSV'),
    ('', 'is empty'),
    ('\n\n', 'not an NDI tracker CSV'),
    (EM.splitlines()[0], 'never tracked'),
    (EM.replace('OK', 'Missing'), 'none with State OK'),
    (EM.replace('10.5,', 'ten,'), 'line 2'),
    (EM.replace('10.5,-20.25', '"10,5",-20.25'), 'decimal point'),
    (EM.replace('10.5,-20.25,-30.0', '10.5'), 'line 2'),
    (EM.replace('10.5,-20.25,-30.0', '10,5,-20,25,-30,0'), 'decimal point'),
    (EM.replace('12.050', '12,050').replace('12.000', '12,000'), 'never tracked'),
    (EM.replace('10.5,', ','), 'line 2'),
    (EM.replace('12.050', ''), 'line 4'),
    (EM.replace('Tx,Ty,Tz', 'A,B,C'), 'not an NDI tracker CSV'),
])
def test_message_names_the_defect(tmp_path, text, words):
    path = write(tmp_path / 'bad.csv', text)
    assert words in refusal(path) and 'bad.csv' in refusal(path)


def gsdf(*arguments):
    args = make_parser().parse_args([str(argument) for argument in arguments])
    return args.run(args)


def test_import_ndi_writes_the_tracked_samples(tmp_path, capsys):
    later = EM.replace(',12.', ',13.')
    files = [write(tmp_path / 'b.csv', later), write(tmp_path / 'a.csv', EM)]
    assert gsdf('import-ndi', *files, '-o', tmp_path / 'run', '--frame-id', 'field_generator') == 0
    assert '4 points' in capsys.readouterr().out
    points = read_bag(tmp_path / 'run')
    assert points.stamps.tolist() == [12.0, 12.05, 13.0, 13.05]
    np.testing.assert_array_equal(points.positions[:2], read_ndi(files[1]).positions)
    assert set(points.frame_ids) == {'field_generator'} and points.source_names == ['/probe/tip']


def test_import_ndi_requires_times_and_a_new_path(tmp_path):
    old = ('Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error\n'
           '1,Port 1,1,1,OK,1,0,0,0,1,2,3,0.1\n')
    with pytest.raises(InputError, match='no Time column'):
        gsdf('import-ndi', write(tmp_path / 'old.csv', old), '-o', tmp_path / 'run')
    assert not (tmp_path / 'run').exists()
    with pytest.raises(InputError, match='exists already'):
        gsdf('import-ndi', write(tmp_path / 'em.csv', EM), '-o', tmp_path)
