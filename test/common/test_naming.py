# SPDX-License-Identifier: Apache-2.0
"""Two nodes with default settings share neither a frame nor a file."""

from __future__ import annotations

import pytest

from gsdf_registration.common.config import Config
from gsdf_registration.common.naming import prefix_of

NODES = [('/', 'registration'), ('/femur', 'registration'), ('/left/femur', 'registration'),
         ('/', 'tibia'), ('/left', 'tibia')]


@pytest.mark.parametrize('node, prefix', list(zip(
    NODES, ['', 'femur_', 'left_femur_', 'tibia_', 'left_tibia_'])))
def test_prefix_is_the_name_of_the_node(node: tuple[str, str], prefix: str) -> None:
    assert prefix_of(*node) == prefix


def test_default_names_differ_between_nodes() -> None:
    configs = [Config().named(prefix_of(*node)) for node in NODES]
    for name in ('model.frame_id', 'reference.frame_id', 'session.path'):
        assert len({config.flat()[name] for config in configs}) == len(NODES)
    plain, femur = configs[:2]
    assert (plain.model.frame_id, plain.session.path) == ('bone', 'registration_session.json')
    assert (femur.model.frame_id, femur.reference.frame_id) == ('femur_bone',
                                                               'femur_reference_array')
    assert femur.session.path == 'femur_registration_session.json'


def test_names_that_are_given_stay() -> None:
    given = Config.from_flat({'model.frame_id': 'b', 'reference.frame_id': 'a',
                              'session.path': 's.json'})
    assert given.named('femur_') == given


def test_frames_have_names_without_a_node() -> None:
    config = Config.from_flat({'reference.topic': '/array'})
    assert (config.bone_frame, config.points_frame) == ('bone', 'reference_array')
