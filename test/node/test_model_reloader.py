# SPDX-License-Identifier: Apache-2.0
"""Replacing the bone: when it is loaded, and which landmarks and targets remain."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from gsdf_registration.node.model_reloader import (
    ModelReloader,
    _places,
    _places_on_new_bone,
)

CURRENT = Config.from_flat({
    'model.path': 'current.stl', 'landmarks.names': ['head'],
    'landmarks.positions': [0.0, 0.0, 0.1], 'targets.names': ['cup'],
    'targets.positions': [0.0, 0.1, 0.0], 'guidance.near': ['cup']})


@pytest.fixture
def other_file(tmp_path: Path) -> str:
    file = tmp_path / 'other.stl'
    file.touch()
    return str(file)


def reloader(state: str = 'active') -> ModelReloader:
    """Return the reloader of a node in this state that uses `CURRENT`."""
    node: Any = SimpleNamespace(state=state, session=SimpleNamespace(config=CURRENT))
    reloader = ModelReloader(node)
    reloader.set_current(CURRENT.model)
    return reloader


def test_reloads_only_if_the_model_changes(other_file: str) -> None:
    assert reloader().reload_needed(CURRENT.replaced({'model.path': other_file}))
    assert not reloader().reload_needed(CURRENT.replaced({'gate.max_speed': 2.0}))


def test_does_not_load_before_the_node_is_configured(other_file: str) -> None:
    changed = CURRENT.replaced({'model.path': other_file})
    assert not reloader('unconfigured').reload_needed(changed)


@pytest.mark.parametrize('path, reason', [('', 'deactivate and cleanup'),
                                          ('no/such.stl', 'the current bone is kept')])
def test_rejects_a_model_that_cannot_be_loaded(path: str, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        reloader().reload_needed(CURRENT.replaced({'model.path': path}))


def test_keeps_the_places_of_the_current_bone_while_another_is_loaded() -> None:
    requested = CURRENT.replaced({'model.path': 'other.stl', 'guidance.near': ['head']})
    kept = reloader().keep_places(requested)
    assert _places(kept) == _places(CURRENT)
    assert kept.model.path == 'other.stl'


def test_drops_places_that_the_request_does_not_change() -> None:
    before = _places(CURRENT)
    assert not any(_places_on_new_bone(before, before).values())


def test_uses_places_that_the_request_changes() -> None:
    requested = _places(CURRENT.replaced({'landmarks.names': ['tip']}))
    after = _places_on_new_bone(_places(CURRENT), requested | {'guidance.near': ['tip', 'cup']})
    assert after['landmarks.names'] == ['tip']
    assert after['landmarks.positions'] == [0.0, 0.0, 0.1]
    assert after['targets.names'] == [] and after['guidance.near'] == ['tip']
