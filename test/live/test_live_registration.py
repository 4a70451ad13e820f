# SPDX-License-Identifier: Apache-2.0
"""The live registration: which pose it shows, and when the points suffice."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, ball_mesh, bone_field, field_of, touched_points

from gsdf_registration.common.config import Config
from gsdf_registration.common.downsampling import farthest_point_sample
from gsdf_registration.common.result import Reason
from gsdf_registration.common.rigid import Array, exp, transform
from gsdf_registration.common.samples import Points, without_tools
from gsdf_registration.field import Field
from gsdf_registration.field.model import load_model
from gsdf_registration.live import LivePose, LiveRegistration, LiveStatus
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.registration.pipeline import register
from msg_adapters.recording import Recording
from msg_adapters.truth import Truth

BATCH = 10      # points between two calls of `follow`
ASSESSMENT = 120    # points between two full assessments


class Step(NamedTuple):
    """The output after one batch."""

    pose: LivePose | None
    ready: bool
    assessment: FullAssessment | None   # if there was one


@pytest.fixture(scope='module')
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('GSDF_CACHE_DIR', str(tmp_path_factory.mktemp('cache')))
        yield


@pytest.fixture(scope='module')
def hip(hip_bone: Path, cache: None) -> Field:
    return load_model(str(hip_bone), 'mm')


@pytest.fixture(scope='module')
def hip_steps(hip: Field, optical_recording: tuple[Recording, Truth]) -> tuple[LiveRegistration,
                                                                         list[Step]]:
    """Return a live registration of a whole recording, and its steps."""
    live = LiveRegistration(hip, Config())
    return live, run(live, optical_recording[0].positions)


def points_of(positions: Array, stroke: int = 0) -> Points:
    count = len(positions)
    return without_tools(positions, 1e3 + np.arange(count) / 80.0, np.full(count, stroke, np.int32),
                         np.zeros(count, np.int32))


def run(live: LiveRegistration, positions: Array, revision: int = 1) -> list[Step]:
    """Add points to a live registration in batches, with a full assessment from time to time."""
    points, steps = points_of(positions), []
    for row in range(0, len(positions), BATCH):
        pose = live.follow(revision, Points(*(column[:row + BATCH] for column in points)))
        assessment = None
        if row % ASSESSMENT == ASSESSMENT - BATCH or row + BATCH >= len(positions):
            assessment = assess(live)
            pose = live.accept(assessment) or pose
        steps.append(Step(pose, live.ready, assessment))
    return steps


def assess(live: LiveRegistration, **options: Any) -> FullAssessment:
    """Run a full assessment."""
    return live.assessment_job(**options)(lambda: False)


def error_of(pose: LivePose, truth: Array, field: Field) -> float:
    """Return the error of a pose, m (RMS) over the bone."""
    places = field.surface_points[::20].astype(np.float64)
    difference = transform(pose.T_tracker_bone, places) - transform(truth, places)
    return float(np.sqrt((difference**2).sum(axis=1).mean()))


def test_every_pose_is_near_the_truth(
        hip_steps: tuple[LiveRegistration, list[Step]], hip: Field,
        optical_recording: tuple[Recording, Truth]) -> None:
    truth = optical_recording[1].T_tracker_bone
    _, steps = hip_steps
    errors = [error_of(step.pose, truth, hip) for step in steps if step.pose is not None]
    assert len(errors) > len(steps) // 2
    assert max(errors) < 2e-3
    assert errors[-1] < 2e-4


def test_every_batch_after_the_first_pose_gives_a_pose(
        hip_steps: tuple[LiveRegistration, list[Step]]) -> None:
    poses = [step.pose for step in hip_steps[1]]
    first = next(k for k, pose in enumerate(poses) if pose is not None)
    assert None not in poses[first:]
    # stamped as the newest point
    assert [pose.stamp for pose in poses[first:-1]] == [
        1e3 + (BATCH * (k + 1) - 1) / 80.0 for k in range(first, len(poses) - 1)]


def test_searches_only_a_few_times(
        hip_steps: tuple[LiveRegistration, list[Step]]) -> None:
    assessments = [step.assessment for step in hip_steps[1] if step.assessment is not None]
    assert 1 <= sum(each.searched for each in assessments) <= 8


def test_stays_ready_and_agrees_with_a_registration(
        hip_steps: tuple[LiveRegistration, list[Step]], hip: Field,
        optical_recording: tuple[Recording, Truth]) -> None:
    live, steps = hip_steps
    ready = [step.ready for step in steps]
    first = ready.index(True)
    assert all(ready[first:]) and steps[first].assessment.searched
    result = register(optical_recording[0].positions[:BATCH * (first + 1)], hip)
    assert result.success
    assert error_of(steps[first].pose, result.T_tracker_bone, hip) < 5e-5
    status = live.status()
    assert status.message.startswith('enough points: register now; expected error ')
    assert status.reason is None and status.touch_next == ''


def test_same_batches_give_bitwise_equal_poses(hip: Field,
                                             optical_recording: tuple[Recording, Truth]) -> None:
    a, b = (run(LiveRegistration(hip, Config()), optical_recording[0].positions[:240])
            for _ in range(2))
    assert a[-1].pose is not None
    assert [m.pose and (m.pose.T_tracker_bone.tobytes(), m.pose.covariance.tobytes())
            for m in a] == [
                m.pose and (m.pose.T_tracker_bone.tobytes(), m.pose.covariance.tobytes())
                for m in b]


def test_continues_from_the_previous_pose_after_points_were_dropped(
        hip: Field, optical_recording: tuple[Recording, Truth]) -> None:
    recording, truth = optical_recording
    live = LiveRegistration(hip, Config())
    displaced = transform(exp([0.0, 0.0, 0.0, 0.004, 0.004, 0.0]), recording.positions[100:200])
    run(live, np.concatenate([recording.positions[:300], displaced]))
    assert live.ready
    error_before = error_of(live.accept(assess(live, search=False)), truth.T_tracker_bone, hip)
    assert live.follow(2, points_of(recording.positions[:300])) is None
    assert not live.ready and live.status() == LiveStatus()
    assessment = assess(live)
    pose = live.accept(assessment)
    assert pose is not None and not assessment.searched     # followed from the previous pose
    assert error_of(pose, truth.T_tracker_bone, hip) < min(error_before, 4e-4)
    assert live.search_due
    assessment = assess(live)
    live.accept(assessment)
    assert assessment.searched and live.ready


def test_ignores_an_assessment_of_points_dropped_since(
        hip: Field, optical_recording: tuple[Recording, Truth]) -> None:
    live = LiveRegistration(hip, Config())
    positions = optical_recording[0].positions[:240]
    live.follow(1, points_of(positions))
    late = assess(live)
    assert late.trusted
    live.follow(2, points_of(positions[:20]))
    assert live.accept(late) is None
    assert live.status() == LiveStatus()


def test_has_no_pose_after_all_points_were_dropped(
        hip: Field, optical_recording: tuple[Recording, Truth]) -> None:
    live = LiveRegistration(hip, Config())
    run(live, optical_recording[0].positions[:240])
    assert live.ready
    assert live.follow(2, points_of(np.zeros((0, 3)))) is None
    assert not live.ready and not live.search_due and live.status() == LiveStatus()
    assert live.follow(2, points_of(optical_recording[0].positions[:5])) is None
    live.accept(assess(live))
    assert live.status().reason is Reason.TOO_FEW_POINTS


def test_searches_after_points_were_replaced(
        hip: Field, optical_recording: tuple[Recording, Truth]) -> None:
    recording, truth = optical_recording
    live = LiveRegistration(hip, Config())
    run(live, recording.positions[:240])
    moved = exp([0.0, 0.0, 0.1, 0.003, 0.0, 0.002])
    live.follow(2, points_of(transform(moved, recording.positions[:240])))
    assessment = assess(live)
    pose = live.accept(assessment)
    assert assessment.searched and pose is not None
    assert error_of(pose, moved @ truth.T_tracker_bone, hip) < 1e-3


def test_is_never_ready_with_points_on_one_spherical_patch() -> None:
    radius = 0.03
    mesh = ball_mesh(np.full(3, radius), ((np.array([-1.0, 0.2, 0.4]), 0.4),))
    positions = transform(T_TRACKER_BONE, touched_points(360, 0, 2e-4, 0.035, mesh))
    live = LiveRegistration(field_of(mesh), Config())
    steps = run(live, positions[np.argsort(positions[:, 0])])
    assert not any(step.ready for step in steps)
    status = live.status()
    assert status.reason in (Reason.UNDER_CONSTRAINED, Reason.AMBIGUOUS)
    assert status.touch_next.startswith('touch ') and status.touch_next in status.message


def test_is_never_ready_on_the_wrong_bone(
        femur_bone: Path, optical_recording: tuple[Recording, Truth], cache: None) -> None:
    live = LiveRegistration(load_model(str(femur_bone), 'mm'), Config())
    steps = run(live, optical_recording[0].positions[:400])
    assert not any(step.ready for step in steps)
    assert all(step.pose is None for step in steps[len(steps) // 2:])
    assert live.status().reason in (Reason.MODEL_MISMATCH, Reason.TOO_FEW_INLIERS)


@pytest.fixture(scope='module')
def small() -> tuple[Field, Array]:
    """Return a small bone and points on one side of it."""
    return bone_field(), transform(T_TRACKER_BONE, touched_points(1200, 0, 2e-4))


def test_isolated_points_do_not_change_the_pose(small: tuple[Field, Array]) -> None:
    field, positions = small
    live = LiveRegistration(field, Config())
    pose = run(live, positions)[-1].pose
    assert pose is not None
    centre = T_TRACKER_BONE[:3, 3]
    isolated = centre + 2.0 * (positions[::100] - centre)
    after = live.follow(1, points_of(np.concatenate([positions, isolated])))
    assert after is not None
    np.testing.assert_array_equal(after.T_tracker_bone, pose.T_tracker_bone)


def test_searches_around_a_guess_first(small: tuple[Field, Array]) -> None:
    field, positions = small
    live = LiveRegistration(field, Config())
    live.follow(1, points_of(positions))
    guess = exp([0.05, 0.0, -0.05, 0.002, 0.001, 0.0]) @ np.linalg.inv(T_TRACKER_BONE)
    pose = live.accept(assess(live, guess=guess))
    assert pose is not None and live.ready
    assert error_of(pose, T_TRACKER_BONE, field) < 3e-4


def test_uses_at_most_the_configured_number_of_points(small: tuple[Field, Array]) -> None:
    field, positions = small
    live = LiveRegistration(field, Config.from_flat({'live.max_points': 200}))
    steps = run(live, positions)
    assert live.status().used == 200
    assert steps[-1].assessment is not None and steps[-1].assessment.on_strokes > 1000
    assert len(steps[-1].assessment.weights) == 1200     # all points have a weight
    assert (steps[-1].assessment.weights > 0.5).sum() > 1000
    assert error_of(steps[-1].pose, T_TRACKER_BONE, field) < 4e-4


def test_starts_again_with_another_radius_of_the_tip(small: tuple[Field, Array]) -> None:
    field, positions = small
    live = LiveRegistration(field, Config())
    run(live, positions)
    running = assess(live)
    live.config = Config().replaced({'probe.tip_radius': 0.001})
    assert live.accept(running) is None and not live.ready and live.count == 0
    live.follow(1, points_of(positions))
    live.accept(assess(live))
    assert live.assessment is not None      # the points lie inside the offset surface
    assert live.assessment.residuals_m.mean() < -2e-4


def test_is_not_ready_after_a_refused_registration_until_the_next_search(
        small: tuple[Field, Array]) -> None:
    field, positions = small
    live = LiveRegistration(field, Config())
    run(live, positions)
    assert live.ready
    live.registration_finished(False)
    assert not live.ready and not live.search_due
    live.registration_finished(True)
    assert live.search_due


@pytest.mark.parametrize('mode', ['touches', 'both'])
def test_follows_touches_between_which_the_tip_moves_through_the_air(
        hip: Field, optical_recording: tuple[Recording, Truth], mode: str) -> None:
    recording, truth = optical_recording
    on_bone = recording.positions[recording.positions[:, 0].argsort()]
    near = np.abs(hip.sample(transform(np.linalg.inv(truth.T_tracker_bone), on_bone))[0]) < 3e-4
    places = on_bone[near][farthest_point_sample(on_bone[near], 45)]
    lift = places.mean(axis=0) - truth.T_tracker_bone[:3, 3]
    lift *= 0.03 / np.linalg.norm(lift)
    path, rng = [], np.random.default_rng(0)
    for a, b in zip(places, np.roll(places, -1, axis=0)):
        s = np.linspace(0.0, 1.0, 12)[:, None]
        path += [np.repeat(a[None], 24, axis=0), a + s * (b - a) + np.sin(np.pi * s) * lift]
    positions = np.concatenate(path) + 1.5e-4 * rng.normal(size=(45 * 36, 3))
    live = LiveRegistration(hip, Config.from_flat({'collect.mode': mode,
                                                    'model.surface_error': 0.0}))
    steps = run(live, positions)
    last = steps[-1].assessment
    assert last is not None and last.pose is not None and live.ready
    assert last.used == len(last.pose.solution.touches) and last.used > 40
    assert error_of(steps[-1].pose, truth.T_tracker_bone, hip) < 1e-3
    assert len(last.weights) == len(positions)
