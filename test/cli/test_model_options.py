# SPDX-License-Identifier: Apache-2.0
"""Test the options that choose a bone in a model, in every subcommand that takes a model."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from refusals import command_refusal as refusal

from gsdf_registration.cli.main import main
from gsdf_registration.field import load_field
from msg_adapters.truth import read_truth


@pytest.fixture(scope='module')
def pair(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a mesh of two ellipsoids, mm; the second is the larger."""
    small, large = (trimesh.creation.icosphere(3, radius) for radius in (20.0, 40.0))
    large.apply_scale([1.0, 1.3, 0.8])
    large.apply_translation([150.0, 0.0, 0.0])
    path = tmp_path_factory.mktemp('model') / 'pair.ply'
    trimesh.util.concatenate([small, large]).export(path)
    return path


def test_build_refuses_several_bones_and_lists_them(pair: Path, tmp_path: Path,
                                                    capsys: pytest.CaptureFixture[str]) -> None:
    message = refusal(capsys, 'build', pair, '--voxel', '5')
    assert 'has 2 bodies' in message and '--body largest: 1 (' in message and ', 2 (' in message
    for body, middle in (('largest', 0.15), ('1', 0.15), ('2', 0.0)):
        out = tmp_path / f'{body}.gsdf'
        assert main(['build', str(pair), '--voxel', '5', '--body', body, '-o', str(out)]) == 0
        np.testing.assert_allclose(load_field(out).bounds.mean(axis=0), [middle, 0, 0], atol=1e-4)


def test_the_other_subcommands_take_the_option(pair: Path, tmp_path: Path,
                                               capsys: pytest.CaptureFixture[str]) -> None:
    bag, points = tmp_path / 'bag', tmp_path / 'points.csv'
    simulate = ['simulate', pair, '--region', '150,0,30,25', '--points', '60', '-o', bag]
    assert '--body' in refusal(capsys, *simulate)
    assert main([str(word) for word in [*simulate, '--body', 'largest']]) == 0
    assert read_truth(bag.with_suffix('.yaml')).model.endswith('pair.ply')
    points.write_text('x,y,z\n1,2,3\n')
    settings = tmp_path / 'settings.yaml'
    settings.write_text('model: {voxel_size: 0.005}\n')
    for command in (['register', pair, points, '--unit', 'mm'],
                    ['replay', bag, '--model', pair, '--topic', '/probe/tip'],
                    ['show', points, '--model', pair, '--unit', 'mm', '-o', tmp_path / 'a.png']):
        command += ['--config', settings]
        assert '--body' in refusal(capsys, *command), command
        assert main([str(word) for word in [*command, '--body', '3']]) == 2
        assert 'has no body 3' in capsys.readouterr().err, command


def test_a_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                  capsys: pytest.CaptureFixture[str]) -> None:
    for module, name in (('SimpleITK', 'a.nii.gz'), ('highdicom.seg', 'a.dcm'),
                         ('vtk', 'a.vtp'), ('lxml', 'a.3mf')):
        monkeypatch.setitem(sys.modules, module, None)      # as if it were not installed
        (tmp_path / name).write_bytes(b'x')
        message = refusal(capsys, 'build', tmp_path / name)
        assert f'{module.partition(".")[0]}, which is not installed' in message
        assert "pip install 'gsdf_registration[ct]'" in message


@pytest.mark.skipif(importlib.util.find_spec('SimpleITK') is None,
                    reason='SimpleITK is not installed')
def test_build_takes_a_label_of_a_segmentation(tmp_path: Path,
                                               capsys: pytest.CaptureFixture[str]) -> None:
    import SimpleITK
    voxels = np.zeros((40, 40, 40), np.uint8)       # k, j, i
    voxels[5:35, 10:30, 15:25] = 2
    voxels[1:3, 1:3, 1:3] = 9
    image = SimpleITK.GetImageFromArray(voxels)
    image.SetSpacing([2.0, 2.0, 2.0])
    image.SetOrigin([100.0, 0.0, 0.0])
    path, out = tmp_path / 'bones.nrrd', tmp_path / 'bone.gsdf'
    SimpleITK.WriteImage(image, str(path))
    assert 'choose one with --label (model.label): 2, 9' in refusal(capsys, 'build', path)
    assert main(['build', str(path), '--label', '2', '--voxel', '4', '-o', str(out)]) == 0
    assert 'mm in the axes LPS, field of 4 mm voxels' in capsys.readouterr().out
    # voxels 15 to 24 lie between 129 and 149 mm
    np.testing.assert_allclose(1e3 * load_field(out).bounds,
                               [[129, 19, 9], [149, 59, 69]], atol=0.5)
