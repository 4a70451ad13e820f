# SPDX-License-Identifier: Apache-2.0
"""
Fixtures for tests with real processes over real DDS.

They use a separate domain, one node that tests share, and nodes of single tests. Without rclpy the
tests are skipped, see `NEEDS` of ../conftest.py, and nothing here is used.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msg_adapters.session_file import identity, read_session, write_session
from msg_adapters.truth import read_truth

if importlib.util.find_spec('rclpy') is not None:
    from ros_support import BAG, TOPICS, Client, NodeProcess, Tracker, tracked

    from gsdf_registration.clients.domain import private_domain


@pytest.fixture(scope='session', autouse=True)
def surroundings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Run all processes of these tests in a separate domain, with a separate cache of fields."""
    with private_domain() as environment, pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        patch.setenv('GSDF_CACHE_DIR', str(tmp_path_factory.mktemp('cache')))
        yield


@pytest.fixture(scope='session')
def parameters() -> dict[str, Any]:
    """Return the node parameters for the recording."""
    truth = read_truth(BAG.with_suffix('.yaml'))
    numbers = ', '.join(repr(float(number)) for number in truth.landmarks_model.ravel())
    return {'model.path': BAG.parent / truth.model, 'model.unit': truth.model_unit,
            'collect.automatic': 'false', 'probe.topics': TOPICS,
            'landmarks.names': list(truth.landmark_names),
            'landmarks.positions': f'[{numbers}]'}


@pytest.fixture(scope='session')
def shared_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the session file of the shared node."""
    return tmp_path_factory.mktemp('node') / 'session.json'


@pytest.fixture(scope='session')
def shared_node(parameters: dict[str, Any], shared_session: Path) -> Iterator[NodeProcess]:
    node = NodeProcess(shared_session.with_name('log'), **parameters,
                       **{'session.path': shared_session})
    yield node
    node.stop()


@pytest.fixture(scope='session')
def shared_tracker(shared_node: NodeProcess) -> Iterator[Tracker]:
    with tracked(shared_node) as tracker:
        yield tracker


@pytest.fixture
def tracker(shared_tracker: Tracker) -> Tracker:
    """Return the tracker of the shared node, whose session is cleared."""
    assert shared_tracker.client.ask('clear').success
    return shared_tracker


@pytest.fixture
def client(tracker: Tracker) -> Client:
    return tracker.client


@pytest.fixture
def many_points(tracker: Tracker, shared_session: Path) -> Path:
    """Return a session file with so many points that a registration takes some seconds."""
    tracker.touch_landmarks(np.eye(4))
    tracker.drag(np.eye(4))
    assert tracker.client.ask('save').success
    session = read_session(shared_session)
    rows = np.tile(session['points'], 30_000 // len(session['points']))
    noise = np.random.default_rng(0).normal(0.0, 2e-4, (len(rows), 3))
    for name, shift in zip('xyz', noise.T):
        rows[name] += shift
    session['points'] = rows
    write_session(shared_session, session, identity(shared_session))
    return shared_session


@pytest.fixture
def start_node(tmp_path: Path) -> Iterator[Any]:
    """Return a function that starts a node with the given name."""
    nodes: list[NodeProcess] = []

    def start(name: str, **given: Any) -> NodeProcess:
        nodes.append(NodeProcess(tmp_path / f'{name}.log', name, **given))
        return nodes[-1]
    yield start
    for node in nodes:
        node.stop()
