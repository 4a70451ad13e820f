# SPDX-License-Identifier: Apache-2.0
"""Points reach the session in its frame, in order, each once, or are counted; and nothing waits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array, exp, inverse, transform
from gsdf_registration.common.samples import Rejection, Sample
from gsdf_registration.simulation.moving import Sway
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.point_transformer import MOST_WAITING, PointTransformer

ARRAY = '/array/pose'
TIP = '/probe/tip'
SWAY = Sway(exp([0.3, -0.2, 0.5, 0.1, 0.2, -1.2]))
PLACE = np.array([0.05, -0.02, 0.01])       # at rest in the frame of the array
MAX_AGE = 0.5       # s, the default of gate.max_age


class Heard:
    """Remembers what it is fed."""

    def __init__(self) -> None:
        self.taken: list[Sample] = []
        self.refused: list[tuple[Sample, str]] = []
        self.anew: list[str] = []

    def take(self, sample: Sample) -> None:
        self.taken.append(sample)

    def refuse(self, sample: Sample, cause: Rejection) -> None:
        self.refused.append((sample, str(cause)))

    def start_anew(self, why: str) -> None:
        self.anew.append(why)
        self.taken.clear()
        self.refused.clear()

    @property
    def causes(self) -> dict[str, int]:
        causes = [cause for _, cause in self.refused]
        return {cause: causes.count(cause) for cause in dict.fromkeys(causes)}


def feed_of(frames: Frames | None = None, **settings: str) -> tuple[PointTransformer, Heard]:
    heard = Heard()
    values = {key.replace('__', '.'): value for key, value in settings.items()}
    return PointTransformer(Config.from_flat({'reference.topic': ARRAY, **values}), heard, frames), heard


def tip(stamp: float, position: Array | None = None, frame_id: str = 'camera', source: str = TIP,
        arrival: float | None = None) -> Sample:
    if position is None:
        position = transform(SWAY.pose(stamp), PLACE)
    return Sample(stamp, position.tolist(), frame_id, source, arrival)


def play(feed: PointTransformer, points: np.ndarray, poses: np.ndarray, delay: float = 0.0) -> None:
    """Give points and poses in the order of their stamps, poses ``delay`` s later."""
    events = [(stamp, 0) for stamp in points] + [(stamp + delay, 1) for stamp in poses]
    for stamp, is_pose in sorted(events):
        if is_pose:
            feed.pose(stamp - delay, SWAY.pose(stamp - delay), 'camera')
        else:
            feed.point(tip(stamp))


@pytest.mark.parametrize('delay', [0.0, 0.03, 0.3])
def test_a_tip_at_rest_on_a_moving_bone_is_at_rest_in_the_frame_of_the_array(delay: float) -> None:
    feed, heard = feed_of()
    stamps = np.arange(0.05, 5.0, 1.0 / 130.0)
    play(feed, stamps, np.arange(0.0, 5.1, 1.0 / 80.0), delay)
    assert [sample.stamp for sample in heard.taken] == stamps.tolist()
    assert not heard.refused and not feed.trouble
    assert {sample.frame_id for sample in heard.taken} == {'reference_array'}
    off = np.array([sample.position for sample in heard.taken]) - PLACE
    assert np.linalg.norm(off, axis=1).max() < 5e-6     # of linear interpolation


def test_a_point_waits_for_the_pose_after_it_and_no_longer() -> None:
    feed, heard = feed_of()
    feed.pose(1.0, np.eye(4), 'camera')
    feed.point(tip(1.0))
    feed.point(tip(1.01))
    assert [sample.stamp for sample in heard.taken] == [1.0]
    feed.pose(1.0125, np.eye(4), 'camera')
    assert [sample.stamp for sample in heard.taken] == [1.0, 1.01]


def test_a_point_that_waits_holds_up_no_other() -> None:
    feed, heard = feed_of()
    feed.pose(1.0, np.eye(4), 'camera')
    feed.pose(1.1, np.eye(4), 'camera')
    feed.point(tip(1.15))                       # ahead of the array
    feed.point(tip(1.05, source='/second'))
    feed.point(tip(1.08))                       # late in the network, but known
    assert [sample.stamp for sample in heard.taken] == [1.05, 1.08]


def test_while_the_array_is_hidden_points_are_refused_and_counted() -> None:
    feed, heard = feed_of()
    stamps = np.arange(0.05, 6.0, 1.0 / 80.0)
    poses = np.arange(0.0, 6.1, 1.0 / 80.0)
    hidden = (poses > 2.0) & (poses < 4.0)
    play(feed, stamps, poses[~hidden])
    assert heard.causes == {'no_reference': len(stamps) - len(heard.taken)}
    kept = np.array([sample.stamp for sample in heard.taken])
    assert not ((kept > 2.0) & (kept < 4.0)).any()
    assert len(kept) == ((stamps <= 2.0) | (stamps >= 4.0)).sum()


def test_a_hidden_array_is_told_and_its_return_ends_it() -> None:
    feed, heard = feed_of()
    feed.point(tip(1.0, arrival=50.0))
    feed.serve(50.0 + MAX_AGE)
    assert not heard.refused
    feed.serve(50.01 + MAX_AGE)
    assert heard.causes == {'no_reference': 1}
    assert ARRAY in feed.trouble and 'in view' in feed.trouble
    feed.pose(2.0, np.eye(4), 'camera')
    feed.point(tip(2.0, arrival=51.0))
    assert feed.trouble == '' and len(heard.taken) == 1


def test_without_a_clock_of_ours_that_of_the_points_tells_how_long_one_waits() -> None:
    feed, heard = feed_of()
    for stamp in (1.0, 1.3, 1.51):
        feed.point(tip(stamp))
    assert [sample.stamp for sample, _ in heard.refused] == [1.0]
    feed.end()
    assert heard.causes == {'no_reference': 3}


def test_what_waits_is_bounded() -> None:
    feed, heard = feed_of()
    for i in range(3 * MOST_WAITING):
        feed.point(tip(1.0 + 1e-5 * i, PLACE))
    assert len(heard.refused) == 2 * MOST_WAITING


@pytest.mark.parametrize('ahead', [-3600.0, 1.7e9])
def test_two_clocks_are_named_with_their_difference(ahead: float) -> None:
    feed, heard = feed_of()
    for i in range(100):
        feed.point(tip(1000.0 + i / 80.0, PLACE))
        feed.pose(1000.0 + ahead + i / 80.0, np.eye(4), 'camera')
    feed.end()
    assert not heard.taken
    assert TIP in feed.trouble and ARRAY in feed.trouble and 'one clock' in feed.trouble
    assert f'{abs(ahead):.1f} s' in feed.trouble


def test_a_probe_or_an_array_hidden_for_long_is_not_taken_for_another_clock() -> None:
    feed, _ = feed_of()
    everything = np.arange(0.0, 60.0, 1.0 / 80.0)
    play(feed, np.r_[everything[:800], everything[2400:]],
         np.r_[everything[:1600], everything[4000:]])
    feed.end()
    assert 'one clock' not in feed.trouble
    # first the probe goes, then the array; the probe comes back
    feed, _ = feed_of()
    play(feed, np.r_[everything[:800], everything[2400:]], everything[:1600])
    feed.end()
    assert 'one clock' not in feed.trouble and 'in view' in feed.trouble


def test_poses_in_another_frame_than_the_points_are_told_with_both() -> None:
    feed, heard = feed_of(Frames())
    for i in range(100):
        feed.pose(1.0 + i / 80.0, np.eye(4), 'second_camera')
        feed.point(tip(1.0 + i / 80.0))
    feed.end()
    assert heard.causes == {'wrong_frame': 100}
    assert '"camera"' in feed.trouble and '"second_camera"' in feed.trouble


def test_poses_that_change_their_frame_are_left_out() -> None:
    feed, heard = feed_of()
    feed.pose(1.0, np.eye(4), 'camera')
    feed.pose(1.1, SWAY.pose(0.0), 'elsewhere')
    feed.pose(1.2, np.eye(4), 'camera')
    feed.point(tip(1.1, PLACE))
    np.testing.assert_allclose(heard.taken[0].position, PLACE)
    feed.pose(1.3, SWAY.pose(0.0), 'elsewhere')
    feed.point(tip(1.3, PLACE))
    feed.end()
    assert 'in frame "elsewhere" and not in "camera"' in feed.trouble


def test_a_pose_that_is_none_is_told_and_left_out() -> None:
    feed, heard = feed_of()
    for i in range(9):
        feed.pose(1.0 + i / 80.0, np.full((4, 4), np.nan) if i in (4, 8) else np.eye(4), 'camera')
    feed.point(tip(1.0 + 4 / 80.0, PLACE))
    np.testing.assert_allclose(heard.taken[0].position, PLACE)
    assert not feed.trouble
    feed.point(tip(1.0 + 8 / 80.0, PLACE))
    feed.end()
    assert 'Left out of its poses: 2; the last is no rigid motion' in feed.trouble


def test_points_go_through_the_frames_to_the_camera_and_on_to_the_array() -> None:
    frames = Frames()
    feed, heard = feed_of(frames)
    T_camera_wand = exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    feed.pose(1.0, SWAY.pose(1.0), 'camera')
    in_wand = transform(inverse(T_camera_wand) @ SWAY.pose(1.0), PLACE)
    feed.point(tip(1.0, in_wand, 'wand'))
    assert not heard.taken
    feed.transform('camera', 'wand', 0.0, T_camera_wand, True)
    np.testing.assert_allclose(heard.taken[0].position, PLACE, atol=1e-9)


def test_without_an_array_points_are_brought_into_the_frame_of_the_session() -> None:
    feed, heard = feed_of(Frames(), reference__topic='', probe__frame_id='world')
    T = exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    feed.point(tip(1.0, PLACE, 'world'))
    feed.point(tip(1.05, PLACE, 'camera'))
    for stamp in (1.0, 1.1):
        feed.transform('world', 'camera', stamp, T, False)
    assert [sample.frame_id for sample in heard.taken] == ['world', 'world']
    np.testing.assert_array_equal(heard.taken[0].position, PLACE)
    np.testing.assert_allclose(heard.taken[1].position, transform(T, PLACE))
    feed.point(tip(1.2, PLACE, 'nowhere'))
    feed.point(tip(1.3, PLACE, 'camera'))
    feed.end()
    assert heard.causes == {'wrong_frame': 1, 'no_reference': 1}


def test_without_tf_points_of_another_frame_are_refused_at_once() -> None:
    feed, heard = feed_of(None, reference__topic='', probe__frame_id='world')
    feed.point(tip(1.0))
    assert heard.causes == {'wrong_frame': 1} and 'tf2_msgs' in feed.trouble


def test_with_neither_array_nor_frame_points_are_passed_on_as_they_are() -> None:
    feed, heard = feed_of(Frames(), reference__topic='')
    samples = [tip(1.0, PLACE, 'a'), tip(1.1, PLACE, 'b')]
    for sample in samples:
        feed.point(sample)
    assert heard.taken == samples


def test_a_looped_recording_begins_one_session_and_loses_nothing_of_it() -> None:
    feed, heard = feed_of()
    stamps = np.arange(0.05, 3.0, 1.0 / 130.0)
    for _ in range(2):
        play(feed, stamps, np.arange(0.0, 3.1, 1.0 / 80.0))
    assert len(heard.anew) == 1 and TIP in heard.anew[0]
    # the first points came before it was evident for the array too that the clock went back
    assert [sample.stamp for sample in heard.taken] == stamps.tolist()
    off = np.array([sample.position for sample in heard.taken]) - PLACE
    assert np.linalg.norm(off, axis=1).max() < 5e-6


def test_late_points_begin_no_session() -> None:
    feed, heard = feed_of(None, reference__topic='')
    for stamp in (*np.arange(10.0, 12.0, 0.0125), 3.0, 3.1, *np.arange(12.0, 13.0, 0.0125)):
        feed.point(tip(stamp))
    assert not heard.anew and heard.causes == {'not_monotonic': 2}


def test_our_own_clock_going_back_begins_a_session() -> None:
    feed, heard = feed_of(None, reference__topic='')
    feed.point(tip(1.0, arrival=100.0))
    feed.our_clock_went_back(100.0, 20.0)
    assert heard.anew == ['the clock went back by 80.0 s']


def test_forgetting_takes_stamps_that_go_back_for_the_first() -> None:
    feed, heard = feed_of(None, reference__topic='')
    feed.point(tip(1000.0))
    feed.forget()
    feed.point(tip(1.0))
    assert not heard.anew and [sample.stamp for sample in heard.taken] == [1000.0, 1.0]


moves = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(
    lambda twist: exp(np.array(twist)))


@settings(deadline=None)
@given(moves, st.lists(st.floats(0.0, 2.0), min_size=1, max_size=40))
def test_a_tracker_that_is_moved_moves_nothing_in_the_frame_of_the_array(
        T_moved: Array, stamps: list[float]) -> None:
    positions = []
    for T in (np.eye(4), T_moved):
        feed, heard = feed_of()
        for stamp in np.arange(-0.1, 2.2, 0.0125):
            feed.pose(stamp, T @ SWAY.pose(stamp), 'camera')
        for stamp in sorted(stamps):
            feed.point(tip(stamp, transform(T @ SWAY.pose(stamp), PLACE)))
        positions.append([sample.position for sample in heard.taken])
        assert len(heard.taken) == len(stamps)
    np.testing.assert_allclose(*positions, atol=1e-9)


@settings(deadline=None)
@given(st.lists(st.tuples(st.sampled_from(['point', 'pose']), st.floats(0.0, 30.0)), max_size=80))
def test_every_point_is_taken_or_counted_once(events: list[tuple[str, float]]) -> None:
    feed, heard = feed_of()
    sources = []
    for kind, stamp in events:
        if kind == 'pose':
            feed.pose(stamp, np.eye(4), 'camera')
        else:
            sources.append(f'/{len(sources)}')
            feed.point(tip(stamp, PLACE, source=sources[-1]))
    feed.end()
    decided = [*heard.taken, *(sample for sample, _ in heard.refused)]
    assert sorted(sample.source for sample in decided) == sorted(sources)
