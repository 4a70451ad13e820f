# SPDX-License-Identifier: Apache-2.0
"""A recording with what the operator did: replayed to the bit, and every sample is counted once."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from page_text import text_of
from recorded_operation import (
    EVENTS,
    START,
    STATUS,
    TIP,
    RecordedOperation,
    held,
    message,
    point_body,
)
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.cli.main import main
from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import from_rt, transform
from gsdf_registration.field.model import load_model
from gsdf_registration.live import LiveStatus
from gsdf_registration.session.status_values import status_values
from msg_adapters.bag import read_bag
from msg_adapters.bag_writer import BagWriter
from msg_adapters.motion import POINT

SETTINGS = Config.from_flat({'collect.automatic': False, 'gate.max_speed': 100.0,
                             'limits.max_error': 0.004})


@pytest.fixture
def empty_operation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> RecordedOperation:
    """Return an operation that begins, with points on the bone to touch."""
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'cache'))
    monkeypatch.chdir(tmp_path)
    field = bone_field()
    trimesh.Trimesh(1e3 * field.vertices, field.faces).export('bone.ply')
    run = RecordedOperation(load_model('bone.ply', 'mm'), SETTINGS)
    run.points = transform(T_TRACKER_BONE, touched_points(700, sigma=0.0002))
    return run


@pytest.fixture
def operation(empty_operation: RecordedOperation) -> RecordedOperation:
    """Return an operation with strokes, an undo, a change of parameters and a registration."""
    run = empty_operation
    points = run.points
    points[450:500] += 0.05         # a stroke beside the bone
    points[620], points[630] = np.nan, points[629]      # not finite, and twice at one place
    run.tip(points[:50])            # before the first stroke
    run.call('collect', data=True)
    run.tip(points[50:450])
    run.call('collect', data=True)
    run.tip(points[450:500])
    run.call('undo')
    run.refuse('register')
    run.call('parameters', **{'gate.min_distance': 0.0001})
    run.call('collect', data=True)
    run.tip(points[500:650])
    run.call('register', T_tracker_bone=T_TRACKER_BONE.tolist())
    run.tip(points[650:])           # after the registration
    return run


def test_an_operation_is_replayed_to_the_bit(operation: RecordedOperation,
                                             capsys: pytest.CaptureFixture[str]) -> None:
    operation.write(Path('run'), {EVENTS: 1.0})
    assert main(['replay', 'run', '--model', 'bone.ply', '--json', 'a.json', '--report',
                 'a.html']) == 0
    out, error = capsys.readouterr()
    document = json.loads(Path('a.json').read_text())
    assert document['recording'] == {'complete': True, 'notes': []} and 'note' not in error
    result = operation.session.status().result
    assert document['T_tracker_bone'] == result.T_tracker_bone.tolist()
    assert document['covariance'] == result.covariance.tolist()
    assert document['config']['limits.max_error'] == 0.004
    points, rejected = document['points'], document['rejected']
    assert points['received'] == result.received == 650 and points['used'] == result.used
    assert rejected == result.rejected
    assert rejected['undone'] >= 40 and rejected['not_collecting'] == 50
    assert rejected['not_finite'] == 1 and rejected['duplicate'] >= 1
    assert_counted(document, out, Path('a.html').read_text(), operation)


def assert_counted(document: dict[str, Any], out: str, page: str, run: RecordedOperation) -> None:
    """Check received = used + left out + rejected everywhere, with the same words."""
    points, rejected = document['points'], document['rejected']
    every = {**points['left_out'], **rejected}
    assert points['received'] == points['used'] + sum(every.values())
    named = {cause: count for cause, count in every.items() if count}
    counts = dict(re.findall(r'^  (points|left out|rejected) +(.*)$', out, re.MULTILINE))
    assert [int(number) for number in re.findall(r'(\d+) (?:received|used)', counts['points'])] == [
        points['received'], points['used']]
    assert {cause.replace(' ', '_'): int(number) for number, cause in re.findall(
        r'(\d+) ([a-z ]+)', f'{counts.get("left out", "")}, {counts.get("rejected", "")}')} == named
    text = text_of(page)
    assert 'not explained' not in text and f'received {points["received"]} ' in text
    for cause, count in named.items():
        word = cause.replace('_', ' ')
        assert f'{word if cause in points["left_out"] else f"rejected: {word}"} {count} ' in text
    status = status_values(run.session.status(), LiveStatus())
    causes = {key.removeprefix('rejected.'): int(count) for key, count in status.items()
              if key.startswith('rejected.')}
    assert int(status['received']) == int(status['kept']) + sum(causes.values())
    assert rejected.keys() <= causes.keys()
    if 'used' in status:        # there is a pose
        left_out = {key.removeprefix('left_out.'): int(count) for key, count in status.items()
                    if key.startswith('left_out.')}
        assert left_out == points['left_out'] and status['used'] == str(points['used'])


def after_drop(run: RecordedOperation) -> None:
    for part in np.split(run.points[:600], 3):
        run.call('collect', data=True)
        run.tip(part)
    run.call('drop_stroke', stroke=2)
    run.call('register', T_tracker_bone=T_TRACKER_BONE.tolist())


def with_losses(run: RecordedOperation) -> None:
    run.call('collect', data=True)
    for row, point in enumerate(run.points[:500]):
        run.tip(point[None])
        if row % 50 == 0:
            run.tip(np.full((2, 3), np.nan))
        if row % 100 == 0:      # of another frame, and late
            run.sample(message(POINT, START + run.time, point_body(point), 'elsewhere'), TIP)
            run.sample(message(POINT, START + run.time - 0.1, point_body(point)), TIP)
    run.call('register', T_tracker_bone=T_TRACKER_BONE.tolist())
    run.session.count_rejected({'lost': 7})     # by the middleware, later


def bad_quaternions(run: RecordedOperation) -> None:
    run.call('parameters', **{'probe.tip': [0.0, 0.0, 0.1]})
    run.call('collect', data=True)
    poses = np.array([from_rt(np.eye(3), point - [0.0, 0.0, 0.1]) for point in run.points[:300]])
    run.tool(poses)
    run.tool(poses[:20], np.array([0.0, 0.0, 0.0, 0.9]))
    run.tool(poses[:5], np.full(4, np.nan))
    run.call('register', T_tracker_bone=T_TRACKER_BONE.tolist())


def in_the_air(run: RecordedOperation) -> None:
    run.call('parameters', **{'collect.air': True})
    run.call('collect', data=True)
    run.tip(run.points[:300])
    run.call('collect', data=False)
    run.tip(run.points[300:400] + T_TRACKER_BONE[:3, 0] * 0.05)
    run.call('register', T_tracker_bone=T_TRACKER_BONE.tolist())


def single_touches(run: RecordedOperation) -> None:
    run.call('collect', data=True)
    rng = np.random.default_rng(0)
    for place in run.points[:60]:
        run.tip(held(place) + rng.normal(0.0, 5e-5, (50, 3)))
        run.tip(place + np.linspace(0.002, 0.02, 10)[:, None] * T_TRACKER_BONE[:3, 0])
    run.call('register', T_tracker_bone=T_TRACKER_BONE.tolist())


def tip_unknown(run: RecordedOperation) -> None:
    run.call('collect', data=True)
    run.tool(np.array([from_rt(np.eye(3), point) for point in run.points[:100]]))
    run.call('register')


@pytest.mark.parametrize(('operate', 'causes'), [
    (after_drop, {'undone'}), (with_losses, {'not_finite', 'wrong_frame', 'not_monotonic'}),
    (bad_quaternions, {'bad_quaternion'}), (in_the_air, {'not_collecting'}),
    (single_touches, {'resting', 'moving'}), (tip_unknown, {'not_used'})])
def test_every_sample_is_counted_once(operate: Callable[[RecordedOperation], None],
                                      causes: set[str], empty_operation: RecordedOperation,
                                      capsys: pytest.CaptureFixture[str]) -> None:
    operate(empty_operation)
    empty_operation.write(Path('run'))
    main(['replay', 'run', '--model', 'bone.ply', '--json', 'a.json', '--report', 'a.html'])
    document = json.loads(Path('a.json').read_text())
    assert document['points']['received'] > 0
    assert causes <= {cause for cause, count in {
        **document['points']['left_out'], **document['rejected']}.items() if count}
    assert_counted(document, capsys.readouterr().out, Path('a.html').read_text(), empty_operation)


def test_other_settings_and_all_points_can_be_replayed(operation: RecordedOperation) -> None:
    operation.write(Path('run'))
    common = ['replay', 'run', '--model', 'bone.ply', '--json', 'a.json']
    Path('other.yaml').write_text('registration:\n  ros__parameters:\n    gate: '
                                  '{min_distance: 0.0}\n')
    assert main([*common, '--config', 'other.yaml']) == 0
    document = json.loads(Path('a.json').read_text())
    assert document['config']['gate.min_distance'] == 0.0
    assert document['config']['limits.max_error'] == 0.004      # of the node
    main([*common, '--events', 'none'])
    assert json.loads(Path('a.json').read_text())['rejected']['undone'] == 0
    assert main([*common, '--events', '/elsewhere']) == 2


def test_samples_that_only_the_node_received_are_noted(operation: RecordedOperation,
                                                       capsys: pytest.CaptureFixture[str]) -> None:
    tips = [each for each in operation.messages if each[1] == TIP]
    operation.messages = [each for each in operation.messages if each not in tips[100:102]]
    operation.write(Path('less'))
    main(['replay', 'less', '--model', 'bone.ply', '--json', 'a.json'])
    notes = json.loads(Path('a.json').read_text())['recording']['notes']
    assert any('do not have the same samples: 2 of them' in note for note in notes)
    assert any('not replayed exactly' in note and 'the replay has' in note for note in notes)
    assert notes[0] in capsys.readouterr().err


def test_the_events_of_two_nodes_are_ambiguous(operation: RecordedOperation) -> None:
    with BagWriter('two') as bag:
        bag.write_point('/probe/tip', 1.0, [0.0, 0.0, 0.0], 'tracker')
        for topic in ('/left/events', '/right/events'):
            bag.add_topic(topic, STATUS)
            bag.write(topic, 1, next(each[3] for each in operation.messages if each[1] == EVENTS))
    with pytest.raises(Exception, match='several nodes: /left/events, /right/events; choose one'):
        read_bag('two', events=None)
    assert len(read_bag('two', events='/left/events').events) == 1
