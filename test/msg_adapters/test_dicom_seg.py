# SPDX-License-Identifier: Apache-2.0
"""Test that a segment of a DICOM segmentation is read at its place in the patient."""

from __future__ import annotations

from pathlib import Path

import highdicom
import label_maps
import numpy as np
import pydicom
import pytest
from highdicom.seg import SegmentAlgorithmTypeValues, SegmentationTypeValues, SegmentDescription
from pydicom.sr.codedict import codes
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, rotation_exp
from msg_adapters.points import read_model

SPACING = np.array([1.0, 1.2, 1.6])     # of columns, rows and slices


def ct_series(T_lps_index: Array, shape: tuple[int, int, int]) -> list[pydicom.Dataset]:
    """Return the slices of a series; the index counts columns, rows and slices."""
    study, series, frame = generate_uid(), generate_uid(), generate_uid()
    axes, origin = T_lps_index[:3, :3] / SPACING, T_lps_index[:3, 3]
    slices = []
    for k in range(shape[2]):
        each = pydicom.Dataset()
        each.file_meta = pydicom.dataset.FileMetaDataset()
        each.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        each.SOPClassUID, each.SOPInstanceUID = CTImageStorage, generate_uid()
        each.StudyInstanceUID, each.SeriesInstanceUID = study, series
        each.FrameOfReferenceUID = frame
        each.PatientID, each.PatientName = 'test', 'Doe^Jane'
        each.PatientBirthDate = each.PatientSex = each.AccessionNumber = each.StudyID = ''
        each.StudyDate = each.StudyTime = each.ReferringPhysicianName = ''
        each.Modality, each.InstanceNumber = 'CT', k + 1
        each.Rows, each.Columns = shape[1], shape[0]
        each.PixelSpacing = [float(SPACING[1]), float(SPACING[0])]
        each.SliceThickness = float(SPACING[2])
        each.ImageOrientationPatient = [float(f'{value:.10f}') for value in axes[:, :2].T.ravel()]
        position = origin + T_lps_index[:3, 2] * k
        each.ImagePositionPatient = [float(f'{value:.8f}') for value in position]
        each.PixelRepresentation, each.SamplesPerPixel = 0, 1
        each.BitsAllocated = each.BitsStored = 16
        each.HighBit, each.PhotometricInterpretation = 15, 'MONOCHROME2'
        each.PixelData = bytes(2 * shape[0] * shape[1])
        slices.append(each)
    return slices


def describe(number: int, name: str) -> SegmentDescription:
    return SegmentDescription(
        segment_number=number, segment_label=name,
        segmented_property_category=codes.SCT.AnatomicalStructure,
        segmented_property_type=codes.SCT.Bone,
        algorithm_type=SegmentAlgorithmTypeValues.MANUAL)


@pytest.fixture(scope='module')
def segmentation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a segmentation of an oblique series with two segments."""
    T, shape = label_maps.around(rotation_exp([0.3, -0.2, 0.4]), SPACING)
    inside = label_maps.voxels(T, shape)
    other = np.zeros_like(inside)
    other[:5, :5, :5] = True
    frames = np.stack([inside, other], axis=-1).transpose(2, 1, 0, 3).astype(np.uint8)
    made = highdicom.seg.Segmentation(
        source_images=ct_series(T, shape), pixel_array=frames,
        segmentation_type=SegmentationTypeValues.BINARY,
        segment_descriptions=[describe(1, 'Femur'), describe(2, 'Plate')],
        series_instance_uid=generate_uid(), series_number=2, sop_instance_uid=generate_uid(),
        instance_number=1, manufacturer='test', manufacturer_model_name='test',
        software_versions='1', device_serial_number='1')
    path = tmp_path_factory.mktemp('seg') / 'bones.dcm'
    made.save_as(path)
    return path


@pytest.mark.parametrize('label', ['1', 'Femur'])
def test_the_surface_is_that_of_the_patient(segmentation: Path, label: str) -> None:
    vertices, faces, _ = read_model(segmentation, 'mm', label)
    off = np.abs(label_maps.distances(1e3 * vertices))
    assert faces is not None and np.sqrt(np.mean(off**2)) < 0.3 and off.max() < 1.7
    for end in (label_maps.LEFT, label_maps.BACK):
        assert np.linalg.norm(1e3 * vertices - end, axis=1).min() < 1.2


def test_the_segments_are_listed(segmentation: Path) -> None:
    for label, words in (('', r'has 2 labels: .*: 1 \(Femur\), 2 \(Plate\)'),
                         ('Tibia', "has no labels 'Tibia'")):
        with pytest.raises(InputError, match=words):
            read_model(segmentation, 'mm', label)


def test_another_file_is_named(tmp_path: Path) -> None:
    (tmp_path / 'a.dcm').write_bytes(b'no DICOM')
    with pytest.raises(InputError) as caught:
        read_model(tmp_path / 'a.dcm', 'mm')
    assert 'is no DICOM segmentation' in caught.value.message and '\n' not in caught.value.message
