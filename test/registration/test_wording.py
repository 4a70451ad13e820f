# SPDX-License-Identifier: Apache-2.0
"""The descriptions of places and directions on the bone."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import bone_field, touched_points

from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.wording import (
    describe_axis,
    describe_direction,
    describe_place,
)

X, Y, Z = np.eye(3)
# of a rod along z, touched on its side in +x
ROD = np.array([[x, y, z] for x in (-0.01, 0.01) for y in (-0.01, 0.01)
                for z in np.linspace(-0.1, 0.1, 21)])
TOUCHED = np.array([[0.01, y, z] for y in (-0.005, 0.005) for z in (0.04, 0.06)])


def described(place: list[float], names: dict[str, list[float]],
              touched: Array | None = None) -> str:
    """Return the description of a place, mm; by default the bone was touched at its tip in +x."""
    area = touched_points(100, 0, radius=0.015) if touched is None else touched
    named = {name: 1e-3 * np.array(point) for name, point in names.items()}
    return describe_place(1e-3 * np.array(place), area, named, bone_field())


def axis(direction: Array, point: Array, names: dict[str, Array] | None = None) -> str:
    return describe_axis(direction, point, ROD, TOUCHED, X, names or {})


def test_a_place_is_described_from_the_nearest_name_towards_another() -> None:
    names: dict[str, list[float]] = {'crest': [0, 0, 50], 'notch': [0, 40, 50]}
    assert described([0, 1, 52], names) == "at 'crest'"
    assert described([0, 12, 50], names) == "12 mm from 'crest' towards 'notch'"
    assert described([0, -12, 48], names) == "12 mm from 'crest' away from 'notch'"
    assert described([0, 30, 50], names) == "10 mm from 'notch' towards 'crest'"
    assert "20 mm from 'crest' at " in described([0, 0, 70], {'crest': [0, 0, 50]})
    assert 'crest' not in described([0, 0, -50], names)


def test_a_place_without_names_is_described_by_a_clock_face() -> None:
    surface = bone_field().surface_points.astype(np.float64)
    # an area that is not right above the middle of the bone
    points = surface[np.linalg.norm(surface - [0.02, 0.0, -0.04], axis=1) < 0.012]
    above = bone_field().sample(points)[1].mean(axis=0)
    above /= np.linalg.norm(above)
    noon = surface.mean(axis=0) - points.mean(axis=0)
    noon -= (noon @ above) * above
    noon /= np.linalg.norm(noon)
    right = np.cross(noon, above)

    def at(up: float, aside: float, deeper: float = 0.0) -> str:
        place = points.mean(axis=0) + up * noon + aside * right - deeper * above
        return described((1e3 * place).tolist(), {}, points)

    where = 'from the middle of the touched area'
    assert at(0.03, 0.0) == f"30 mm {where} at 12 o'clock (12 is towards the middle of the bone)"
    assert f"20 mm {where} at 3 o'clock" in at(0.0, 0.02)
    assert f"20 mm {where} at 6 o'clock" in at(-0.02, 0.001)
    assert f"20 mm {where} at 9 o'clock" in at(0.0, -0.02)
    assert at(0.02, 0.02, 0.012).endswith('of the bone), 12 mm deeper')
    assert at(0.02, 0.02, -0.012).endswith('of the bone), 12 mm higher')
    assert at(0.0, 0.0, 0.012) == '12 mm deeper than the middle of the touched area'
    assert at(0.001, 0.0) == 'at the middle of the touched area'


def test_above_the_middle_of_the_bone_the_clock_is_aligned_with_the_model() -> None:
    surface = bone_field().surface_points.astype(np.float64)
    end = surface[surface[:, 2] > surface[:, 2].max() - 0.004]
    place = end.mean(axis=0) + [0.02, 0.0, 0.0]
    assert "at 12 o'clock (12 is towards +x of the model)" in described(
        (1e3 * place).tolist(), {}, end)


@pytest.mark.parametrize(('direction', 'outward', 'words'), [
    (Z, X, 'along the long axis of the bone'),
    (-X, X, 'perpendicular to the touched surface'),
    (Y, X, 'perpendicular to the long axis of the bone'),
    (np.array([0.0, 0.7, 0.7]), X, 'parallel to the touched surface'),
    (np.array([0.7, 0.0, 0.7]), X, 'inclined 44 deg to the touched surface'),
    (Y, np.zeros(3), 'perpendicular to the long axis of the bone')])
def test_a_direction_is_described_by_the_bone(direction: Array, outward: Array,
                                              words: str) -> None:
    assert describe_direction(direction, ROD, outward) == words


def test_an_axis_is_described_by_the_nearest_name() -> None:
    names = {'crest': 0.1 * Z, 'notch': 0.1 * Z + 0.04 * Y, 'far': 0.5 * X}
    assert axis(-Y, 0.1 * Z, names) == "through 'crest', towards 'notch'"
    assert axis(Z, 0.02 * Y, {'crest': 0.1 * Z}) == "near 'crest', along the long axis of the bone"
    assert 'far' not in axis(Y, 0.1 * Z, {'far': names['far']})


def test_an_axis_without_names_is_described_by_what_it_passes() -> None:
    assert axis(Y, 0.05 * Z) == ('through the touched area, perpendicular to the long axis of the '
                                 'bone')
    assert axis(X, 0.0 * Z) == ('through the middle of the bone, perpendicular to the touched '
                                'surface')
    assert axis(Y, 0.1 * X + 0.05 * Z).startswith('90 mm from the touched area, ')
