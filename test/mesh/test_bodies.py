# SPDX-License-Identifier: Apache-2.0
"""Test that the bones of a mesh are distinguished, and one of them is chosen."""

from __future__ import annotations

import numpy as np
import pytest
from meshes import blob, two, volume

from gsdf_registration.common.result import InputError
from gsdf_registration.mesh.bone import make_bone

V, F = blob()
SMALL = V * 0.5 + [0.2, 0.0, 0.0]
# the smaller bone first
PAIR = two((SMALL, F), (V, F))


@pytest.mark.parametrize(('body', 'share'), [('largest', 1.0), ('1', 1.0), ('2', 0.125),
                                             ('all', 1.125), ('Largest', 1.0)])
def test_the_chosen_bone_is_kept(body: str, share: float) -> None:
    bone = make_bone(*PAIR, body=body)
    assert volume(bone.vertices, bone.faces) == pytest.approx(share * volume(V, F))
    assert len(bone.vertices) == len(np.unique(bone.faces))


@pytest.mark.parametrize(('body', 'words'), [
    ('', 'has 2 bodies: choose a bone with --body N'), ('3', 'has no body 3'),
    ('femur', "must be a number, largest or all, not 'femur'"), ('0', 'must be a number')])
def test_several_bones_without_a_valid_choice_are_refused(body: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        make_bone(*PAIR, body=body)
    assert words in caught.value.message and '\n' not in caught.value.message


def test_the_message_lists_the_bones_by_size() -> None:
    with pytest.raises(InputError) as caught:
        make_bone(*PAIR)
    listed = caught.value.message.partition('largest: ')[2]
    assert listed.index('1 (') < listed.index('2 (') and listed.count(' cm2') == 2
    assert 'around 202 0 0 mm' in listed


def test_the_list_of_many_bones_is_short() -> None:
    parts = [(V * 0.3 + [0.1 * i, 0.0, 0.0], F) for i in range(9)]
    mesh = parts[0]
    for part in parts[1:]:
        mesh = two(mesh, part)
    with pytest.raises(InputError, match='has 9 bodies.* and 3 smaller'):
        make_bone(*mesh)


def test_bodies_that_intersect_are_one_bone() -> None:
    mesh = two((V, F), (V * 0.6 + [0.04, 0.0, 0.0], F))
    assert len(make_bone(*mesh).faces) == len(mesh[1])


def test_one_bone_needs_no_choice() -> None:
    for body in ('', 'largest', '1', 'all'):
        assert len(make_bone(V, F, body=body).faces) == len(F)
