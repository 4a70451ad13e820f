# SPDX-License-Identifier: Apache-2.0
"""A recording with what the operator did: replayed to the bit, and every sample is counted once."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from rosbags.typesys import Stores, get_typestore
from smooth_bone import T_TRACKER_BONE, bone_field, touched_points

from gsdf_registration.cli.main import main
from gsdf_registration.common.config import Config
from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.rigid import Array, transform
from gsdf_registration.common.samples import Sample
from gsdf_registration.field.model import load_model
from gsdf_registration.live import LiveStatus
from gsdf_registration.session import Session
from gsdf_registration.session.status_values import status_values
from msg_adapters.bag import read_bag
from msg_adapters.bag_writer import BagWriter

TYPES = get_typestore(Stores.ROS2_JAZZY)
STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'
START, STEP = 1.7e9, 0.0125
SETTINGS = Config.from_flat({'collect.automatic': False, 'gate.max_speed': 100.0,
                             'limits.max_error': 0.004})


def event_message(event: OperatorEvent) -> bytes:
    """Return an event as the node publishes it, as CDR."""
    t = TYPES.types
    values = [t['diagnostic_msgs/msg/KeyValue'](*pair) for pair in event.values().items()]
    message = t[STATUS](0, '/registration', event.message, '', values)
    return bytes(TYPES.serialize_cdr(message, STATUS))


class Operation:
    """What an operator did with a session, and the same as events."""

    def __init__(self, points: Array, bone: Any) -> None:
        self.points = points
        self.session = Session(SETTINGS, bone)
        self.events: list[OperatorEvent] = []
        self.received = 0
        self.event('configure', settings=SETTINGS.flat(), model_sha256=bone.bone_sha256)
        self.event('activate', settings=SETTINGS.flat(), model_sha256=bone.bone_sha256)

    def event(self, name: str, performed: bool = True, **request: Any) -> None:
        count = self.received
        last = {'/probe/tip': (count, START + STEP * (count - 1))} if count else {}
        self.events.append(OperatorEvent(
            len(self.events) + 1, name, 5.0, True, '', request, performed, '',
            self.session.kept, last))

    def receive(self, number: int) -> None:
        for i in range(self.received, self.received + number):
            self.session.add(Sample(START + STEP * i, tuple(self.points[i].tolist()), 'tracker',
                                    '/probe/tip'))
        self.received += number

    def collect(self, on: bool) -> None:
        self.event('collect', data=on)
        self.session.collect(on)

    def write(self, path: Path, delay: float) -> None:
        """Write what a recorder that receives the events ``delay`` s late writes."""
        with BagWriter(path) as bag:
            for topic in ('/registration/events', '/registration/status'):
                bag.add_topic(topic, STATUS)
            written = 0
            for i, point in enumerate([*self.points, None]):
                now = START + STEP * i
                while written < len(self.events) and (
                        point is None or self._time(self.events[written]) + delay <= now):
                    bag.write('/registration/events', int(now * 1e9),
                              event_message(self.events[written]))
                    written += 1
                if point is not None:
                    bag.write_point('/probe/tip', now, point, 'tracker')

    def _time(self, event: OperatorEvent) -> float:
        return event.last['/probe/tip'][1] if event.last else START


@pytest.fixture
def operation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Operation:
    """Return an operation with strokes, an undo, a change of parameters and a registration."""
    monkeypatch.setenv('GSDF_CACHE_DIR', str(tmp_path / 'cache'))
    monkeypatch.chdir(tmp_path)
    field = bone_field()
    trimesh.Trimesh(1e3 * field.vertices, field.faces).export('bone.ply')
    points = transform(T_TRACKER_BONE, touched_points(700, sigma=0.0002))
    points[450:500] += 0.05         # a stroke beside the bone
    points[620], points[630] = np.nan, points[629]      # not finite, and twice at one place
    run = Operation(points, load_model('bone.ply', 'mm'))
    run.receive(50)                 # before the first stroke
    run.collect(True)
    run.receive(400)
    run.collect(True)
    run.receive(50)
    run.event('undo')
    run.session.undo()
    run.event('register', performed=False)      # refused at once
    changed = SETTINGS.replaced({'gate.min_distance': 0.0001})
    run.event('parameters', **{'gate.min_distance': 0.0001})
    run.session.configure(changed)
    run.collect(True)
    run.receive(150)
    run.event('register', T_tracker_bone=T_TRACKER_BONE.tolist())
    run.result = run.session.register(T_tracker_bone=T_TRACKER_BONE)
    run.receive(50)                 # after the registration
    return run


@pytest.mark.parametrize('delay', [-0.3, 0.0, 1.0])
def test_an_operation_is_replayed_to_the_bit(operation: Operation, delay: float,
                                             capsys: pytest.CaptureFixture[str]) -> None:
    operation.write(Path('run'), delay)
    assert main(['replay', 'run', '--model', 'bone.ply', '--json', 'a.json', '--report',
                 'a.html']) == 0
    out, error = capsys.readouterr()
    document = json.loads(Path('a.json').read_text())
    assert document['recording'] == {'complete': True, 'notes': []} and 'note' not in error
    result = operation.result
    assert document['T_tracker_bone'] == result.T_tracker_bone.tolist()
    assert document['covariance'] == result.covariance.tolist()
    assert document['config']['limits.max_error'] == 0.004
    # received = used + left out + rejected, everywhere, with the same words
    points, rejected = document['points'], document['rejected']
    assert points['received'] == result.received == 650 and points['used'] == result.used
    assert rejected == result.rejected
    assert rejected['undone'] >= 40 and rejected['not_collecting'] == 50
    assert rejected['not_finite'] == 1 and rejected['duplicate'] >= 1
    assert points['received'] == points['used'] + sum(points['left_out'].values()) + sum(
        rejected.values())
    counts = dict(re.findall(r'^  (points|left out|rejected) +(.*)$', out, re.MULTILINE))
    total, used = (int(number) for number in re.findall(r'(\d+) (?:received|used)',
                                                        counts['points']))
    listed = {cause.replace(' ', '_'): int(number) for number, cause in re.findall(
        r'(\d+) ([a-z ]+)', counts.get('left out', '') + ', ' + counts['rejected'])}
    assert total == used + sum(listed.values())
    every = {**points['left_out'], **rejected}
    assert listed == {cause: count for cause, count in every.items() if count}
    status = status_values(operation.session.status(), LiveStatus())
    assert int(status['received']) == int(status['kept']) + sum(
        int(count) for key, count in status.items() if key.startswith('rejected.'))
    in_fit = int(status['used']) + sum(
        int(count) for key, count in status.items() if key.startswith('left_out.'))
    assert in_fit + sum(rejected.values()) == 650
    page = re.sub(r'<[^>]+>', ' ', Path('a.html').read_text())
    assert 'not explained' not in page and re.search(r'received\s+650\b', page)
    assert re.search(rf'rejected: undone\s+{rejected["undone"]}\b', page)


def test_other_settings_and_all_points_can_be_replayed(operation: Operation) -> None:
    operation.write(Path('run'), 0.0)
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


def test_samples_that_only_the_node_received_are_noted(operation: Operation,
                                                       capsys: pytest.CaptureFixture[str]) -> None:
    operation.write(Path('whole'), 0.0)
    operation.points = np.delete(operation.points, [100, 101], axis=0)
    with BagWriter('less') as bag:
        bag.add_topic('/registration/events', STATUS)
        stamps = np.delete(START + STEP * np.arange(700), [100, 101])
        for stamp, point in zip(stamps, operation.points):
            bag.write_point('/probe/tip', stamp, point, 'tracker')
        for event in operation.events:
            bag.write('/registration/events', int(2e18), event_message(event))
    main(['replay', 'less', '--model', 'bone.ply', '--json', 'a.json'])
    notes = json.loads(Path('a.json').read_text())['recording']['notes']
    assert any('do not have the same samples: 2 of them' in note for note in notes)
    assert any('not replayed exactly' in note and 'the replay has' in note for note in notes)
    assert notes[0] in capsys.readouterr().err


def test_the_events_of_two_nodes_are_ambiguous(operation: Operation) -> None:
    with BagWriter('two') as bag:
        bag.write_point('/probe/tip', 1.0, [0.0, 0.0, 0.0], 'tracker')
        for topic in ('/left/events', '/right/events'):
            bag.add_topic(topic, STATUS)
            bag.write(topic, 1, event_message(operation.events[0]))
    with pytest.raises(Exception, match='several nodes: /left/events, /right/events; choose one'):
        read_bag('two', events=None)
    assert len(read_bag('two', events='/left/events').events) == 1
