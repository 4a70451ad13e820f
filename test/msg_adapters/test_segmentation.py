# SPDX-License-Identifier: Apache-2.0
"""Test that the surface of a segmentation is where that of the patient is, for all axes."""

from __future__ import annotations

import logging
from pathlib import Path

import label_maps
import numpy as np
import pytest
import SimpleITK

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, rotation_exp
from gsdf_registration.mesh.bone import make_bone
from msg_adapters.points import read_model
from msg_adapters.segmentation import read_segmentation
from msg_adapters.slicer import model_axes

SPACING = np.array([1.0, 1.1, 1.6])
OBLIQUE = rotation_exp([0.3, -0.2, 0.4])
AXES = {'lps': np.eye(3), 'ras': np.diag([-1.0, -1.0, 1.0]), 'oblique': OBLIQUE,
        'permuted': np.eye(3)[:, [2, 0, 1]], 'left-handed': OBLIQUE @ np.diag([1.0, 1.0, -1.0])}


def image(labels: np.ndarray, T_lps_index: Array) -> SimpleITK.Image:
    """Return an image of ITK, which is in LPS."""
    made = SimpleITK.GetImageFromArray(labels.transpose(2, 1, 0).astype(np.uint8))
    spacing = np.linalg.norm(T_lps_index[:3, :3], axis=0)
    made.SetSpacing(spacing.tolist())
    made.SetDirection((T_lps_index[:3, :3] / spacing).ravel().tolist())
    made.SetOrigin(T_lps_index[:3, 3].tolist())
    return made


def write(path: Path, axes: Array = AXES['lps'], factor: int = 1) -> Path:
    T, shape = label_maps.around(axes, SPACING)
    labels = factor * label_maps.voxels(T, shape)
    if path.name == 'hand.nii':
        label_maps.write_nifti(path, labels, T)
    else:
        SimpleITK.WriteImage(image(labels, T), str(path))
    return path


def assert_is_the_shape(vertices: Array, faces: np.ndarray) -> None:
    off = np.abs(label_maps.distances(1e3 * vertices))
    # half a voxel where a side lies between two layers of voxels
    assert np.sqrt(np.mean(off**2)) < 0.65 and off.max() < 2.0
    for end in (label_maps.LEFT, label_maps.BACK):
        assert np.linalg.norm(1e3 * vertices - end, axis=1).min() < 1.5
    bone = make_bone(vertices, faces)
    assert not any('inside out' in note for note in bone.notes)


@pytest.mark.parametrize(('name', 'axes'), [
    *(('hand.nii', axes) for axes in AXES), *(('a.nrrd', axes) for axes in AXES),
    ('a.nii.gz', 'oblique'), ('a.mha', 'left-handed')])
def test_the_surface_is_that_of_the_patient(tmp_path: Path, name: str, axes: str) -> None:
    path = write(tmp_path / name, AXES[axes])
    vertices, faces, normals = read_model(path, 'mm')
    assert faces is not None and normals is None and model_axes(path) == 'lps'
    assert_is_the_shape(vertices, faces)


def test_a_label_is_chosen_by_its_number(tmp_path: Path) -> None:
    T, shape = label_maps.around(np.eye(3), SPACING)
    labels = 3 * label_maps.voxels(T, shape)
    labels[:4, :4, :4] = 7
    SimpleITK.WriteImage(image(labels, T), str(tmp_path / 'a.nrrd'))
    assert_is_the_shape(*read_segmentation(tmp_path / 'a.nrrd', '3'))
    with pytest.raises(InputError, match='has 2 labels: choose one with --label .*: 3, 7'):
        read_segmentation(tmp_path / 'a.nrrd')
    with pytest.raises(InputError, match="has no labels '5': choose one .*: 3, 7"):
        read_segmentation(tmp_path / 'a.nrrd', '5')


def test_a_segment_of_slicer_is_chosen_by_its_name(tmp_path: Path) -> None:
    T, shape = label_maps.around(np.eye(3), SPACING)
    shape_layer, other = label_maps.voxels(T, shape), np.zeros(shape, bool)
    other[10:60, 10:30, 10:30] = True       # overlaps the shape
    layers = SimpleITK.Compose(image(1 * shape_layer, T), image(1 * other, T))
    for i, name in enumerate(['Femur', 'Tumour']):
        for key, value in (('Name', name), ('LabelValue', '1'), ('Layer', str(i))):
            layers.SetMetaData(f'Segment{i}_{key}', value)
    path = tmp_path / 'a.seg.nrrd'
    SimpleITK.WriteImage(layers, str(path))
    assert_is_the_shape(*read_segmentation(path, 'femur'))
    with pytest.raises(InputError, match=r'has 2 labels: .*: 1 \(Femur\), 1 \(Tumour\)'):
        read_segmentation(path)
    with pytest.raises(InputError, match="has 2 labels '1'"):
        read_segmentation(path, '1')


def test_smoothing_removes_the_steps_of_the_voxels(tmp_path: Path) -> None:
    radius, spacing = 25.0, np.array([0.8, 0.8, 1.2])
    index = np.stack(np.meshgrid(*map(np.arange, (80, 80, 56)), indexing='ij'), axis=-1)
    centre = np.array([31.3, 32.1, 33.7])
    T = np.diag([*spacing, 1.0])
    ball = np.linalg.norm(index * spacing - centre, axis=-1) < radius
    SimpleITK.WriteImage(image(ball, T), str(tmp_path / 'ball.nii.gz'))
    vertices, _ = read_segmentation(tmp_path / 'ball.nii.gz')
    off = np.linalg.norm(1e3 * vertices - centre, axis=1) - radius
    assert np.sqrt(np.mean(off**2)) < 0.09 and abs(off.mean()) < 0.04
    np.testing.assert_allclose(1e3 * (vertices.min(axis=0) + vertices.max(axis=0)) / 2, centre,
                               atol=0.15)


def test_a_bone_at_the_edge_of_the_image_is_closed_and_reported(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    T, shape = label_maps.around(np.eye(3), SPACING)
    labels = label_maps.voxels(T, shape)[:, :, 20:]
    T[:3, 3] += T[:3, :3] @ [0, 0, 20]
    SimpleITK.WriteImage(image(labels, T), str(tmp_path / 'cut.nrrd'))
    with caplog.at_level(logging.WARNING, 'gsdf_registration'):
        vertices, faces = read_segmentation(tmp_path / 'cut.nrrd')
    assert 'reaches the edge of the image' in caplog.text
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


@pytest.mark.parametrize(('content', 'words'), [
    (b'no image', 'is damaged or no label map'), (b'', 'is empty')])
def test_a_damaged_file_is_named(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / 'a.nii.gz').write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_model(tmp_path / 'a.nii.gz', 'mm')
    assert words in caught.value.message and '\n' not in caught.value.message


def test_a_truncated_file_is_named(tmp_path: Path) -> None:
    path = write(tmp_path / 'a.nrrd')
    path.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(InputError, match='is damaged or no label map'):
        read_model(path, 'mm')


def test_an_image_is_no_segmentation(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=(20, 20, 20)).astype(np.float32)
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(values), str(tmp_path / 'ct.nii.gz'))
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(values[0]), str(tmp_path / 'slice.nii.gz'))
    SimpleITK.WriteImage(image(np.zeros((9, 9, 9)), np.eye(4)), str(tmp_path / 'empty.nrrd'))
    speck = np.zeros((9, 9, 9))
    speck[4, 4, 4] = 1
    SimpleITK.WriteImage(image(speck, np.eye(4)), str(tmp_path / 'speck.nrrd'))
    for name, words in (('ct.nii.gz', 'is an image, not a segmentation'),
                        ('slice.nii.gz', 'has 2 dimensions'), ('empty.nrrd', 'has 0 labels'),
                        ('speck.nrrd', 'the label has only 1 voxel')):
        with pytest.raises(InputError, match=words):
            read_model(tmp_path / name, 'mm')


def test_the_unit_of_a_segmentation_is_known(tmp_path: Path) -> None:
    path = write(tmp_path / 'a.nrrd')
    with pytest.raises(InputError, match='is a segmentation, which is in mm'):
        read_model(path, 'm')
    (tmp_path / 'a.stl').write_bytes(b'solid')
    with pytest.raises(InputError, match='is no segmentation: omit --label'):
        read_model(tmp_path / 'a.stl', 'mm', '3')
