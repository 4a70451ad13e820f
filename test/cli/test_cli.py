# SPDX-License-Identifier: Apache-2.0
"""``gsdf build``, ``register`` and ``replay``: exit codes, messages, files."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gsdf_registration import __version__
from gsdf_registration.cli.main import SUBCOMMANDS, main
from gsdf_registration.common.rigid import Array, exp, is_rigid, rotation_from_quaternion, transform
from msg_adapters.bag_writer import BagWriter
from msg_adapters.truth import Truth, truth_path, write_truth

T_TRACKER_BONE = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])
LANDMARKS = np.array([[0.03, 0.0, 0.0], [0.0, 0.045, 0.0], [0.0, 0.0, 0.07]])
KEYS = {
    'schema', 'success', 'reason', 'message', 'grade', 'T_tracker_bone', 'bone_pose', 'covariance',
    'points', 'rejected', 'recording', 'sigma_m', 'residual_rms_m', 'predicted_tre_m', 'zone',
    'weakest_direction', 'landmarks', 'ambiguity', 'timing_s', 'inputs', 'config', 'version'
}
HEADER = 'name,model_x,model_y,model_z,tracker_x,tracker_y,tracker_z\n'


def gsdf(*args: object, **more: object) -> subprocess.CompletedProcess[str]:
    """Run the command in a separate process."""
    return subprocess.run([sys.executable, '-m', 'gsdf_registration', *map(str, args)],
                          capture_output=True, text=True, timeout=120, **more)


def write_landmarks(path: Path, model: Array, tracker: Array) -> None:
    rows = [f'p{i},{",".join(map(str, 1e3 * a))},{",".join(map(str, 1e3 * b))}\n'
            for i, (a, b) in enumerate(zip(model, tracker))]
    path.write_text(HEADER + ''.join(rows))


@pytest.fixture(scope='module')
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a directory with a bone, points, landmarks and two bags with their truth."""
    root = tmp_path_factory.mktemp('job')
    ball = trimesh.creation.icosphere(subdivisions=4)
    trimesh.Trimesh(1e3 * ball.vertices * [0.03, 0.045, 0.07], ball.faces).export(root / 'bone.ply')
    rng = np.random.default_rng(0)
    points = ball.vertices[rng.choice(len(ball.vertices), 300, replace=False)] * [0.03, 0.045, 0.07]
    touched = transform(T_TRACKER_BONE, points) + rng.normal(0.0, 0.0002, points.shape)
    np.savetxt(root / 'points.csv', 1e3 * touched, delimiter=',', header='x,y,z', comments='')
    tracker = transform(T_TRACKER_BONE, LANDMARKS) + 0.002
    write_landmarks(root / 'landmarks.csv', LANDMARKS, tracker)
    (root / 'coarse.yaml').write_text('model:\n  voxel_size: 0.002\n')
    for name in ('bag_a', 'bag_b'):
        with BagWriter(root / name) as bag:
            for i, point in enumerate(touched):
                bag.write_point('/probe/tip', 1.7e9 + i, point, 'camera')
        write_truth(truth_path(root / name), Truth('bone.ply', 'mm', 'camera', T_TRACKER_BONE,
                                                   ('x', 'y', 'z'), LANDMARKS, tracker))
    return root


@pytest.fixture(autouse=True)
def in_job_directory(job: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in that directory, with a separate cache."""
    monkeypatch.setenv('GSDF_CACHE_DIR', str(job / 'cache'))
    monkeypatch.setenv(
        'PYTHONPATH',
        os.pathsep.join(filter(None, [os.environ.get('PYTHONPATH'),
                                      str(Path(__file__).parents[2])])))
    monkeypatch.chdir(job)


COARSE = ('--config', 'coarse.yaml')
MARKED = ('--landmarks', 'landmarks.csv')
REGISTER = ('register', 'bone.ply', 'points.csv', '--unit', 'mm', *COARSE)


# --- in a separate process

def test_register_end_to_end(job: Path) -> None:
    done = gsdf(*REGISTER, *MARKED, '--json', 'pose.json')
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout.startswith('registered: ') and ' mm' in done.stdout
    outcome = json.loads((job / 'pose.json').read_text())
    assert set(outcome) == KEYS
    assert (outcome['schema'], outcome['version']) == ('gsdf-registration/2', __version__)
    T = np.array(outcome['T_tracker_bone'])
    assert is_rigid(T)
    assert np.abs(transform(T, LANDMARKS) - transform(T_TRACKER_BONE, LANDMARKS)).max() < 3e-4
    pose = outcome['bone_pose']
    assert set(pose) == {'frame_id', 'position', 'orientation'
                         } and pose['position'] == T[:3, 3].tolist()
    assert rotation_from_quaternion(pose['orientation']) == pytest.approx(T[:3, :3])
    assert np.shape(outcome['covariance']) == (6, 6)
    assert outcome['points']['received'] == outcome['points']['used'] == 300
    assert set(outcome['timing_s']) == {'load', 'search', 'solve', 'total'}
    assert {'rms', 'max'} <= set(outcome['predicted_tre_m'])
    assert all(len(sha) == 64 for sha in outcome['inputs'].values())
    assert outcome['config']['model.path'] == 'bone.ply' and outcome['config'][
        'model.voxel_size'] == 0.002


def test_registers_the_centres_of_a_ball_tip(job: Path, tmp_path: Path) -> None:
    directions = trimesh.creation.icosphere(subdivisions=4).vertices[::8]
    normals = directions / [0.03, 0.045, 0.07]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    centres = directions * [0.03, 0.045, 0.07] + 0.001 * normals
    points = tmp_path / 'centres.csv'
    np.savetxt(points, 1e3 * transform(T_TRACKER_BONE, centres), delimiter=',', header='x,y,z',
               comments='')
    done = gsdf(*(points if word == 'points.csv' else word for word in REGISTER), *MARKED,
                '--tip-radius', 1, '--json', tmp_path / 'pose.json')
    assert (done.returncode, done.stderr) == (0, ''), done.stdout
    outcome = json.loads((tmp_path / 'pose.json').read_text())
    assert outcome['config']['probe.tip_radius'] == 0.001 and outcome['residual_rms_m'] < 1e-4
    T = np.array(outcome['T_tracker_bone'])
    assert np.abs(transform(T, LANDMARKS) - transform(T_TRACKER_BONE, LANDMARKS)).max() < 2e-4


@pytest.mark.parametrize('radius, says', [
    ('-1', 'probe.tip_radius must lie in [0, 0.01] m, not -0.001'),
    ('1500', 'probe.tip_radius must lie in [0, 0.01] m, not 1.5'),
    ('nan', 'probe.tip_radius must be a finite number, not nan')])
def test_rejects_a_radius_that_no_tip_has(capsys: pytest.CaptureFixture[str], radius: str,
                                          says: str) -> None:
    assert says in error_of(capsys, *REGISTER, '--tip-radius', radius)


def test_json_on_standard_output_is_pure_json() -> None:
    done = gsdf(*REGISTER, *MARKED, '--json', '-')
    assert done.returncode == 0 and json.loads(done.stdout)['success'] is True
    assert done.stderr.startswith('registered: ')


def test_unreadable_model_exits_with_2_and_one_line() -> None:
    done = gsdf('register', 'nowhere.ply', 'points.csv', '--unit', 'mm')
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr == 'gsdf: error: nowhere.ply does not exist\n'


def test_bad_usage_exits_with_2_and_one_line() -> None:
    done = gsdf('register', 'bone.ply', 'points.csv', '--unit', 'inch')
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.count('\n') == 1 and done.stderr.startswith('gsdf: error: argument --unit')


def test_replays_several_bags_in_parallel(job: Path) -> None:
    done = gsdf('replay', 'bag_a', 'bag_b', 'nowhere', '--model', 'bone.ply', '--landmarks',
                'bag_a.yaml', '--config', 'coarse.yaml', '--jobs', '2', '--json', 'all.json')
    assert done.returncode == 2 and done.stderr == 'gsdf: error: nowhere does not exist\n'
    a, b, c = json.loads((job / 'all.json').read_text())
    assert a['T_tracker_bone'] == b['T_tracker_bone'] and a['success']
    assert set(c) == KEYS and c['reason'] == 'bad_input' and c['T_tracker_bone'] is None
    assert done.stdout.count('true error') == 2 and done.stdout.startswith('bag_a: registered')


def test_closed_pipe_is_not_an_error() -> None:
    process = subprocess.Popen(
        [sys.executable, '-m', 'gsdf_registration', *REGISTER, *MARKED, '--json', '-'],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    process.stdout.close()
    errors = process.stderr.read().decode()
    assert process.wait(60) == 0 and 'Traceback' not in errors and 'BrokenPipe' not in errors



# --- in this process

def error_of(capsys: pytest.CaptureFixture[str], *args: object) -> str:
    """Return the one line on stderr of a command that exits with 2."""
    try:
        status = main([str(arg) for arg in args])
    except SystemExit as end:
        status = end.code
    out, errors = capsys.readouterr()
    assert status == 2 and out == '' and errors.count('\n') == 1 and errors.startswith(
        'gsdf: error: ')
    return errors


def refusal_of(capsys: pytest.CaptureFixture[str], *args: object) -> dict:
    """Return the JSON of a command that exits with 1; it contains no pose."""
    assert main([str(arg) for arg in args] + ['--json', '-']) == 1
    outcome = json.loads(capsys.readouterr().out)
    assert set(outcome) == KEYS and outcome['success'] is False
    assert outcome['T_tracker_bone'] is outcome['bone_pose'] is outcome['covariance'] is None
    return outcome


@pytest.mark.parametrize('command', [[], ['build'], ['register'], ['replay'], ['import-ndi'],
                                     ['simulate'], ['show'], ['demo']])
def test_help_shows_an_example(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main([*command, '--help'])
    assert end.value.code == 0
    text = capsys.readouterr().out
    assert text.startswith('usage: gsdf')
    assert re.search('examples?:\n  gsdf ' + ''.join(command), text)


def test_help_does_not_import_heavy_libraries() -> None:
    code = ('import sys, gsdf_registration.cli.main as m; m.make_parser(); '
            'print({"numba", "scipy", "trimesh", "rosbags", "rclpy"} & set(sys.modules))')
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, timeout=60)
    assert done.stdout == 'set()\n', done.stderr


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(['--version'])
    assert end.value.code == 0 and capsys.readouterr().out == f'gsdf {__version__}\n'


@pytest.mark.parametrize(('name', 'content', 'option', 'says'), [
    ('a.yaml', 'solver: [', '--config', 'a.yaml, line 1'),
    ('b.yaml', '- 1', '--config', 'b.yaml contains no settings'),
    ('c.yaml', 'solver: {methid: paper}', '--config', 'c.yaml: unknown parameter "solver.methid"'),
    ('d.yaml', 'solver: {cauchy_scale: 7}', '--config', 'd.yaml: solver.cauchy_scale must lie in'),
    ('e.json', '{"T_tracker_bone": ', '--initial', 'e.json, line 1: this is not valid JSON'),
    ('f.json', '{"pose": 1}', '--initial', 'f.json contains no pose'),
    ('g.json', '{"T_tracker_bone": null}', '--initial', 'g.json'),
    ('h.json', json.dumps({'T_tracker_bone': np.diag([2.0, 1, 1, 1]).tolist()
                           }), '--initial', 'not a rigid'),
    ('i.csv', 'name,x\na,1\n', '--landmarks', 'i.csv: landmarks need the columns'),
    ('j.csv', HEADER + 'a,1,2,3,4,5,six\n', '--landmarks', 'j.csv, line 2'),
    ('k.yaml', 'landmarks: []', '--landmarks', 'k.yaml is not a ground truth'),
])
def test_unreadable_options_are_named(job: Path, capsys: pytest.CaptureFixture[str], name: str,
                                      content: str, option: str, says: str) -> None:
    (job / name).write_text(content)
    assert says in error_of(capsys, *REGISTER, option, name)


def test_unreadable_points_are_named(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (job / 'bad.csv').write_text('x,y,z\n1,2,3\n4,five,6\n')
    assert 'bad.csv, line 3' in error_of(capsys, 'register', 'bone.ply', 'bad.csv', '--unit', 'mm')
    assert 'nowhere.csv' in error_of(capsys, 'register', 'bone.ply', 'nowhere.csv', '--unit', 'mm')
    assert '--unit' in error_of(capsys, 'register', 'bone.ply', 'points.csv')
    assert 'pose.json' in error_of(capsys, *REGISTER, *MARKED, '--json', 'no/where/pose.json')


def test_interrupt_exits_quietly(capsys: pytest.CaptureFixture[str],
                                 monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt
    monkeypatch.setattr('gsdf_registration.session.replay.replay_events', interrupted)
    assert main(['replay', 'bag_a', '--model', 'bone.ply', '--config', 'coarse.yaml']) == 130
    assert capsys.readouterr() == ('', '')


@pytest.mark.parametrize(('words', 'says'), [
    ([], 'COMMAND'),
    (['regsiter'], '"regsiter" is not a command; did you mean register?'),
    (['frobnicate'], '"frobnicate" is not a command; choose one of build, register'),
    (['register', '--jsno', 'out.json'], 'unknown option --jsno; did you mean --json?'),
    (['register', '--xyz=1'], 'unknown option --xyz (see gsdf register --help)'),
    (['replay', 'bag_a', '--jobs', '0'], 'argument --jobs: must be 1 or more, not 0'),
    (['replay', 'bag_a', '--jobs', 'two'], 'argument --jobs: "two" is not a whole number'),
    (['build', 'bone.ply', '--voxel', 'big'], 'argument --voxel: "big" is not a number'),
])
def test_bad_usage_says_what_to_do(capsys: pytest.CaptureFixture[str], words: list[str],
                                   says: str) -> None:
    assert says in error_of(capsys, *words)


@pytest.mark.parametrize('columns', ['60', '80', '100'])
@pytest.mark.parametrize('command', SUBCOMMANDS)
def test_help_wraps_between_words(capsys: pytest.CaptureFixture[str],
                                  monkeypatch: pytest.MonkeyPatch, command: str,
                                  columns: str) -> None:
    monkeypatch.setenv('COLUMNS', '1000')
    with pytest.raises(SystemExit):
        main([command.replace('_', '-'), '--help'])
    words = capsys.readouterr().out.split()
    monkeypatch.setenv('COLUMNS', columns)
    with pytest.raises(SystemExit):
        main([command.replace('_', '-'), '--help'])
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= int(columns)
    assert sorted(word for word in text.split() if word != '\\') == sorted(words)


def test_rejects_a_model_in_the_wrong_unit(capsys: pytest.CaptureFixture[str]) -> None:
    for command in (REGISTER, ('replay', 'bag_a', '--model', 'bone.ply')):
        outcome = refusal_of(capsys, *command, '--model-unit', 'm')
        assert outcome['reason'] == 'wrong_unit' and 'bone.ply' in outcome['message']
        assert outcome['inputs']['model_sha256'] is None and len(
            outcome['inputs']['points_sha256']) == 64


def test_rejects_points_in_the_wrong_unit(capsys: pytest.CaptureFixture[str]) -> None:
    outcome = refusal_of(capsys, 'register', 'bone.ply', 'points.csv', '--unit', 'm', *COARSE)
    assert outcome['reason'] == 'wrong_unit'


def test_rejects_landmarks_on_a_line(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = np.linspace([0.0, 0.0, 0.0], [0.06, 0.0, 0.0], 3)
    write_landmarks(job / 'line.csv', line, line)
    outcome = refusal_of(capsys, *REGISTER, '--landmarks', 'line.csv')
    assert outcome['reason'] == 'bad_input' and 'line' in outcome['message']


def test_rejects_too_few_points(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (job / 'few.csv').write_text('x,y,z\n1,2,3\n')
    outcome = refusal_of(capsys, 'register', 'bone.ply', 'few.csv', '--unit', 'mm', *COARSE)
    assert outcome['reason'] == 'too_few_points' and outcome['points']['received'] == 1


def test_ignores_points_that_are_not_finite(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (job / 'holes.csv').write_text((job / 'points.csv').read_text() + 'nan,nan,nan\n')
    assert main(
        ['register', 'bone.ply', 'holes.csv', '--unit', 'mm', *COARSE, *MARKED, '--json', '-']) == 0
    out, errors = capsys.readouterr()
    assert json.loads(out)['points']['received'] == 301
    assert 'rejected       1 not finite' in errors


def test_points_with_stamps_pass_through_a_session(job: Path,
                                                   capsys: pytest.CaptureFixture[str]) -> None:
    points = np.loadtxt(job / 'points.csv', delimiter=',', skiprows=1)
    rows = np.column_stack([np.arange(len(points)), points])
    np.savetxt(job / 'stamped.csv',
               np.vstack([rows, rows[-1]]),
               delimiter=',',
               header='t,x,y,z',
               comments='')
    (job / 'frame.yaml').write_text('model: {voxel_size: 0.002}\nprobe: {frame_id: array}\n')
    assert main([
        'register', 'bone.ply', 'stamped.csv', '--unit', 'mm', '--config', 'frame.yaml', *MARKED,
        '--json', '-'
    ]) == 0
    outcome = json.loads(capsys.readouterr().out)
    assert outcome['points']['received'] == 301 and outcome['points']['used'] == 300
    assert outcome['bone_pose']['frame_id'] == 'array'


def test_a_result_is_accepted_as_initial_guess(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*REGISTER, *MARKED, '--json', 'first.json']) == 0
    assert main([*REGISTER, '--initial', 'first.json', '--json', 'second.json']) == 0
    first, second = (json.loads(Path(name).read_text()) for name in ('first.json', 'second.json'))
    assert np.array(second['T_tracker_bone']) == pytest.approx(np.array(first['T_tracker_bone']),
                                                               abs=1e-5)


def test_replay_prints_the_pose_and_the_true_error(job: Path,
                                                   capsys: pytest.CaptureFixture[str]) -> None:
    command = ['replay', 'bag_a', '--model', 'bone.ply', *COARSE, '--landmarks', 'bag_a.yaml']
    assert main([*command, '--json', 'replay.json']) == 0
    assert 'true error' in capsys.readouterr().out
    outcome = json.loads((job / 'replay.json').read_text())
    assert outcome['bone_pose']['frame_id'] == 'camera' and outcome['points']['received'] == 300
    error = transform(np.array(outcome['T_tracker_bone']), LANDMARKS) - transform(
        T_TRACKER_BONE, LANDMARKS)
    assert np.abs(error).max() < 3e-4


def test_replay_names_unreadable_inputs(capsys: pytest.CaptureFixture[str]) -> None:
    assert 'nowhere' in error_of(capsys, 'replay', 'nowhere', '--model', 'bone.ply')
    assert '/other' in error_of(capsys, 'replay', 'bag_a', '--model', 'bone.ply', '--topic',
                                '/other')
    assert 'nowhere.ply' in error_of(capsys, 'replay', 'bag_a', 'bag_b', '--model', 'nowhere.ply')


def test_register_reads_the_field_that_build_writes(job: Path,
                                                    capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['build', 'bone.ply', '--voxel', '2', '-o', 'bone.gsdf']) == 0
    assert capsys.readouterr().out.startswith('bone.ply: 60 x 90 x 140 mm, field of 2 mm voxels')
    assert main(['register', 'bone.gsdf', 'points.csv', '--unit', 'mm', *MARKED]) == 0


def test_build_reports_errors_in_one_line(job: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert 'bone.ply' in error_of(capsys, 'build', 'bone.ply', '--model-unit', 'm')
    assert 'voxel' in error_of(capsys, 'build', 'bone.ply', '--voxel', '0')
    assert 'no/where' in error_of(capsys, 'build', 'bone.ply', '--voxel', '2', '-o',
                                  'no/where/bone.gsdf')
    (job / 'cut.ply').write_bytes((job / 'bone.ply').read_bytes()[:5000])
    assert 'cut.ply' in error_of(capsys, 'build', 'cut.ply')
