# SPDX-License-Identifier: Apache-2.0
"""Trials: their names determine the data, and the data have the requested properties."""

from __future__ import annotations

import shutil
from dataclasses import fields
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.protocol.cases import MIRROR, Case, find_cases
from benchmarks.protocol.trials import (
    IMPOSSIBLE,
    POSSIBLE,
    SCENARIOS,
    Problem,
    Trial,
    make,
    trials,
)
from gsdf_registration.common import rigid
from gsdf_registration.common.config import Config
from gsdf_registration.common.result import InputError
from gsdf_registration.simulation.interference import Kind


@pytest.fixture(scope='module')
def cases(hip_bone: Path, femur_bone: Path) -> list[Case]:
    return find_cases([femur_bone, hip_bone])


def problem(cases: list[Case], scenario: str, seed: int = 0, region: str = 'acetabulum',
            **more: object) -> Problem:
    case = next(case for case in cases if case.region == region)
    return make(Trial(case, SCENARIOS[scenario], seed, case.bone, **more))  # type: ignore[arg-type]


def test_regions_from_the_file_name(cases: list[Case]) -> None:
    assert [case.name for case in cases] == ['femur/proximal_femur', 'femur/condyles',
                                             'hip/acetabulum']


def test_regions_from_the_shape_or_as_given(hip_bone: Path, femur_bone: Path,
                                            tmp_path: Path) -> None:
    for k, bone in enumerate((hip_bone, femur_bone)):
        shutil.copy(bone, tmp_path / f'bone{k}.ply')
    files = sorted(tmp_path.iterdir())
    assert [case.region for case in find_cases(files)] == ['acetabulum', 'proximal_femur',
                                                           'condyles']
    assert [case.region for case in find_cases(files, ['condyles'])] == 2 * ['condyles']
    with pytest.raises(InputError, match='region "skull" is unknown'):
        find_cases(files, ['skull'])


@pytest.mark.parametrize('file, person, side', [
    ('vsd_z001_femur_R.ply', 'vsd_z001', '_r'), ('tlem2ct_femur_L.ply', 'tlem2', '_l'),
    ('tlem2mri_femur_R.ply', 'tlem2', '_r'), ('femur.ply', '', '')])
def test_persons_and_sides_from_the_file_name(file: str, person: str, side: str) -> None:
    case = Case(file, 'condyles')
    assert (case.person, case.side, case.kind) == (person, side, 'femur')


def test_the_name_determines_the_data(cases: list[Case]) -> None:
    again, other = problem(cases, 'mixed_40'), problem(cases, 'mixed_40', seed=1)
    np.testing.assert_array_equal(problem(cases, 'mixed_40').recording.positions,
                                  again.recording.positions)
    assert len(other.recording.positions) != len(again.recording.positions)
    assert again.trial.name == 'hip/acetabulum/mixed_40/0'
    # the same on any machine, in any process
    assert again.trial.random().integers(2**62) == 607888919055342931


@pytest.mark.parametrize('name', [
    name for name, scenario in SCENARIOS.items() if not (
        scenario.hard or scenario.touches or scenario.rest or scenario.real_model)])
def test_shares_and_noise_are_as_requested(cases: list[Case], name: str) -> None:
    made = problem(cases, name, region='condyles')
    run, asked = made.recording, made.trial.scenario
    assert 600 <= (run.kinds == Kind.SURFACE).sum() <= 1000
    for share in fields(asked.interference):
        got = np.mean(run.kinds == Kind[share.name.upper()])
        assert got == pytest.approx(getattr(asked.interference, share.name), abs=2e-3)
    error = run.positions - rigid.transform(run.T_tracker_bone, run.tips)
    np.testing.assert_allclose(error.std(axis=0), np.broadcast_to(asked.sigma, 3), rtol=0.12)
    assert np.abs(made.field.sample(made.touched)[0]).max() < 2e-4


def test_rotations_are_arbitrary_or_within_an_angle(cases: list[Case]) -> None:
    def turns(angle: float | None) -> list[float]:
        return [rigid.angle_between(np.eye(3), problem(cases, 'clean', seed=k, angle=angle)
                                    .recording.T_tracker_bone[:3, :3]) for k in range(20)]
    assert max(turns(None)) > np.radians(140.0)
    assert max(turns(np.radians(10.0))) < np.radians(18.0)


def test_more_trials_contain_fewer(cases: list[Case]) -> None:
    def names(n: int, **more: int) -> list[str]:
        return [t.name for t in islice(trials(cases, list(SCENARIOS.values()), **more), n)]
    assert names(500)[:100] == names(100)
    assert len(set(names(500))) == 500
    other_people = {'other_person', 'other_person_optical', 'other_scan'}
    assert {name.split('/')[2] for name in names(500)} == set(SCENARIOS) - other_people
    assert names(3, seed=7)[0].endswith('/7')
    assert list(trials(cases, [SCENARIOS['other_person']])) == []


def test_other_bones_and_other_persons() -> None:
    of_many = [Case(f'{bone}.ply', region) for bone, region in (
        ('a_hip_R', 'acetabulum'), ('b_hip_L', 'acetabulum'), ('a_femur', 'condyles'),
        ('a_hip_L', 'acetabulum'))]
    for trial in islice(trials(of_many, [SCENARIOS['other_bone']]), 20):
        assert ('hip' in trial.case.bone) != ('hip' in trial.model)
    asked = list(islice(trials(of_many, [SCENARIOS['other_person']]), 20))
    assert {t.case.bone for t in asked} == {'a_hip_R.ply', 'b_hip_L.ply', 'a_hip_L.ply'}
    assert all(t.case.bone[0] != t.model[0] and 'hip' in t.model for t in asked)
    assert {t.model for t in asked if t.case.bone[0] == 'b'} == {'a_hip_R.ply', 'a_hip_L.ply'}


def test_another_scan_of_the_same_bone(femur_bone: Path, femur_surface: tuple[np.ndarray, ...],
                                       tmp_path: Path) -> None:
    vertices, faces = femur_surface
    T = rigid.exp([0.4, -1.0, 2.0, 0.3, -0.1, 0.2])
    shutil.copy(femur_bone, tmp_path / 'ann_ct_femur.ply')
    trimesh.Trimesh(1e3 * rigid.transform(T, vertices), faces, process=False).export(
        tmp_path / 'ann_mri_femur.ply')
    shutil.copy(femur_bone, tmp_path / 'bob_femur.ply')
    scans = find_cases(sorted(tmp_path.glob('*.ply')), ['condyles'])
    selected = next(t for t in trials(scans, [SCENARIOS['other_scan']]) if 'ct' in t.case.bone)
    assert Path(selected.model).name == 'ann_mri_femur.ply'
    made = make(selected)
    # the ground truth is the pose of the model, and the points are on it
    assert np.abs(made.field.sample(made.touched)[0]).max() < 3e-4
    back = rigid.transform(rigid.inverse(made.recording.T_tracker_bone), made.recording.positions)
    assert np.sqrt(np.mean(made.field.sample(back)[0] ** 2)) == pytest.approx(5e-4, rel=0.15)


def test_cup_only(cases: list[Case]) -> None:
    made = problem(cases, 'cup_only')
    assert 0.02 < np.ptp(made.touched, axis=0).max() < 0.05
    # concave: moved along the outward normals, the points come together
    _, n = made.field.sample(made.touched)
    assert np.trace(np.cov((made.touched + 0.02 * n).T)) < 0.3 * np.trace(np.cov(made.touched.T))


def test_shaft_only(cases: list[Case]) -> None:
    made = problem(cases, 'shaft_only', region='proximal_femur')
    z = made.touched[:, 2]      # the long axis of this femur, from 0 to 0.44 m
    assert z.min() > 0.1 and z.max() < 0.34
    _, n = made.field.sample(made.touched)
    assert np.abs(n[:, 2]).mean() < 0.15
    assert not SCENARIOS['shaft_only'].suits('condyles')


def test_mirror_images(cases: list[Case]) -> None:
    mirrored = problem(cases, 'mirrored', region='condyles')
    assert np.abs(mirrored.field.sample(mirrored.touched * MIRROR)[0]).max() < 2e-4
    assert np.abs(mirrored.field.sample(mirrored.touched)[0]).max() > 1e-3
    other_side = problem(cases, 'contralateral', region='condyles')
    assert np.abs(other_side.field.sample(other_side.touched * MIRROR)[0]).max() < 2e-4
    assert np.abs(other_side.field.sample(other_side.touched)[0]).max() > 1e-3


def test_objects_and_noise(cases: list[Case]) -> None:
    for seed in range(6):
        made = problem(cases, 'object_only', seed)
        assert 0.015 < np.ptp(made.recording.tips, axis=0).max() < 0.061
    noise = problem(cases, 'noise_only')
    assert not noise.recording.on_bone.any() and len(noise.recording.positions) >= 600
    assert np.ptp(noise.recording.tips, axis=0) == pytest.approx(
        1.2 * np.ptp(noise.field.bounds, axis=0), rel=0.05)


def test_wrong_and_hard_scenarios() -> None:
    wrong = {name for name, scenario in SCENARIOS.items() if scenario.wrong}
    assert {name.removesuffix('_optical') for name in wrong} == set(IMPOSSIBLE)
    assert {name for name, scenario in SCENARIOS.items() if scenario.hard} == wrong | {*POSSIBLE}


@pytest.mark.parametrize('name, settings', [
    ('clean', {}), ('ball_1', {'probe.tip_radius': 0.001}), ('ct_optical', {}),
    ('mri', {'model.surface_error': 5e-4}), ('smooth_0.3_8', {'model.surface_error': 3e-4}),
    ('tip_off', {'probe.tip_error': 5e-4})])
def test_the_user_sets_what_is_known_of_probe_and_model(name: str,
                                                        settings: dict[str, float]) -> None:
    defaults = Config().flat()
    assert {key: value for key, value in SCENARIOS[name].settings.items()
            if value != defaults[key]} == settings


def test_names_a_bone_without_the_region(hip_bone: Path, tmp_path: Path) -> None:
    shutil.copy(hip_bone, tmp_path / 'a_femur.ply')
    case = Case(str(tmp_path / 'a_femur.ply'), 'proximal_femur')
    with pytest.raises(InputError, match=r'a_femur\.ply: the bone has no head'):
        make(Trial(case, SCENARIOS['clean'], 0, case.bone))
