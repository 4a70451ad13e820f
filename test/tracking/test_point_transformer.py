# SPDX-License-Identifier: Apache-2.0
"""Every sample reaches the session once, in its frame and in order, or is counted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import (
    Array,
    exp,
    inverse,
    quaternion_from_rotation,
    rotation_from_quaternion,
    transform,
)
from gsdf_registration.common.samples import Rejection, Sample
from gsdf_registration.simulation.moving import Sway
from gsdf_registration.tracking.frames import Frames
from gsdf_registration.tracking.point_transformer import MAX_WAITING, PointTransformer

ARRAY = '/array/pose'
TIP = '/probe/tip'
SWAY = Sway(exp([0.3, -0.2, 0.5, 0.1, 0.2, -1.2]))
PLACE = np.array([0.05, -0.02, 0.01])       # fixed in the array frame
MAX_AGE = 0.5       # s, the default of gate.max_age


class Sink:
    """A sample sink that records its calls."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.added: list[Sample] = []
        self.rejected: list[tuple[Sample, str]] = []
        self.restarts: list[str] = []
        self.calibrating = False
        self.taken: list[Sample] = []
        self.reference_poses: list[float] = []

    def take(self, sample: Sample) -> bool:
        self.taken += [sample] * self.calibrating
        return self.calibrating

    def add_reference_pose(self, stamp: float, T: np.ndarray) -> None:
        self.reference_poses.append(stamp)

    def add(self, sample: Sample) -> None:
        self.added.append(sample)

    def reject(self, sample: Sample, cause: Rejection) -> None:
        self.rejected.append((sample, str(cause)))

    def restart(self, reason: str) -> None:
        self.restarts.append(reason)
        self.added.clear()
        self.rejected.clear()

    @property
    def causes(self) -> dict[str, int]:
        causes = [cause for _, cause in self.rejected]
        return {cause: causes.count(cause) for cause in dict.fromkeys(causes)}


def make_transformer(frames: Frames | None = None, **settings: str,
                     ) -> tuple[PointTransformer, Sink]:
    values = {key.replace('__', '.'): value for key, value in settings.items()}
    sink = Sink(Config.from_flat({'reference.topic': ARRAY, **values}))
    return PointTransformer(sink, frames), sink


def tip(stamp: float, position: Array | None = None, frame_id: str = 'camera', topic: str = TIP,
        arrival: float | None = None) -> Sample:
    if position is None:
        position = transform(SWAY.pose(stamp), PLACE)
    return Sample(stamp, tuple(position.tolist()), frame_id, topic, arrival)


def play(transformer: PointTransformer, points: np.ndarray, poses: np.ndarray,
         delay: float = 0.0) -> None:
    """Add points and poses in the order of their stamps, poses ``delay`` s later."""
    events = [(stamp, 0) for stamp in points] + [(stamp + delay, 1) for stamp in poses]
    for stamp, is_pose in sorted(events):
        if is_pose:
            transformer.add_pose(stamp - delay, SWAY.pose(stamp - delay), 'camera')
        else:
            transformer.add_point(tip(stamp))


@pytest.mark.parametrize('delay', [0.0, 0.03, 0.3])
def test_a_tip_fixed_to_a_moving_bone_is_fixed_in_the_array_frame(delay: float) -> None:
    transformer, sink = make_transformer()
    stamps = np.arange(0.05, 5.0, 1.0 / 130.0)
    play(transformer, stamps, np.arange(0.0, 5.1, 1.0 / 80.0), delay)
    assert [sample.stamp for sample in sink.added] == stamps.tolist()
    assert not sink.rejected and not transformer.problem
    assert {sample.frame_id for sample in sink.added} == {'reference_array'}
    off = np.array([sample.position for sample in sink.added]) - PLACE
    assert np.linalg.norm(off, axis=1).max() < 5e-6     # of linear interpolation


def test_a_point_waits_for_the_next_pose() -> None:
    transformer, sink = make_transformer()
    transformer.add_pose(1.0, np.eye(4), 'camera')
    transformer.add_point(tip(1.0))
    transformer.add_point(tip(1.01))
    assert [sample.stamp for sample in sink.added] == [1.0]
    transformer.add_pose(1.0125, np.eye(4), 'camera')
    assert [sample.stamp for sample in sink.added] == [1.0, 1.01]


def test_a_waiting_point_does_not_delay_others() -> None:
    transformer, sink = make_transformer()
    transformer.add_pose(1.0, np.eye(4), 'camera')
    transformer.add_pose(1.1, np.eye(4), 'camera')
    transformer.add_point(tip(1.15))                       # ahead of the array
    transformer.add_point(tip(1.05, topic='/second'))
    transformer.add_point(tip(1.08))                       # late, but its poses are known
    assert [sample.stamp for sample in sink.added] == [1.05, 1.08]


def test_rejects_points_while_the_array_is_hidden() -> None:
    transformer, sink = make_transformer()
    stamps = np.arange(0.05, 6.0, 1.0 / 80.0)
    poses = np.arange(0.0, 6.1, 1.0 / 80.0)
    hidden = (poses > 2.0) & (poses < 4.0)
    play(transformer, stamps, poses[~hidden])
    assert sink.causes == {'no_reference': len(stamps) - len(sink.added)}
    kept = np.array([sample.stamp for sample in sink.added])
    assert not ((kept > 2.0) & (kept < 4.0)).any()
    assert len(kept) == ((stamps <= 2.0) | (stamps >= 4.0)).sum()


def test_reports_a_hidden_array_until_it_returns() -> None:
    transformer, sink = make_transformer()
    transformer.add_point(tip(1.0, arrival=50.0))
    transformer.process(50.0 + MAX_AGE)
    assert not sink.rejected
    transformer.process(50.01 + MAX_AGE)
    assert sink.causes == {'no_reference': 1}
    assert ARRAY in transformer.problem and 'in view' in transformer.problem
    transformer.add_pose(2.0, np.eye(4), 'camera')
    transformer.add_point(tip(2.0, arrival=51.0))
    assert transformer.problem == '' and len(sink.added) == 1


def test_without_arrival_times_the_stamps_measure_the_wait() -> None:
    transformer, sink = make_transformer()
    for stamp in (1.0, 1.3, 1.51):
        transformer.add_point(tip(stamp))
    assert [sample.stamp for sample, _ in sink.rejected] == [1.0]
    transformer.finish()
    assert sink.causes == {'no_reference': 3}


def test_the_number_of_waiting_points_is_bounded() -> None:
    transformer, sink = make_transformer()
    for i in range(3 * MAX_WAITING):
        transformer.add_point(tip(1.0 + 1e-5 * i, PLACE))
    assert len(sink.rejected) == 2 * MAX_WAITING


@pytest.mark.parametrize('ahead', [-3600.0, 1.7e9])
def test_reports_the_offset_of_two_clocks(ahead: float) -> None:
    transformer, sink = make_transformer()
    for i in range(100):
        transformer.add_point(tip(1000.0 + i / 80.0, PLACE))
        transformer.add_pose(1000.0 + ahead + i / 80.0, np.eye(4), 'camera')
    transformer.finish()
    assert not sink.added
    for part in (TIP, ARRAY, 'one clock', f'{abs(ahead):.1f} s'):
        assert part in transformer.problem


def test_a_long_hidden_probe_or_array_is_not_another_clock() -> None:
    transformer, _ = make_transformer()
    everything = np.arange(0.0, 60.0, 1.0 / 80.0)
    play(transformer, np.r_[everything[:800], everything[2400:]],
         np.r_[everything[:1600], everything[4000:]])
    transformer.finish()
    assert 'one clock' not in transformer.problem
    # the probe is hidden, then the array; the probe returns
    transformer, _ = make_transformer()
    play(transformer, np.r_[everything[:800], everything[2400:]], everything[:1600])
    transformer.finish()
    assert 'one clock' not in transformer.problem and 'in view' in transformer.problem


def test_reports_poses_in_another_frame_than_the_points() -> None:
    transformer, sink = make_transformer(Frames())
    for i in range(100):
        transformer.add_pose(1.0 + i / 80.0, np.eye(4), 'second_camera')
        transformer.add_point(tip(1.0 + i / 80.0))
    transformer.finish()
    assert sink.causes == {'wrong_frame': 100}
    assert '"camera"' in transformer.problem and '"second_camera"' in transformer.problem


def test_rejects_poses_that_change_their_frame() -> None:
    transformer, sink = make_transformer()
    transformer.add_pose(1.0, np.eye(4), 'camera')
    transformer.add_pose(1.1, SWAY.pose(0.0), 'elsewhere')
    transformer.add_pose(1.2, np.eye(4), 'camera')
    transformer.add_point(tip(1.1, PLACE))
    np.testing.assert_allclose(sink.added[0].position, PLACE)
    transformer.add_pose(1.3, SWAY.pose(0.0), 'elsewhere')
    transformer.add_point(tip(1.3, PLACE))
    transformer.finish()
    assert 'in frame "elsewhere" and not in "camera"' in transformer.problem


def test_rejects_and_reports_invalid_poses() -> None:
    transformer, sink = make_transformer()
    for i in range(9):
        T = np.full((4, 4), np.nan) if i in (4, 8) else np.eye(4)
        transformer.add_pose(1.0 + i / 80.0, T, 'camera')
    transformer.add_point(tip(1.0 + 4 / 80.0, PLACE))
    np.testing.assert_allclose(sink.added[0].position, PLACE)
    assert not transformer.problem
    transformer.add_point(tip(1.0 + 8 / 80.0, PLACE))
    transformer.finish()
    assert 'Rejected array poses: 2; the last is not a rigid motion' in transformer.problem


def test_samples_that_wait_at_the_end_are_counted_but_no_problem() -> None:
    transformer, sink = make_transformer()
    for stamp in (1.0, 1.1):
        transformer.add_pose(stamp, SWAY.pose(stamp), 'camera')
    transformer.add_point(tip(1.05, PLACE))
    transformer.add_point(tip(1.15, PLACE))
    transformer.finish()
    assert len(sink.added) == 1 and [cause for _, cause in sink.rejected] == ['no_reference']
    assert not transformer.problem


def test_combines_tf_frames_with_the_array_pose() -> None:
    frames = Frames()
    transformer, sink = make_transformer(frames)
    T_camera_wand = exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    transformer.add_pose(1.0, SWAY.pose(1.0), 'camera')
    in_wand = transform(inverse(T_camera_wand) @ SWAY.pose(1.0), PLACE)
    transformer.add_point(tip(1.0, in_wand, 'wand'))
    assert not sink.added
    transformer.add_transform('camera', 'wand', 0.0, T_camera_wand, True)
    np.testing.assert_allclose(sink.added[0].position, PLACE, atol=1e-9)


def test_without_an_array_transforms_by_tf_only() -> None:
    transformer, sink = make_transformer(Frames(), reference__topic='', probe__frame_id='world')
    T = exp([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    transformer.add_point(tip(1.0, PLACE, 'world'))
    transformer.add_point(tip(1.05, PLACE, 'camera'))
    for stamp in (1.0, 1.1):
        transformer.add_transform('world', 'camera', stamp, T, False)
    assert [sample.frame_id for sample in sink.added] == ['world', 'world']
    np.testing.assert_array_equal(sink.added[0].position, PLACE)
    np.testing.assert_allclose(sink.added[1].position, transform(T, PLACE))
    transformer.add_point(tip(1.2, PLACE, 'nowhere'))
    transformer.add_point(tip(1.3, PLACE, 'camera'))
    transformer.finish()
    assert sink.causes == {'wrong_frame': 1, 'no_reference': 1}


def test_without_tf_rejects_points_in_another_frame() -> None:
    transformer, sink = make_transformer(None, reference__topic='', probe__frame_id='world')
    transformer.add_point(tip(1.0))
    assert sink.causes == {'wrong_frame': 1} and 'tf2_msgs' in transformer.problem


def test_without_array_and_frame_passes_points_unchanged() -> None:
    transformer, sink = make_transformer(Frames(), reference__topic='')
    samples = [tip(1.0, PLACE, 'a'), tip(1.1, PLACE, 'b')]
    for sample in samples:
        transformer.add_point(sample)
    assert sink.added == samples


def test_a_looped_recording_restarts_once_and_loses_no_points() -> None:
    transformer, sink = make_transformer()
    stamps = np.arange(0.05, 3.0, 1.0 / 130.0)
    for _ in range(2):
        play(transformer, stamps, np.arange(0.0, 3.1, 1.0 / 80.0))
    assert len(sink.restarts) == 1 and TIP in sink.restarts[0]
    # the first points arrived before the poses showed that the clock went back
    assert [sample.stamp for sample in sink.added] == stamps.tolist()
    off = np.array([sample.position for sample in sink.added]) - PLACE
    assert np.linalg.norm(off, axis=1).max() < 5e-6


def test_late_points_do_not_restart() -> None:
    transformer, sink = make_transformer(None, reference__topic='')
    for stamp in (*np.arange(10.0, 12.0, 0.0125), 3.0, 3.1, *np.arange(12.0, 13.0, 0.0125)):
        transformer.add_point(tip(stamp))
    assert not sink.restarts and sink.causes == {'not_monotonic': 2}


def test_restarts_when_the_local_clock_goes_back() -> None:
    transformer, sink = make_transformer(None, reference__topic='')
    transformer.add_point(tip(1.0, arrival=100.0))
    transformer.local_clock_went_back(100.0, 20.0)
    assert sink.restarts == ['the clock went back by 80.0 s']


def test_clear_accepts_stamps_that_go_back() -> None:
    transformer, sink = make_transformer(None, reference__topic='')
    transformer.add_point(tip(1000.0))
    transformer.clear()
    transformer.add_point(tip(1.0))
    assert not sink.restarts and [sample.stamp for sample in sink.added] == [1000.0, 1.0]


moves = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(
    lambda twist: exp(np.array(twist)))


@settings(deadline=None)
@given(moves, st.lists(st.floats(0.0, 2.0), min_size=1, max_size=40))
def test_array_frame_positions_do_not_depend_on_the_tracker_frame(
        T_moved: Array, stamps: list[float]) -> None:
    positions = []
    for T in (np.eye(4), T_moved):
        transformer, sink = make_transformer()
        for stamp in np.arange(-0.1, 2.2, 0.0125):
            transformer.add_pose(stamp, T @ SWAY.pose(stamp), 'camera')
        for stamp in sorted(stamps):
            transformer.add_point(tip(stamp, transform(T @ SWAY.pose(stamp), PLACE)))
        positions.append([sample.position for sample in sink.added])
        assert len(sink.added) == len(stamps)
    np.testing.assert_allclose(*positions, atol=1e-9)


@settings(deadline=None)
@given(st.lists(st.tuples(st.sampled_from(['point', 'pose']), st.floats(0.0, 30.0)), max_size=80))
def test_every_point_is_added_or_rejected_once(events: list[tuple[str, float]]) -> None:
    transformer, sink = make_transformer()
    topics = []
    for kind, stamp in events:
        if kind == 'pose':
            transformer.add_pose(stamp, np.eye(4), 'camera')
        else:
            topics.append(f'/{len(topics)}')
            transformer.add_point(tip(stamp, PLACE, topic=topics[-1]))
    transformer.finish()
    decided = [*sink.added, *(sample for sample, _ in sink.rejected)]
    assert sorted(sample.topic for sample in decided) == sorted(topics)


def test_a_tool_fixed_to_a_moving_bone_has_one_pose_in_the_array_frame() -> None:
    transformer, sink = make_transformer()
    T_array_tool = exp([0.3, -0.2, 0.1, 0.0, 0.0, 0.1])
    for stamp in np.arange(0.0, 2.0, 0.01).tolist():
        transformer.add_pose(stamp, SWAY.pose(stamp), 'camera')
    for stamp in np.arange(0.005, 1.9, 0.05).tolist():
        T = SWAY.pose(stamp) @ T_array_tool
        x, y, z = T[:3, 3].tolist()
        qx, qy, qz, qw = quaternion_from_rotation(T[:3, :3]).tolist()
        transformer.add_point(Sample(stamp, (x, y, z), 'camera', '/tool',
                                     tool=(x, y, z, qx, qy, qz, qw)))
    assert len(sink.added) == 38 and len(sink.reference_poses) == 200
    for each in sink.added:
        assert each.tool is not None and each.tool[:3] == each.position
        assert np.allclose(each.position, T_array_tool[:3, 3], atol=1e-6)
        turn = rotation_from_quaternion(each.tool[3:])
        assert np.allclose(turn, T_array_tool[:3, :3], atol=1e-6)


def test_a_calibration_takes_samples_before_they_are_transformed() -> None:
    transformer, sink = make_transformer()      # there is no pose of the array
    sink.calibrating = True
    transformer.add_point(Sample(1.0, (1.0, 2.0, 3.0), 'camera', '/tool'))
    transformer.finish()
    assert [each.position for each in sink.taken] == [(1.0, 2.0, 3.0)]
    assert not sink.added and not sink.rejected
