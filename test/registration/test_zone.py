# SPDX-License-Identifier: Apache-2.0
"""The zone: which part of the bone is accurate enough, and which part must be."""

from __future__ import annotations

import numpy as np
import pytest
from smooth_bone import bone_field, touched_points

from gsdf_registration.common.config import Config, UnmatchedPlaces
from gsdf_registration.common.result import Reason, RegistrationResult, Zone
from gsdf_registration.common.rigid import Array
from gsdf_registration.registration.confidence import Confidence
from gsdf_registration.registration.zone import (
    NEARBY,
    ErrorMap,
    find_zone,
    map_error,
    required_part,
)

TARGETS = Config.from_flat({'targets.names': ['head', 'shaft'],
                            'targets.positions': [0.0, 0.0, 0.05, 0.0, 0.0, -0.2]})


def turning(sd: float) -> Confidence:
    """Return the confidence in a pose that may turn about the x axis through the origin."""
    covariance = np.diag([sd**2, 0.0, 0.0, 1e-10, 1e-10, 1e-10])
    return Confidence(covariance, np.zeros(3), 1e-4, 1.0)


def errors(*rows: tuple[float, float], targets: dict[str, float] | None = None) -> ErrorMap:
    """Return an error map of (error, distance from the touched points), m."""
    p95, distance = np.array(rows).T
    surface = np.stack([distance, np.zeros(len(rows)), np.zeros(len(rows))], axis=1)
    return ErrorMap(surface, p95, distance, targets or {})


def test_the_error_grows_with_the_distance_from_the_axis_of_a_rotation() -> None:
    surface = np.array([[0.5, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, -0.2]])
    found = map_error(turning(0.01), surface, np.array([[0.0, 0.0, 0.1]]), TARGETS)
    # 1.96 standard deviations of an error along one axis
    np.testing.assert_allclose(found.p95[1:], [1.96e-3, 3.92e-3], rtol=1e-3)
    assert found.p95[0] < 1e-4
    np.testing.assert_allclose(found.distance, [np.hypot(0.5, 0.1), np.hypot(0.1, 0.1), 0.3])
    assert found.target_p95['shaft'] == pytest.approx(4.0 * found.target_p95['head'], rel=1e-3)


def test_the_zone_ends_at_the_first_place_that_is_over_the_limit() -> None:
    zone = find_zone(errors((1e-3, 0.0), (1.9e-3, 0.09), (2.1e-3, 0.15), (1.5e-3, 0.2)), 2e-3)
    assert zone == Zone(2e-3, 0.15, 0.75, {}, 1.9e-3, 2.1e-3)
    assert zone.sentence == ('accurate to 2.0 mm (95 %) within 150 mm of the touched area, on 75 % '
                             'of the bone')


def test_the_zone_may_be_the_whole_bone() -> None:
    zone = find_zone(errors((1e-3, 0.0), (2e-3, 0.3)), 2e-3)
    assert (zone.bone_share, zone.distance_m) == (1.0, 0.3)
    assert zone.sentence == 'accurate to 2.0 mm (95 %) on the whole bone'


def test_a_share_just_below_one_is_not_shown_as_all() -> None:
    assert 'on 99 % of the bone' in Zone(2e-3, 0.3, 0.9996, {}, 1e-3, 3e-3).sentence


@pytest.mark.parametrize(('share', 'grade'), [(1.0, 'A'), (0.999, 'B')])
def test_the_grade_follows_from_the_zone(share: float, grade: str) -> None:
    zone = Zone(2e-3, 0.3, share, {}, 1e-3, 3e-3)
    assert RegistrationResult(Reason.CONVERGED, '', zone=zone).grade == grade
    assert RegistrationResult(Reason.AMBIGUOUS, '', zone=zone).grade is None
    assert RegistrationResult(Reason.CONVERGED, '').grade is None


def test_what_is_required() -> None:
    found = errors((1e-3, 0.0), (2e-3, 0.99 * NEARBY), (9e-3, 0.3), targets={'head': 4e-3})
    expected = {'touched': ('around the touched area', 2, 2e-3),
                'bone': ('over the whole bone', 3, 9e-3)}
    for require, (where, count, p95) in expected.items():
        part = required_part(found, Config.from_flat({'limits.require': require}))
        assert (part.where, len(part.points), part.p95) == (where, count, p95)
    assert required_part(found, Config()).where == 'around the touched area'
    part = required_part(found._replace(target_p95={'head': 1e-3, 'shaft': 4e-3}), TARGETS)
    assert (part.where, len(part.points), part.p95) == ('at the targets', 2, 4e-3)


def test_targets_cannot_be_required_without_targets() -> None:
    with pytest.raises(UnmatchedPlaces, match='limits.require is "targets", but there are none'):
        Config.from_flat({'limits.require': 'targets'})


@pytest.mark.parametrize('scale', [1.0, 1000.0])
def test_the_zone_does_not_depend_on_the_unit(scale: float) -> None:
    def zone_of(surface: Array, touched: Array) -> Zone:
        S = np.diag([1.0, 1.0, 1.0, scale, scale, scale])
        confidence = turning(0.02)
        scaled = Confidence(S @ confidence.motion_covariance @ S, np.zeros(3), scale * 1e-4, 1.0)
        return find_zone(map_error(scaled, scale * surface, scale * touched, Config()),
                         scale * 2e-3)
    surface = bone_field().surface_points.astype(float)
    zone = zone_of(surface, touched_points(50))
    assert 0.0 < zone.bone_share < 1.0
    assert zone.bone_share == find_zone(
        map_error(turning(0.02), surface, touched_points(50), Config()), 2e-3).bone_share
