# SPDX-License-Identifier: Apache-2.0
"""A pose that is kept up while points come in: what is shown, when, and when it is enough."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from smooth_bone import T_TRACKER_BONE, ball_mesh, bone_field, field_of, touched

from gsdf_registration.common.config import Config
from gsdf_registration.common.result import Reason
from gsdf_registration.common.rigid import Array, exp, transform
from gsdf_registration.common.samples import Points
from gsdf_registration.field import Field
from gsdf_registration.field.model import load_model
from gsdf_registration.live import LivePose, LiveRegistration, LiveStatus
from gsdf_registration.live.assessment import FullAssessment
from gsdf_registration.registration.pipeline import register
from msg_adapters.recording import Recording
from msg_adapters.truth import Truth

BATCH = 10      # points between two calls of `follow`
LOOK = 120      # points between two looks


class Moment(NamedTuple):
    """What there was to see after a batch."""

    pose: LivePose | None
    ready: bool
    survey: FullAssessment | None   # if there was one


@pytest.fixture(scope='module')
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('GSDF_CACHE_DIR', str(tmp_path_factory.mktemp('cache')))
        yield


@pytest.fixture(scope='module')
def hip(hip_bone: Path, cache: None) -> Field:
    return load_model(str(hip_bone), 'mm')


@pytest.fixture(scope='module')
def hip_story(hip: Field, optical_run: tuple[Recording, Truth]) -> tuple[LiveRegistration,
                                                                         list[Moment]]:
    """Return what follows a whole recording, and what it told meanwhile."""
    live = LiveRegistration(hip, Config())
    return live, tell(live, optical_run[0].positions)


def points_of(positions: Array, stroke: int = 0) -> Points:
    count = len(positions)
    return Points(positions, 1e3 + np.arange(count) / 80.0, np.full(count, stroke, np.int32),
                  np.zeros(count, np.int32))


def tell(live: LiveRegistration, positions: Array, revision: int = 1) -> list[Moment]:
    """Feed points to a live registration in batches, with a look now and then."""
    points, story = points_of(positions), []
    for row in range(0, len(positions), BATCH):
        pose = live.follow(revision, Points(*(column[row:row + BATCH] for column in points)))
        survey = None
        if row % LOOK == LOOK - BATCH or row + BATCH >= len(positions):
            survey = live.look()(lambda: False)
            pose = live.accept(survey) or pose
        story.append(Moment(pose, live.ready, survey))
    return story


def off_by(pose: LivePose, truth: Array, field: Field) -> float:
    """Return the error of a pose, m (RMS) over the bone."""
    places = field.surface_points[::20].astype(np.float64)
    apart = transform(pose.T_tracker_bone, places) - transform(truth, places)
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def test_the_pose_shown_is_near_the_truth_from_the_first_to_the_last(
        hip_story: tuple[LiveRegistration, list[Moment]], hip: Field,
        optical_run: tuple[Recording, Truth]) -> None:
    truth = optical_run[1].T_tracker_bone
    _, story = hip_story
    errors = [off_by(moment.pose, truth, hip) for moment in story if moment.pose is not None]
    assert len(errors) > len(story) // 2
    assert max(errors) < 2e-3
    assert errors[-1] < 2e-4


def test_after_the_first_pose_there_is_one_with_every_batch(
        hip_story: tuple[LiveRegistration, list[Moment]]) -> None:
    shown = [moment.pose for moment in hip_story[1]]
    first = next(k for k, pose in enumerate(shown) if pose is not None)
    assert None not in shown[first:]
    # stamped as the newest point
    assert [pose.stamp for pose in shown[first:-1]] == [
        1e3 + (BATCH * (k + 1) - 1) / 80.0 for k in range(first, len(shown) - 1)]


def test_the_bone_is_searched_for_a_few_times_only(
        hip_story: tuple[LiveRegistration, list[Moment]]) -> None:
    searches = [m.survey for m in hip_story[1] if m.survey is not None and m.survey.searched]
    assert 1 <= len(searches) <= 8


def test_ready_is_said_once_and_a_registration_agrees(
        hip_story: tuple[LiveRegistration, list[Moment]], hip: Field,
        optical_run: tuple[Recording, Truth]) -> None:
    live, story = hip_story
    said = [moment.ready for moment in story]
    first = said.index(True)
    assert all(said[first:]) and story[first].survey.searched
    result = register(optical_run[0].positions[:BATCH * (first + 1)], hip)
    assert result.success
    assert off_by(story[first].pose, result.T_tracker_bone, hip) < 5e-5
    status = live.status()
    assert status.message.startswith('enough: register now; expected error 0.')
    assert status.reason is None and status.touch_next == ''


def test_the_same_batches_give_the_same_bits(hip: Field,
                                             optical_run: tuple[Recording, Truth]) -> None:
    a, b = (tell(LiveRegistration(hip, Config()), optical_run[0].positions[:240])
            for _ in range(2))
    assert a[-1].pose is not None
    assert [m.pose and (m.pose.T_tracker_bone.tobytes(), m.pose.covariance.tobytes())
            for m in a] == [
                m.pose and (m.pose.T_tracker_bone.tobytes(), m.pose.covariance.tobytes())
                for m in b]


def test_points_dropped_are_left_at_once_and_the_pose_follows(
        hip: Field, optical_run: tuple[Recording, Truth]) -> None:
    recording, truth = optical_run
    live = LiveRegistration(hip, Config())
    off = transform(exp([0.0, 0.0, 0.0, 0.004, 0.004, 0.0]), recording.positions[100:200])
    tell(live, np.concatenate([recording.positions[:300], off]))
    assert live.ready
    bad = off_by(live.accept(live.look(search=False)(lambda: False)), truth.T_tracker_bone, hip)
    assert live.follow(2, points_of(recording.positions[:300])) is None
    assert not live.ready and live.status() == LiveStatus()
    survey = live.look()(lambda: False)
    pose = live.accept(survey)
    assert pose is not None and not survey.searched     # at once, from where it was
    assert off_by(pose, truth.T_tracker_bone, hip) < min(bad, 4e-4)
    assert live.due
    survey = live.look()(lambda: False)
    live.accept(survey)
    assert survey.searched and live.ready


def test_what_was_looked_at_before_points_were_dropped_is_not_believed(
        hip: Field, optical_run: tuple[Recording, Truth]) -> None:
    live = LiveRegistration(hip, Config())
    positions = optical_run[0].positions[:240]
    live.follow(1, points_of(positions))
    late = live.look()(lambda: False)
    assert late.trusted
    live.follow(2, points_of(positions[:20]))
    assert live.accept(late) is None
    assert live.status() == LiveStatus()


def test_when_all_points_are_dropped_the_pose_goes_away(
        hip: Field, optical_run: tuple[Recording, Truth]) -> None:
    live = LiveRegistration(hip, Config())
    tell(live, optical_run[0].positions[:240])
    assert live.ready
    assert live.follow(2, points_of(np.zeros((0, 3)))) is None
    assert not live.ready and not live.due and live.status() == LiveStatus()
    assert live.follow(2, points_of(optical_run[0].positions[:5])) is None
    live.accept(live.look()(lambda: False))
    assert live.status().reason is Reason.TOO_FEW_POINTS


def test_other_points_in_their_place_are_searched_not_followed(
        hip: Field, optical_run: tuple[Recording, Truth]) -> None:
    recording, truth = optical_run
    live = LiveRegistration(hip, Config())
    tell(live, recording.positions[:240])
    moved = exp([0.0, 0.0, 0.1, 0.003, 0.0, 0.002])
    live.follow(2, points_of(transform(moved, recording.positions[:240])))
    survey = live.look()(lambda: False)
    pose = live.accept(survey)
    assert survey.searched and pose is not None
    assert off_by(pose, moved @ truth.T_tracker_bone, hip) < 1e-3


def test_points_on_one_round_patch_are_never_enough() -> None:
    radius = 0.03
    mesh = ball_mesh(np.full(3, radius), ((np.array([-1.0, 0.2, 0.4]), 0.4),))
    positions = transform(T_TRACKER_BONE, touched(360, 0, 2e-4, 0.035, mesh))
    live = LiveRegistration(field_of(mesh), Config())
    story = tell(live, positions[np.argsort(positions[:, 0])])
    assert not any(moment.ready for moment in story)
    status = live.status()
    assert status.reason in (Reason.UNDER_CONSTRAINED, Reason.AMBIGUOUS)
    assert status.touch_next.startswith('touch ') and status.touch_next in status.message


def test_another_bone_is_never_shown_for_long_and_never_enough(
        femur_bone: Path, optical_run: tuple[Recording, Truth], cache: None) -> None:
    live = LiveRegistration(load_model(str(femur_bone), 'mm'), Config())
    story = tell(live, optical_run[0].positions[:400])
    assert not any(moment.ready for moment in story)
    assert all(moment.pose is None for moment in story[len(story) // 2:])
    assert live.status().reason in (Reason.MODEL_MISMATCH, Reason.TOO_FEW_INLIERS)


@pytest.fixture(scope='module')
def small() -> tuple[Field, Array]:
    """Return a small bone and points on one side of it."""
    return bone_field(), transform(T_TRACKER_BONE, touched(1200, 0, 2e-4))


def test_stray_points_do_not_drag_the_pose(small: tuple[Field, Array]) -> None:
    field, positions = small
    live = LiveRegistration(field, Config())
    pose = tell(live, positions)[-1].pose
    assert pose is not None
    middle = T_TRACKER_BONE[:3, 3]
    stray = middle + 2.0 * (positions[::100] - middle)
    after = live.follow(1, points_of(stray))
    assert after is not None
    np.testing.assert_array_equal(after.T_tracker_bone, pose.T_tracker_bone)


def test_a_guess_is_searched_round_first(small: tuple[Field, Array]) -> None:
    field, positions = small
    live = LiveRegistration(field, Config())
    live.follow(1, points_of(positions))
    guess = exp([0.05, 0.0, -0.05, 0.002, 0.001, 0.0]) @ np.linalg.inv(T_TRACKER_BONE)
    pose = live.accept(live.look(guess=guess)(lambda: False))
    assert pose is not None and live.ready
    assert off_by(pose, T_TRACKER_BONE, field) < 3e-4


def test_of_many_points_only_so_many_are_used(small: tuple[Field, Array]) -> None:
    field, positions = small
    live = LiveRegistration(field, Config.from_flat({'live.max_points': 200}))
    story = tell(live, positions)
    assert live.status().used == 200
    assert story[-1].survey is not None and story[-1].survey.on_strokes > 1000
    assert len(story[-1].survey.weights) == 1200     # the others are weighed all the same
    assert (story[-1].survey.weights > 0.5).sum() > 1000
    assert off_by(story[-1].pose, T_TRACKER_BONE, field) < 3e-4


def test_after_a_refused_registration_ready_is_not_said_until_it_was_searched_for_anew(
        small: tuple[Field, Array]) -> None:
    field, positions = small
    live = LiveRegistration(field, Config())
    tell(live, positions)
    assert live.ready
    live.registered(False)
    assert not live.ready and not live.due
    live.registered(True)
    assert live.due
