# SPDX-License-Identifier: Apache-2.0
"""Test reading of NDI tracker recordings."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from refusals import refusal

from gsdf_registration.cli.main import make_parser
from gsdf_registration.common.result import InputError
from msg_adapters.ndi import is_ndi, read_ndi, read_tools, topic_of
from msg_adapters.points import read_points
from msg_adapters.tool_poses import read_tool_poses

refused = partial(refusal, read_ndi)

LABEL = 'Port 0x0A: PROBE-5D  s/n:00C0FFEE Channel:0'
EM = """Tools,LABEL,Frame,Time [sec],Face,State,Rz,Ry,Rx,Tx,Ty,Tz,Error,Markers
1,LABEL,100,12.000,1,OK,75.4,-47.2,137.1,10.5,-20.25,-30.0,0.08,0
1,LABEL,108,12.025,1,Missing,,,,,,,,0
1,LABEL,116,12.050,1,OK,75.4,-47.2,137.1,11,-20.5,-30.5,0.19,0
1,LABEL,124,12.075,1,DISABLED,0,0,0,0,0,0,0,0
1,LABEL,132,12.100,1,,0,0,0,0,0,0,0,0
1,LABEL,140
""".replace('LABEL', LABEL)
# an optical tracker with two tools and their markers; in line 2 a marker of the first is missing
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
        assert 'are taken as those of the tip; give --tip' in points.notes[0]


def test_reads_each_tool_by_its_label(tmp_path):
    path = write(tmp_path / 'optical.csv', OPTICAL)
    probe, array = read_ndi(path, 'probe'), read_ndi(path, '0x02')
    np.testing.assert_allclose(probe.positions * 1000, [[1, 2, 3], [1, 2, 4]])
    np.testing.assert_allclose(array.positions * 1000, [[4, 5, 6], [4, 5, 7], [4, 5, 8], [4, 5, 9]])
    assert probe.dropped == {'tracking_state': 2} and array.dropped == {}
    assert array.stamps.tolist() == [1.5, 1.6, 1.7, 1.8]


def test_rejects_an_ambiguous_tool(tmp_path):
    path = write(tmp_path / 'optical.csv', OPTICAL)
    for message in (refused(path), refused(path, 'port'), refused(path, 'saw')):
        assert 'Probe' in message and 'Array' in message
    assert "no tools that match 'saw'" in refused(path, 'saw')


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
    assert words in refused(path) and 'bad.csv' in refused(path)


SHARED = """#Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,\
Markers,State,Tx,Ty,Tz
2,8700339 s/n:1A,7,Port:10,0,Enabled,1,0,0,0,1,2,3,0.1,2,OK,9,9,9,Missing,,,,\
8700449 s/n:2B,7,Port:11,0,Enabled,0,1,0,0,4,5,6,0.2,0
2,8700339 s/n:1A,8,Port:10,0,Missing,,,,,,,,,0,8700449 s/n:2B,8,Port:11,0,Enabled,0,1,0,0,4,5,7,\
0.2,1,OK,9,9,9
2,8700339 s/n:1A,9,Port:10,0,OutOfVolume,1,0,0,0,1,2,4,0.1,0,8700449 s/n:2B,9,Port:11,0,\
PartiallyOutOfVolume,0,1,0,0,4,5,8,0.2,0
"""


def test_reads_the_layout_of_the_combined_api(tmp_path):
    path = write(tmp_path / 'capi.csv', SHARED)
    assert is_ndi(path)
    first, second = read_tools(path, rate=60.0)
    assert (first.label, second.label) == ('8700339 s/n:1A Port:10', '8700449 s/n:2B Port:11')
    np.testing.assert_allclose(first.positions * 1e3, [[1, 2, 3]])
    np.testing.assert_allclose(second.positions * 1e3, [[4, 5, 6], [4, 5, 7]])
    np.testing.assert_allclose(second.stamps, [7 / 60, 8 / 60])
    assert first.dropped == {'tracking_state': 2} and second.dropped == {'tracking_state': 1}
    assert read_ndi(path, 'Port:11').stamps is None


def test_reads_times_in_seconds_and_nanoseconds(tmp_path):
    text = ('#Tools\nToolCount,ToolInfo,Frame#,PortHandle,Face#,timespec_s,timespec_ns,'
            'TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers,Marker0.Status,Tx,Ty,Tz\n'
            '1,id s/n:1,7,Port:10,0,12,500000000,Enabled,1,0,0,0,1,2,3,0.1,1,OK,9,9,9\n')
    assert read_ndi(write(tmp_path / 'times.csv', text)).stamps.tolist() == [12.5]


def test_a_row_with_unknown_values_is_dropped_and_counted(tmp_path):
    lines = EM.splitlines()
    lines.insert(2, lines[1].replace('10.5', '-3.697314E28'))
    lines.insert(3, lines[1].replace('-30.0', '-3.7E+28'))
    lines.insert(4, lines[1].replace('10.5', 'nan'))
    recording = read_ndi(write(tmp_path / 'em.csv', '\n'.join(lines) + '\n'))
    assert len(recording) == 2
    assert recording.dropped == {'not_finite': 3, 'tracking_state': 4}


def test_reads_the_locales_in_which_files_are_saved(tmp_path):
    local = EM.replace(',', ';').replace('.', ',')
    expected = read_ndi(write(tmp_path / 'em.csv', EM))
    for name, content in (
            ('semicolons', local.encode()), ('byte_order_mark', ('\ufeff' + local).encode()),
            ('utf_16', local.replace('\n', '\r\n').encode('utf-16')),
            ('tabs', local.replace(';', '\t').encode()),
            ('windows_1252', EM.replace('PROBE-5D', 'Kn\xf6chel').encode('cp1252'))):
        path = tmp_path / f'{name}.csv'
        path.write_bytes(content)
        assert is_ndi(path), name
        found = read_ndi(path)
        np.testing.assert_allclose(found.positions, expected.positions, err_msg=name)
        np.testing.assert_allclose(found.stamps, expected.stamps, err_msg=name)
        assert found.dropped == expected.dropped, name


def test_tools_of_one_label_are_told_apart_by_their_order(tmp_path):
    path = write(tmp_path / 'twins.csv', OPTICAL.replace('0x02: Array', '0x01: Probe'))
    tools = read_tools(path)
    assert [tool.label for tool in tools] == ['Port 0x01: Probe', 'Port 0x01: Probe (2)']
    np.testing.assert_allclose(tools[1].positions[:2] * 1e3, [[4, 5, 6], [4, 5, 7]])


def test_a_last_line_that_was_cut_is_counted(tmp_path):
    cut = EM[:EM.index('11,-20.5') + 8]
    assert read_ndi(write(tmp_path / 'cut.csv', cut)).dropped == {'tracking_state': 1, 'cut': 1}
    with pytest.raises(InputError, match='line 4'):
        read_ndi(write(tmp_path / 'short.csv', cut + '\n'))


def test_the_rate_gives_the_times_of_a_file_that_has_none(tmp_path):
    bare = EM.replace('12.000', '').replace('12.050', '')
    assert read_ndi(write(tmp_path / 'bare.csv', bare), rate=40.0).stamps.tolist() == [2.5, 2.9]
    assert 'omit --rate' in refused(write(tmp_path / 'em.csv', EM), rate=40.0)
    gap = write(tmp_path / 'gap.csv', bare.replace(',116,', ',,'))
    assert 'line 4: the frame number is missing' in refused(gap, rate=40.0)


def test_points_are_those_of_the_chosen_tool(tmp_path):
    path = write(tmp_path / 'optical.tsv', OPTICAL.replace(',', '\t'))
    np.testing.assert_allclose(read_points(path, 'mm', 'probe').positions * 1e3,
                               [[1, 2, 3], [1, 2, 4]])
    with pytest.raises(InputError, match='several tools; choose one with --tool'):
        read_points(path, 'mm')
    with pytest.raises(InputError, match='is no NDI tracker CSV: omit --tool'):
        read_points(write(tmp_path / 'p.csv', 'x,y,z\n1,2,3\n'), 'mm', 'probe')


def test_topics_are_named_after_the_labels(tmp_path):
    labels = [LABEL, 'Port 1', '8700339 s/n:1A Port:10', 'Port 0x02: Array', 'Port 0x03: Array']
    assert [topic_of(label, labels) for label in labels] == [
        '/probe_5d/measured_cp', '/port_1/measured_cp', '/tool_8700339/measured_cp',
        '/port_0x02_array/measured_cp', '/port_0x03_array/measured_cp']


def gsdf(*arguments):
    args = make_parser().parse_args([str(argument) for argument in arguments])
    return args.run(args)


def test_import_ndi_writes_the_poses_of_every_tool(tmp_path, capsys):
    text = OPTICAL.replace('Port 0x01: Probe,6,1.6,1,OK,1', 'Port 0x01: Probe,6,1.6,1,OK,0.5')
    path = write(tmp_path / 'optical.csv', text)
    assert gsdf('import-ndi', path, '-o', tmp_path / 'run', '--frame-id', 'camera') == 0
    output = capsys.readouterr().out
    assert '/probe/measured_cp: 1 sample of Port 0x01: Probe; left out: 2 tracking state, 1 not ' \
        'unit' in output
    poses = {topic: read_tool_poses(tmp_path / 'run', topic=topic)
             for topic in ('/probe/measured_cp', '/array/measured_cp')}
    assert poses['/probe/measured_cp'].stamps.tolist() == [1.5]
    array = poses['/array/measured_cp']
    np.testing.assert_allclose(array.stamps, [1.5, 1.6, 1.7, 1.8], rtol=1e-12)
    np.testing.assert_allclose(array.T_tracker_body[:, :3, 3] * 1e3,
                               [[4, 5, 6], [4, 5, 7], [4, 5, 8], [4, 5, 9]])


def test_import_ndi_merges_files_by_time(tmp_path, capsys):
    later = EM.replace(',12.', ',13.')
    files = [write(tmp_path / 'b.csv', later), write(tmp_path / 'a.csv', EM)]
    assert gsdf('import-ndi', *files, '-o', tmp_path / 'run', '--topic', '/probe/pose') == 0
    assert '4 samples' in capsys.readouterr().out
    poses = read_tool_poses(tmp_path / 'run')
    assert poses.name == '/probe/pose' and poses.stamps.tolist() == [12.0, 12.05, 13.0, 13.05]
    np.testing.assert_allclose(poses.T_tracker_body[:2, :3, 3], read_ndi(files[1]).positions)


def test_import_ndi_names_what_is_missing(tmp_path):
    old = ('Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error\n'
           '1,Port 1,60,1,OK,1,0,0,0,1,2,3,0.1\n')
    path, run = write(tmp_path / 'old.csv', old), tmp_path / 'run'
    for words, options in (('no Time column, but a bag needs times; .* --rate', []),
                           ('--rate must be a positive number', ['--rate', '0'])):
        with pytest.raises(InputError, match=words):
            gsdf('import-ndi', path, '-o', run, *options)
        assert not run.exists()
    assert gsdf('import-ndi', path, '-o', run, '--rate', '60') == 0
    assert read_tool_poses(run).stamps.tolist() == [1.0]
    with pytest.raises(InputError, match='exists already'):
        gsdf('import-ndi', write(tmp_path / 'em.csv', EM), '-o', tmp_path)
    with pytest.raises(InputError, match='--topic is the topic of one tool'):
        gsdf('import-ndi', write(tmp_path / 'optical.csv', OPTICAL), '-o', tmp_path / 'two',
             '--topic', '/probe/pose')
