# SPDX-License-Identifier: Apache-2.0
"""What an operator does, in order and out of order, from one thread and from several."""

from __future__ import annotations

import copy
import dataclasses
import json
import re
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import trimesh

from gsdf_registration.bone import make_bone
from gsdf_registration.config import Config
from gsdf_registration.field import Field, build_field
from gsdf_registration.result import InputError, Reason, RegistrationResult
from gsdf_registration.rigid import Array, exp, transform
from gsdf_registration.session import Session
from gsdf_registration.session import session as session_module
from gsdf_registration.session.collection import Rejection

RATE = 80.0
T_TRACKER_BONE = exp([0.3, -0.8, 0.5, 0.1, -0.2, -1.0])
LANDMARKS = np.array([[0.03, 0.0, 0.0], [0.0, 0.045, 0.0], [0.0, 0.0, 0.07]])
CONFIG = Config.from_flat({'landmarks.names': ['x', 'y', 'z'],
                           'landmarks.positions': LANDMARKS.ravel().tolist()})


def bone(width: float = 0.03) -> Field:
    """Return a bone like a potato: no two of its sides are alike."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    vertices = ball.vertices * [width, 0.045, 0.07]
    vertices *= 1.0 + 0.15 * np.exp(-20.0 * (
        (ball.vertices - [0.6, 0.6, 0.5])**2).sum(axis=1, keepdims=True))
    return build_field(make_bone(vertices, ball.faces), 0.002)


@pytest.fixture(scope='module')
def field() -> Field:
    return bone()


def touched(field: Field, count: int = 300) -> Array:
    """Return points of the surface, far from one another from one to the next."""
    rows = np.linspace(0, len(field.surface_points) - 1, count).astype(int)
    return transform(T_TRACKER_BONE, field.surface_points[rows].astype(np.float64))


def send(session: Session,
         points: Array,
         start: float = 0.0,
         **more: Any) -> list[Rejection | None]:
    """Send points slowly enough for the speed gate."""
    return [session.add_point(start + i, point, 'cam', **more) for i, point in enumerate(points)]


def hold(session: Session, point: Array, start: float, **more: Any) -> float:
    for i in range(50):
        session.add_point(start + i / RATE, point, 'cam', **more)
    return start + 51 / RATE


def landmarked(field: Field, config: Config = CONFIG) -> Session:
    """Return a session with all landmarks captured."""
    session = Session(config, field)
    time = 0.0
    for point in transform(T_TRACKER_BONE, LANDMARKS):
        time = hold(session, point, time) + 1.0
        assert session.capture_landmark().success
    return session


def registered(field: Field) -> Session:
    session = landmarked(field)
    send(session, touched(field), start=100.0)
    assert session.register().success
    return session


def test_the_whole_job(field: Field) -> None:
    session = landmarked(field)
    send(session, touched(field), start=100.0)
    result = session.register()
    assert result.success
    error = transform(result.T_tracker_bone, LANDMARKS) - transform(T_TRACKER_BONE, LANDMARKS)
    assert np.abs(error).max() < 2e-4
    status = session.status()
    assert (status.state, status.reason, status.pose_frame_id) == ('registered', Reason.CONVERGED,
                                                                   'cam')
    assert status.result is status.pose_result is result
    assert result.received == status.received == 450
    assert len(session.registered_points().stamps) == len(result.residuals_m) == status.kept


def test_each_state_and_its_sentence(field: Field) -> None:
    session = Session(CONFIG)
    assert session.status().state == 'no_model' and 'model.path' in session.status().message
    session.set_model(field)
    assert session.status().state == 'collecting'
    assert session.status(
    ).message == 'collecting; 0 points in 0 strokes held; next landmark is "x"'
    session.collect(False)
    assert session.status().state == 'idle'
    session.register()
    assert session.status().state == 'refused' and session.status().message.startswith(
        '0 points are too few')
    session.collect(True)
    assert session.status().state == 'collecting'


def test_automatic_collection_can_be_off(field: Field) -> None:
    session = Session(Config.from_flat({'collect.automatic': False}), field)
    assert session.status().state == 'idle'
    assert session.add_point(0.0, (0.0, 0.0, 0.0), 'cam') is Rejection.NOT_COLLECTING
    assert session.collect(True).success
    assert session.add_point(1.0, (0.0, 0.0, 0.0), 'cam') is None


def test_without_a_model_there_is_no_registration() -> None:
    assert Session(CONFIG).register().reason is Reason.NO_MODEL


def test_a_first_guess_may_be_given(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, touched(field))
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    assert session.register(landmarks=(LANDMARKS, transform(T_TRACKER_BONE, LANDMARKS))).success


def test_a_refusal_leaves_the_last_good_pose(field: Field) -> None:
    session = registered(field)
    good = session.status().pose_result
    session.undo(), session.clear()
    assert session.register().reason is Reason.TOO_FEW_POINTS
    status = session.status()
    assert status.state == 'refused' and status.pose_result is good and status.result is not good


def test_strokes_and_undo(field: Field) -> None:
    session = Session(CONFIG, field)
    line = np.linspace([0.0, 0.0, 0.0], [0.1, 0.0, 0.0], 100)
    for stroke in range(3):
        assert session.collect(True).success
        for i, point in enumerate(line):
            session.add_point(10.0 * stroke + i / RATE, point, 'cam')
        session.collect(False)
    assert (session.status().kept, session.status().strokes) == (300, 3)
    answer = session.undo()
    assert answer.success
    assert answer.message == 'dropped the last stroke, 100 points; 200 points in 2 strokes held'
    session.undo(), session.undo()
    assert not session.undo().success
    assert session.status().kept == 0


def test_clear_drops_points_and_landmarks(field: Field) -> None:
    session = registered(field)
    assert 'last good pose stands' in session.clear().message
    status = session.status()
    assert (status.received, status.kept, status.landmarks, status.state) == (0, 0, 0, 'collecting')
    assert status.result is None and status.pose_result is not None


def test_landmarks_are_taken_one_after_another_with_their_spread(field: Field) -> None:
    session = Session(CONFIG.replaced({'collect.automatic': False}), field)    # it needs no stroke
    noise = np.random.default_rng(0).normal(0.0, 0.0003, (50, 3))
    tip = transform(T_TRACKER_BONE, LANDMARKS)
    for i, offset in enumerate(noise):
        session.add_point(i / RATE, tip[0] + offset, 'cam')
    answer = session.capture_landmark()
    assert answer.success
    assert re.fullmatch(
        r'landmark "x" captured from 4[01] samples, spread 0\.(4|5)\d mm RMS; next is "y"',
        answer.message)
    again = session.capture_landmark()
    assert not again.success and again.message == 'the tip is still at landmark "x"; touch "y"'
    hold(session, tip[1], 10.0)
    assert session.capture_landmark().success
    hold(session, tip[2], 20.0)
    assert session.capture_landmark().message.endswith('that was the last one')
    assert 'all 3 landmarks are captured' in session.capture_landmark().message
    taken = session.landmarks()
    assert [landmark.name for landmark in taken] == ['x', 'y', 'z']
    assert np.abs([landmark.tracker for landmark in taken] - tip).max() < 2e-4
    assert np.array_equal([landmark.model for landmark in taken], LANDMARKS)


def test_landmarks_are_refused_with_a_reason(field: Field) -> None:
    assert 'set landmarks.names' in Session(Config(), field).capture_landmark().message
    session = Session(CONFIG, field)
    assert 'no probe tip is seen' in session.capture_landmark().message
    for i in range(200):
        session.add_point(i / RATE, (0.001 * i, 0.0, 0.0), 'cam', arrival=i / RATE)
    assert 'the tip moves' in session.capture_landmark(now=2.5).message
    hold(session, np.zeros(3), 10.0, arrival=10.0)
    assert 'no probe tip is seen' in session.capture_landmark(now=60.0).message
    assert session.status().landmarks == 0


def test_unsound_samples_never_become_a_landmark(field: Field) -> None:
    session = Session(CONFIG, field)
    session.add_point(0.0, (0.0, 0.0, 0.0), 'cam')
    for i in range(100):
        assert session.add_point(1.0 + i / RATE, (0.1, 0.0, 0.0), 'other') is Rejection.WRONG_FRAME
        assert session.add_point(1.0 + i / RATE, (np.nan, 0.0, 0.0), 'cam') is Rejection.NOT_FINITE
    assert not session.capture_landmark().success


def test_fewer_than_three_landmarks_are_no_guess(field: Field,
                                                 monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(session_module, 'register', lambda points, field, config, **given: (
        seen.append(given['landmarks']), RegistrationResult.refused(Reason.NOT_CONVERGED, 'no'))[1])
    session = Session(CONFIG, field)
    hold(session, np.zeros(3), 0.0)
    session.capture_landmark()
    session.register()
    assert seen == [None]


def test_verification_measures_and_judges(field: Field) -> None:
    session = registered(field)
    assert not Session(CONFIG, field).verify().success
    surface, normal = field.surface_points[500].astype(float), field.surface_normals[500].astype(
        float)
    for start, off, good, words in (
            (1000.0, 0.0005, True, '0.5 mm outside'), (1010.0, -0.001, True, '1.0 mm inside'),
            (1020.0, 0.005, False, '5.0 mm outside')):
        hold(session, transform(T_TRACKER_BONE, surface + off * normal), start)
        answer = session.verify()
        assert answer.success is good and words in answer.message
    before = session.status().pose_result
    assert session.status().pose_result is before


def rest(session: Session, point: Array, start: float, seconds: float = 1.0) -> float:
    """Hold the tip as a tracker sees it, no two readings alike; return the time after it."""
    readings = point + np.random.default_rng(int(start)).normal(0.0, 1e-4,
                                                                (round(seconds * RATE), 3))
    for i, reading in enumerate(readings):
        session.add_point(start + i / RATE, reading, 'cam')
    return start + len(readings) / RATE


def near(session: Session, place: Array, radius: float = 0.004) -> int:
    """Return how many points of the collection lie there."""
    return int((np.linalg.norm(session.points().positions - place, axis=1) < radius).sum())


def on_surface(field: Field, row: int) -> Array:
    return transform(T_TRACKER_BONE, field.surface_points[row].astype(np.float64))


@pytest.mark.parametrize('touch', ['verify', 'capture_landmark'])
def test_what_is_touched_on_purpose_is_kept_out_of_the_fit(field: Field, touch: str) -> None:
    session = Session(CONFIG, field)
    send(session, touched(field), start=100.0)
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    place = on_surface(field, 501)
    kept, around, revision = session.status().kept, near(session, place), session._holds.revision
    end = rest(session, place, 1000.0)
    assert session.status().kept == kept + 80
    assert getattr(session, touch)().success
    assert session.status().kept == kept and near(session, place) == around
    assert session._holds.revision > revision      # who follows the collection hears of it
    rest(session, place, end)       # it still rests there, and is still not for the fit
    status = session.status()
    assert (status.kept, status.rejected['touched']) == (kept, 160)
    assert not status.outdated
    send(session, [place + [0.0, 0.0, 0.01]], start=2000.0)     # it goes on
    assert session.status().kept == kept + 1
    assert status.received == status.kept + sum(status.rejected.values())


def test_a_place_that_the_registration_was_found_with_is_no_verification(field: Field) -> None:
    session = landmarked(field)
    send(session, touched(field), start=100.0)
    end = rest(session, on_surface(field, 501), 1000.0)
    assert session.register().success
    rest(session, on_surface(field, 501), end)
    answer = session.verify()
    assert not answer.success and 'rested here since before the registration' in answer.message
    assert session.status().verification is None
    rest(session, on_surface(field, 2501), 1100.0)
    assert session.verify().success


def test_a_checkpoint_touched_again_tells_that_the_array_was_bumped(field: Field) -> None:
    session = registered(field)
    surface = field.surface_points[500].astype(np.float64)
    along = np.cross(field.surface_normals[500].astype(np.float64), [0.3, 0.5, 0.8])
    along *= 0.0034 / np.linalg.norm(along)     # which the distance to the surface hardly shows
    for count, (shift, good) in enumerate(((0.0, True), (0.1, True), (1.0, False))):
        hold(session, transform(T_TRACKER_BONE, surface + shift * along), 1000.0 + 300.0 * count)
        answer = session.verify()
        assert answer.success is good, answer.message
    assert answer.message.endswith(
        'checkpoint 1 moved 3.4 mm since it was first touched 10 min ago: was the array bumped?')
    glance = session.status().verification
    assert glance is not None and not glance.good
    assert glance.points == 1 and glance.moved_m == pytest.approx(0.0034)


def test_verification_points_are_measured_anew_when_the_bone_is_registered_anew(
        field: Field, monkeypatch: pytest.MonkeyPatch) -> None:
    session = registered(field)
    normal = T_TRACKER_BONE[:3, :3] @ field.surface_normals[500]
    hold(session, on_surface(field, 500), 1000.0)
    assert session.verify().success
    shifted = T_TRACKER_BONE.copy()
    shifted[:3, 3] += 0.003 * normal
    monkeypatch.setattr(session_module, 'register', lambda *_, **__: RegistrationResult(
        Reason.CONVERGED, 'found', T_tracker_bone=shifted))
    session.register()
    glance = session.status().verification
    assert glance is not None and glance.worst_m == pytest.approx(0.003, abs=2e-4)
    assert not glance.good


def test_undo_of_several_strokes_and_of_parts_of_one(field: Field) -> None:
    session = Session(CONFIG, field)
    line = np.linspace([0.0, 0.0, 0.0], [0.05, 0.0, 0.0], 80)
    for stroke in range(2):
        session.collect(True)
        for i, point in enumerate(line):
            session.add_point(100.0 * stroke + i / RATE, point, 'cam')
    for i, point in enumerate(line):        # after a silence
        session.add_point(150.0 + i / RATE, point, 'cam')
    assert session.undo().message == (
        'dropped the last stroke, 80 points, which a silence had split off the one before: undo '
        'again to drop that too; 160 points in 2 strokes held')
    assert session.undo().message == (
        'dropped the last stroke, 80 points; 80 points in 1 stroke held')
    assert session.undo().success and not session.undo().success


def test_a_pose_is_outdated_when_points_it_was_found_with_were_dropped(field: Field) -> None:
    session = Session(CONFIG, field)
    assert not session.outdated
    send(session, touched(field), start=100.0)
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    send(session, touched(field, 50), start=1000.0)
    for _ in range(50):
        session.undo()
    assert not session.outdated and session.status().kept == 300
    session.undo()
    assert session.outdated and session.status().outdated
    assert session.register(T_tracker_bone=T_TRACKER_BONE).success
    assert not session.outdated
    session.clear()
    assert session.outdated


def test_a_stroke_of_interference_is_named_and_gone_after_undo(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, touched(field), start=100.0)
    session.collect(True)
    for i in range(24):         # a retractor
        session.add_point(1000.0 + 0.2 * i, transform(T_TRACKER_BONE, [0.09, 0.005 * i, 0.0]),
                          'cam')
    result = session.register(T_tracker_bone=T_TRACKER_BONE)
    words = 'stroke 301: 24 points, none on the bone: interference; undo it or leave it'
    assert result.success and result.message.endswith(f'; {words}')
    status = session.status()
    assert words in status.message and status.stroke_reports[-1].sentence == words
    assert all(each.rms_m < 1e-3 for each in status.stroke_reports[:-1])
    send(session, touched(field, 5), start=2000.0)      # not in it: nothing is said of them
    assert len(session.status().stroke_reports) == 301
    for _ in range(6):
        session.undo()
    assert len(session.status().stroke_reports) == 300
    assert 'interference' not in session.register(T_tracker_bone=T_TRACKER_BONE).message


def test_landmarks_touched_in_another_order_are_told_at_once(field: Field) -> None:
    session = Session(CONFIG, field)
    tip = transform(T_TRACKER_BONE, LANDMARKS)
    answers = []
    for count, place in enumerate((0, 2, 1)):
        hold(session, tip[place], 10.0 * count)
        answers.append(session.capture_landmark().message)
    assert 'but' not in answers[0]
    assert '"x" and "y" are 76 mm apart, 54 mm on the model: were other places' in answers[1]
    assert 'touched in this order: "x", "z", "y"' in answers[2]


def test_a_landmark_touched_elsewhere_is_named_after_registration(field: Field) -> None:
    session = Session(CONFIG, field)
    tip = transform(T_TRACKER_BONE, LANDMARKS + [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.0] * 3])
    for count, place in enumerate(tip):
        hold(session, place, 10.0 * count)
        session.capture_landmark()
    send(session, touched(field), start=100.0)
    result = session.register()
    assert result.success
    assert 'landmark "y" was touched 20 mm from its place: was it another one?' in result.message
    assert session.status().landmark_misses == pytest.approx({'x': 0.0, 'y': 0.02, 'z': 0.0},
                                                             abs=1e-3)


def test_a_remark_goes_with_the_status_until_there_is_news(field: Field) -> None:
    session = Session(CONFIG, field)
    for forget in (session.clear, session.register):
        session.remark('taken up from a journal')
        assert session.status().message.endswith('; taken up from a journal')
        forget()
        assert 'journal' not in session.status().message


def test_another_model_drops_the_pose_and_the_same_one_does_not(field: Field) -> None:
    session = registered(field)
    session.set_model(field)
    assert session.status().pose_result is not None
    session.set_model(bone(width=0.035))
    assert session.status().pose_result is None and session.status().kept > 0


def test_settings_change_while_points_are_held(field: Field) -> None:
    session = Session(CONFIG, field)
    send(session, touched(field, 50))
    session.configure(CONFIG.replaced({'gate.quality': 0.0, 'collect.max_points': 100}))
    assert send(session, touched(field, 60), start=100.0, quality=1.0)[-1] is Rejection.FULL
    with pytest.raises(InputError, match='clear before'):
        session.configure(CONFIG.replaced({'probe.frame_id': 'array'}))
    session.clear()
    session.configure(CONFIG.replaced({'probe.frame_id': 'array'}))
    assert session.add_point(0.0, (0.0, 0.0, 0.0), 'cam') is Rejection.WRONG_FRAME


def test_status_says_what_is_wrong_with_the_points(field: Field) -> None:
    session = Session(Config.from_flat({'probe.frame_id': 'array'}), field)
    send(session, touched(field, 100))
    assert session.status().rejected['wrong_frame'] == 100
    assert 'probe.frame_id' in session.status().message
    assert set(session.status().rejected) == {str(cause) for cause in Rejection}


# --- while a registration runs

class Paused:
    """A `register` that waits to be released, and knows whether it was cancelled."""

    def __init__(self) -> None:
        self.running, self.release, self.cancelled = threading.Event(), threading.Event(), False

    def __call__(self, points: Array, field: Field, config: Config, *,
                 cancelled: Callable[[], bool], **_: Any) -> RegistrationResult:
        self.running.set()
        assert self.release.wait(10.0)
        self.cancelled = cancelled()
        return RegistrationResult(Reason.CONVERGED,
                                  'found',
                                  T_tracker_bone=np.eye(4),
                                  used=len(points))


@pytest.fixture
def paused(monkeypatch: pytest.MonkeyPatch) -> Paused:
    register = Paused()
    monkeypatch.setattr(session_module, 'register', register)
    return register


def in_thread(job: Callable[[], Any]) -> Callable[[], Any]:
    """Start a job and return what waits for its result."""
    results: list[Any] = []
    thread = threading.Thread(target=lambda: results.append(job()))
    thread.start()

    def result() -> Any:
        thread.join(10.0)
        assert not thread.is_alive()
        return results[0]
    return result


def test_points_come_in_while_it_runs_and_are_not_in_it(field: Field, paused: Paused) -> None:
    session = Session(CONFIG, field)
    send(session, touched(field, 40))
    result = in_thread(session.register)
    assert paused.running.wait(10.0)
    assert session.status().state == 'solving'
    assert send(session, touched(field, 40), start=100.0)[-1] is None
    assert session.status().kept == 80
    paused.release.set()
    assert result().used == 40
    assert session.status().state == 'registered' and len(session.registered_points().stamps) == 40


def test_a_second_one_is_answered_at_once(field: Field, paused: Paused) -> None:
    session = Session(CONFIG, field)
    first = in_thread(session.register)
    assert paused.running.wait(10.0)
    second = session.register()
    assert not second.success and 'running already' in second.message
    assert session.status().state == 'solving'
    paused.release.set()
    assert first().success and session.status().result is not second


@pytest.mark.parametrize('disturb', [lambda s: s.clear(), lambda s: s.set_model(bone(width=0.04))])
def test_its_result_is_void_when_points_or_model_were_dropped(
        field: Field, paused: Paused, disturb: Callable[[Session], Any]) -> None:
    session = Session(CONFIG, field)
    send(session, touched(field, 40))
    result = in_thread(session.register)
    assert paused.running.wait(10.0)
    disturb(session)
    paused.release.set()
    assert not result().success and paused.cancelled
    assert session.status().pose_result is None and session.status().state == 'collecting'


def test_a_fault_in_the_solver_does_not_block_the_next(field: Field,
                                                       monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any, **__: Any) -> RegistrationResult:
        raise MemoryError
    session = landmarked(field)
    send(session, touched(field), start=100.0)
    with monkeypatch.context() as patched:
        patched.setattr(session_module, 'register', broken)
        with pytest.raises(MemoryError):
            session.register()
    assert session.register().success


def test_many_threads_lose_no_point(field: Field) -> None:
    session = landmarked(field)
    before = session.status().received
    points = touched(field, 200)
    senders = [
        in_thread(lambda source=f'probe{k}': send(session, points, start=100.0, source=source))
        for k in range(4)
    ]
    results = [session.register() for _ in range(5)]
    for sender in senders:
        assert sender() == [None] * 200
    status = session.status()
    assert status.received - before == 800 and status.kept + sum(
        status.rejected.values()) == status.received
    assert not any('running' in result.message for result in results)
    assert session.register().success


# --- saved and taken up again

def test_a_session_survives_json(field: Field) -> None:
    session = registered(field)
    hold(session, transform(T_TRACKER_BONE, LANDMARKS[0]), 1000.0)
    session.verify()
    record = json.loads(json.dumps(session.to_dict(), allow_nan=False))
    assert record['parameters'] == CONFIG.flat() and record['model_sha256'] == field.bone_sha256
    assert len(record['verifications']) == 1
    other = Session(CONFIG, field)
    other.restore(record)
    assert all(np.array_equal(a, b) for a, b in zip(other.points(), session.points()))
    before, after = session.status(), other.status()
    for name in ('state', 'received', 'kept', 'rejected', 'strokes', 'landmarks', 'frame_id',
                 'pose_frame_id'):
        assert getattr(before, name) == getattr(after, name), name
    assert np.array_equal(after.pose_result.T_tracker_bone, before.pose_result.T_tracker_bone)
    assert np.array_equal(after.pose_result.covariance, before.pose_result.covariance)
    assert json.loads(json.dumps(other.to_dict())) == record
    assert np.array_equal(other.register().T_tracker_bone, session.register().T_tracker_bone)


def test_what_is_not_known_is_null_and_comes_back(field: Field,
                                                  monkeypatch: pytest.MonkeyPatch) -> None:
    result = RegistrationResult(Reason.CONVERGED,
                                'found',
                                T_tracker_bone=np.eye(4),
                                sigma_m=float('nan'))
    monkeypatch.setattr(session_module, 'register', lambda *_, **__: result)
    session = Session(CONFIG, field)
    session.register()
    record = json.loads(json.dumps(session.to_dict(), allow_nan=False))
    session.restore(record)
    assert session.status().result == dataclasses.replace(
        result, sigma_m=None, T_tracker_bone=session.status().result.T_tracker_bone)


def test_a_session_of_another_bone_is_refused(field: Field) -> None:
    record = registered(field).to_dict()
    with pytest.raises(InputError, match='another bone'):
        Session(CONFIG, bone(width=0.035)).restore(record)
    with pytest.raises(InputError, match='load the bone model'):
        Session(CONFIG).restore(record)
    with pytest.raises(InputError, match='no bone model'):
        Session(CONFIG).to_dict()


@pytest.mark.parametrize('damage', [
    lambda r: r.pop('points'), lambda r: r['points'][0].pop(),
    lambda r: r['points'][0].__setitem__(0, 0), lambda r: r['points'][0].__setitem__(1, 1),
    lambda r: r['landmarks'][0].pop('model'),
    lambda r: r['landmarks'][0].update(tracker=[1.0, 2.0]),
    lambda r: r.update(result={'reason': 'magic'}), lambda r: r.update(landmarks=7),
    lambda r: r['points'][0].__setitem__(3, None), lambda r: r['points'].append(None),
    lambda r: r['points'].append([1, 2]), lambda r: r.update(points=[1.0] * 16),
    lambda r: r['pose_result'].update(T_tracker_bone=[[1.0]]),
    lambda r: r['result'].update(T_tracker_bone=None),
    lambda r: r['pose_result'].update(covariance=[1.0])
])
def test_a_damaged_session_is_refused_and_changes_nothing(field: Field,
                                                          damage: Callable[[Any], Any]) -> None:
    session = registered(field)
    record = copy.deepcopy(json.loads(json.dumps(session.to_dict())))
    damage(record)
    before = session.status()
    with pytest.raises(InputError, match='damaged'):
        session.restore(record)
    assert session.status() == before
