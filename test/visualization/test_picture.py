# SPDX-License-Identifier: Apache-2.0
"""The picture file of a scene."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from example_scene import X, example_scene
from pixel_colours import has_colour
from smooth_bone import bone_field, touched_points

from gsdf_registration.common.result import InputError, NextTouch
from gsdf_registration.common.rigid import Array
from gsdf_registration.visualization import colours, picture
from gsdf_registration.visualization.render import Scene


def without_pose(scene: Scene) -> Scene:
    return dataclasses.replace(scene, T_tracker_bone=None, covariance=None,
                               residuals=np.zeros(0), weights=np.zeros(0), next_touches=())


def written(file: Path, scene: Scene, title: str, good: bool) -> Array:
    picture.write_picture(file, scene, title, good)
    return np.asarray(matplotlib.image.imread(file)[..., :3])


@pytest.mark.parametrize('posed', [True, False])
def test_writes_a_png_with_bone_points_and_next_touch(tmp_path: Path, posed: bool) -> None:
    scene = example_scene(bone_field(), touched_points(100, radius=0.02))
    image = written(tmp_path / 'scene.png', scene if posed else without_pose(scene),
                    'touch more of the bone; ' * 12, posed)
    assert image.shape[1] > image.shape[0] > 500
    for colour in (colours.NEXT, colours.RESIDUAL[0]):
        found = has_colour(image, colour).sum()
        assert found > 500 if posed else found == 0
    assert (np.ptp(image, axis=-1) < 0.1)[image.mean(axis=-1) < 0.9].sum() > 20_000  # the bone


def test_without_a_pose_the_deciding_touch_is_visible(tmp_path: Path) -> None:
    scene = example_scene(bone_field(), touched_points(100, radius=0.02))
    touch = NextTouch(scene.next_touches[0].position, X)
    scene = dataclasses.replace(without_pose(scene), next_touches=[touch])
    image = written(tmp_path / 'scene.png', scene, 'two poses', False)
    assert has_colour(image, colours.NEXT).sum() > 200
    assert has_colour(image, colours.RESIDUAL[0]).sum() == 0


def test_a_picture_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='nowhere'):
        picture.write_picture(tmp_path / 'nowhere/a.png',
                              example_scene(bone_field(), touched_points(10)), 'a', good=True)
