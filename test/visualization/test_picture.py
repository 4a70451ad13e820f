# SPDX-License-Identifier: Apache-2.0
"""The picture of a scene: what is drawn is where it should be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from shades import like
from smooth_bone import bone_field, touched

pytest.importorskip('matplotlib')

import matplotlib.image  # noqa: E402

from gsdf_registration.common.config import Config  # noqa: E402
from gsdf_registration.common.result import InputError, Reason, Refusal  # noqa: E402
from gsdf_registration.common.rigid import Array, exp, transform  # noqa: E402
from gsdf_registration.field import Field  # noqa: E402
from gsdf_registration.live.assessment import FullAssessment  # noqa: E402
from gsdf_registration.registration.guidance import Touch  # noqa: E402
from gsdf_registration.session.collection import Points  # noqa: E402
from gsdf_registration.visualization import (
    colours,  # noqa: E402
    picture,  # noqa: E402
)
from gsdf_registration.visualization.raycast import cast, light, looking_at  # noqa: E402
from gsdf_registration.visualization.view import Scene, View, paint  # noqa: E402

SHAPE = (120, 90)
T_TRACKER_BONE = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])
X = np.eye(3)[0]


@pytest.fixture(scope='module')
def field() -> Field:
    return bone_field()


def scene(field: Field, positions: Array, sure: bool = True) -> Scene:
    """Return points (n, 3), bone frame, m, on the bone, the last of them not used."""
    weights = np.ones(len(positions))
    weights[-1:] = 0.0
    residuals, _ = field.sample(positions)
    turn, shift = (1e-3, 1e-4) if sure else (0.2, 1e-3)
    top = field.surface_points[np.argmax(field.surface_points[:, 0])].astype(np.float64)
    none = np.zeros(len(positions), np.int32)
    points = Points(transform(T_TRACKER_BONE, positions), none.astype(np.float64), none, none)
    covariance = np.diag([shift, shift, shift, turn, turn, turn]) ** 2
    loose = Refusal(Reason.UNDER_CONSTRAINED, 'loose', 'touch', [Touch(top, X, 0.0008, 0.001)])
    return Scene(FullAssessment(points, T_tracker_bone=T_TRACKER_BONE, covariance=covariance,
                        residuals_m=residuals, weights=weights, rejection_reasons=(loose,)),
                 field, Config().limits)


def seen_from(direction: Array, field: Field, scene: Scene) -> View:
    surface = field.surface_points.astype(np.float64)
    return paint(scene, looking_at(surface, direction, SHAPE, margin=0.005))


@pytest.mark.parametrize('direction', [[1.0, 0.2, 0.1], [0.0, 0.0, 1.0], [-0.3, -1.0, 0.5]])
def test_rays_end_on_the_bone_and_only_there(field: Field, direction: list[float]) -> None:
    surface = field.surface_points.astype(np.float64)
    camera = looking_at(surface, np.array(direction), SHAPE, margin=0.005)
    seen, places = cast(field, camera)
    assert np.abs(field.sample(places)[0]).max() < 1e-4
    columns, rows, _ = camera.project(places)
    assert (np.floor(rows) * SHAPE[1] + np.floor(columns)).astype(int).tolist() == seen.tolist()
    # a ray that ends nowhere has no bone on its way
    missed = np.setdiff1d(np.arange(SHAPE[0] * SHAPE[1]), seen)
    on_the_way = camera.pixels()[missed][:, None] + np.linspace(-0.1, 0.1, 100)[:, None] * (
        camera.axes[2])
    assert field.sample(on_the_way.reshape(-1, 3))[0].min() > -1e-4
    brightness, normals = light(field, places, camera)
    assert brightness.min() > 0.1 and brightness.max() <= 1.0
    assert (normals @ camera.axes[2]).min() > -0.1      # we see no far side


def test_what_is_right_and_up_in_the_picture_is_so_on_the_bone() -> None:
    camera = looking_at(np.array([[-0.1, -0.1, -0.1], [0.1, 0.1, 0.1]]), -np.eye(3)[1], SHAPE)
    columns, rows, heights = camera.project(np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.02]]))
    assert (columns[0], rows[0]) == pytest.approx((0.5 * SHAPE[1], 0.5 * SHAPE[0]))
    assert columns[1] > columns[0] and rows[1] < rows[0]        # seen from the front: x right, z up
    assert heights == pytest.approx(0.0)


def test_points_are_seen_from_their_side_only(field: Field) -> None:
    points = touched(100, radius=0.02)
    towards, away = (seen_from(direction, field, scene(field, points)) for direction in (X, -X))
    blue = colours.RESIDUAL[0]
    assert like(towards.image, blue).sum() > 50
    assert like(away.image, blue).sum() == 0


def test_the_next_patch_is_green_and_numbered_where_it_can_be_seen(field: Field) -> None:
    shown = scene(field, touched(100, seed=1, radius=0.02)[:2])
    towards, away = (seen_from(direction, field, shown) for direction in (X, -X))
    touch, = shown.found.touches
    green = np.argwhere(like(towards.image, colours.NEXT))
    column, row, _ = towards.camera.project(touch.position[None])
    assert len(green) > 20
    assert green.mean(axis=0) == pytest.approx([row[0], column[0]], abs=6)
    assert towards.sees(touch) and not away.sees(touch)


def test_the_bone_is_purple_where_the_pose_is_not_held(field: Field) -> None:
    points = touched(100, radius=0.02)
    sure, unsure = (seen_from(-X, field, scene(field, points, sure)) for sure in (True, False))
    purple = colours.ERROR[-1]
    assert like(unsure.image, purple).sum() > 500
    assert like(sure.image, purple).sum() == 0


@pytest.fixture
def _coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cast one ray a pixel: quicker, and no less is seen."""
    monkeypatch.setattr(picture, 'FINER', 1)


@pytest.mark.usefixtures('_coarse')
@pytest.mark.parametrize('posed', [True, False])
def test_a_scene_becomes_a_png(tmp_path: Path, field: Field, posed: bool) -> None:
    shown = scene(field, touched(100, radius=0.02))
    if not posed:
        lost = FullAssessment(shown.found.points, rejection_reasons=(Refusal(Reason.TOO_FEW_POINTS, 'few'),))
        shown = Scene(lost, field, shown.limits)
    file = tmp_path / 'scene.png'
    picture.write_picture(file, shown, 'touch more of the bone; ' * 12, good=posed)
    image = matplotlib.image.imread(file)[..., :3]
    assert image.shape[1] > image.shape[0] > 500
    for colour in (colours.NEXT, colours.RESIDUAL[0]):
        found = like(image, colour).sum()
        assert found > 500 if posed else found == 0
    assert (np.ptp(image, axis=-1) < 0.1)[image.mean(axis=-1) < 0.9].sum() > 20_000  # the bone


@pytest.mark.usefixtures('_coarse')
def test_without_a_pose_the_place_that_decides_is_seen(tmp_path: Path, field: Field) -> None:
    shown = scene(field, touched(100, radius=0.02))
    top = shown.found.touches[0].position
    rivals = Refusal(Reason.AMBIGUOUS, 'two poses', 'touch', [Touch(top, X)])
    # whether this is the pose at all comes before how well it is held
    lost = FullAssessment(shown.found.points, rejection_reasons=(*shown.found.rejection_reasons, rivals))
    file = tmp_path / 'scene.png'
    picture.write_picture(file, Scene(lost, field, shown.limits), 'two poses', good=False)
    image = matplotlib.image.imread(file)[..., :3]
    assert like(image, colours.NEXT).sum() > 200
    assert like(image, colours.RESIDUAL[0]).sum() == 0


@pytest.mark.usefixtures('_coarse')
def test_a_picture_that_cannot_be_written_is_named(tmp_path: Path, field: Field) -> None:
    with pytest.raises(InputError, match='nowhere'):
        picture.write_picture(tmp_path / 'nowhere/a.png', scene(field, touched(10)), 'a', good=True)
