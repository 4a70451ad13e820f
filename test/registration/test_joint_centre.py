# SPDX-License-Identifier: Apache-2.0
"""The hip centre of a model: the sphere of the femoral head or the acetabulum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from smooth_bone import ball_mesh, bone_field, field_of

from gsdf_registration.common import rigid
from gsdf_registration.common.result import InputError
from gsdf_registration.field import Field
from gsdf_registration.field.model import load_model
from gsdf_registration.registration.joint_centre import extreme_points, find_hip_centre
from gsdf_registration.simulation.femur import HEAD, HEAD_RADIUS


@pytest.fixture(scope='module')
def femur(femur_bone: Path) -> Field:
    return load_model(str(femur_bone), 'mm')


def test_finds_the_femoral_head(femur: Field) -> None:
    shares: list[float] = []
    found = find_hip_centre(femur, shares.append)
    assert not found.hollow
    np.testing.assert_allclose(found.centre, 1e-3 * np.array(HEAD), atol=3e-4)
    assert found.radius == pytest.approx(1e-3 * HEAD_RADIUS, abs=3e-4)
    assert found.rms < 5e-4
    assert shares == sorted(shares) and shares[0] >= 0.0 and shares[-1] == 1.0


def test_finds_the_acetabulum_in_which_the_head_turns(hip_bone: Path) -> None:
    found = find_hip_centre(load_model(str(hip_bone), 'mm'))
    assert found.hollow
    # the shipped hip has its centre there
    assert np.linalg.norm(found.centre) < 1e-3


def test_a_bone_without_a_round_part_has_no_hip_centre() -> None:
    with pytest.raises(InputError, match='no femoral head or acetabulum'):
        find_hip_centre(bone_field())


def test_a_sphere_of_another_size_is_no_head() -> None:
    with pytest.raises(InputError):
        find_hip_centre(field_of(ball_mesh(np.full(3, 0.04))))


def test_a_ball_of_the_size_of_a_head_is_found_wherever_it_is() -> None:
    mesh = ball_mesh(np.full(3, 0.024))
    mesh.apply_translation([0.3, -0.2, 1.0])
    found = find_hip_centre(field_of(mesh, 0.002))
    np.testing.assert_allclose(found.centre, [0.3, -0.2, 1.0], atol=2e-5)
    assert found.radius == pytest.approx(0.024, abs=5e-5)


def test_extreme_points_are_on_the_surface_and_determine_a_pose(femur: Field) -> None:
    places = extreme_points(femur)
    assert np.abs(femur.sample(places)[0]).max() < 1e-4
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    assert apart[np.triu_indices(4, 1)].min() > 0.02
    T = rigid.exp([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])
    np.testing.assert_allclose(rigid.fit_points(rigid.transform(T, places), places), T, atol=1e-9)
