# SPDX-License-Identifier: Apache-2.0
"""The text of the console: the verdict, limits beside values, counters, landmarks."""

from __future__ import annotations

import re

import pytest

from gsdf_registration.common.samples import Rejection
from gsdf_registration.visualization import console_panel
from gsdf_registration.visualization.console_panel import CAUSES, Limits, Tracker

REGISTERED = {
    'state': 'registered', 'grade': 'B', 'pose': 'in tracker', 'withdrawn': '',
    'zone.limit_m': '0.002', 'zone.p95_m.cup': '0.0012', 'zone.touched_p95_m': '0.0008',
    'zone.bone_p95_m': '0.0031', 'sigma_m': '0.0003', 'received': '632', 'kept': '619',
    'rejected.too_fast': '13', 'rejected.stale': '0', 'landmarks': '1',
    'landmark_miss_m.tip': '0.0031', 'stroke.1': '100 points', 'stroke.3': 'soft tissue'}


def words(html: str) -> str:
    """Return what a reader sees of HTML, on one line."""
    return ' '.join(re.sub(r'<[^>]+>', ' ', html).split())


def test_the_verdict_comes_in_words_and_hints_come_apart_from_it() -> None:
    message = 'pose found from 601 points; accurate to 2 mm; start the tracker; move on'
    shown = words(console_panel.verdict(REGISTERED, message))
    assert shown == 'Registered: grade B Pose found from 601 points Accurate to 2 mm'
    assert words(console_panel.hints(REGISTERED, message)) == 'Start the tracker Move on'


def test_a_message_does_not_repeat_the_headline() -> None:
    collecting = {'state': 'collecting'}
    shown = words(console_panel.verdict(collecting, 'collecting; 7 points in 1 stroke'))
    assert shown == 'Collecting 7 points in 1 stroke'
    place = {'touch_next': 'touch the rim'}
    assert words(console_panel.hints(place, 'a; b; touch the rim; c')) == 'C'


@pytest.mark.parametrize(('state', 'headline'), [
    ('ready', 'Ready to register'), ('collecting', 'Collecting'), ('refused', 'Refused'),
    ('no_model', 'No bone model'), ('solving', 'Registering')])
def test_every_state_has_a_headline(state: str, headline: str) -> None:
    assert words(console_panel.verdict({'state': state})) == headline


def test_a_bone_that_is_being_loaded_is_no_alarm() -> None:
    loading = {'state': 'no_model', 'progress': '0.40'}
    assert words(console_panel.verdict(loading)) == 'Loading the bone'


def test_says_that_the_node_is_not_connected_and_that_a_pose_is_withdrawn() -> None:
    assert words(console_panel.verdict(None)) == 'No connection to the node'
    withdrawn = {'state': 'idle', 'pose': 'none', 'withdrawn': 'array_displaced'}
    assert 'No pose: array displaced' in words(console_panel.verdict(withdrawn))


def test_limits_stand_beside_values() -> None:
    shown = console_panel.accuracy(REGISTERED, Limits(max_sigma=0.002))
    assert words(shown) == (
        'Error at cup (95 %) 1.2 of 2.0 mm Error around the touched area (95 %) 0.8 of 2.0 mm '
        'Error on the whole bone (95 %) 3.1 of 2.0 mm '
        'Scatter of the points (not the accuracy) 0.3 of 2.0 mm')
    assert [style for style in re.findall(r'class="value (good|warn)"', shown)] == [
        'good', 'good', 'warn', 'good']


def test_counters_name_the_causes_and_add_up() -> None:
    assert words(console_panel.counters(REGISTERED)) == 'Received 632 Kept 619 Jumped 13'


def test_every_cause_of_rejection_has_words() -> None:
    assert CAUSES.keys() == {cause.value for cause in Rejection}


def test_names_the_next_landmark() -> None:
    shown = words(console_panel.landmarks(REGISTERED, ['tip', 'neck', 'cup']))
    assert shown == 'tip 3.1 mm off neck next: hold the tip on it cup'


def test_lists_strokes_by_number() -> None:
    assert console_panel.strokes(REGISTERED) == {1: '100 points', 3: 'soft tissue'}


@pytest.mark.parametrize(('tracker', 'expected'), [
    (Tracker(), 'Probe not seen yet'), (Tracker(80.0, 0.01), 'Probe in view 80 samples per second'),
    (Tracker(0.0, 12.3), 'Probe not seen for 12 s')])
def test_says_whether_the_probe_is_seen(tracker: Tracker, expected: str) -> None:
    assert words(console_panel.tracking(tracker)) == expected


def test_names_the_place_to_touch_next() -> None:
    shown = console_panel.tracking(Tracker(80.0, 0.01), {'touch_next': 'touch the rim'})
    assert words(shown).endswith('samples per second Touch the rim')
    assert words(console_panel.tracking(None)) == ''


def test_verification_points_stand_beside_their_limit() -> None:
    values = {'verification': 'worst 2.8 mm', 'verification_m.1': '0.000800',
              'verification_m.2': '-0.002800'}
    shown = console_panel.verification(values, Limits(verification=0.002))
    assert words(shown) == 'Point 1 0.8 of 2.0 mm Point 2 2.8 of 2.0 mm Worst 2.8 mm'
    assert re.findall(r'class="value (good|warn)"', shown) == ['good', 'warn']


def test_the_legend_has_the_fixed_scales_with_the_border_in_the_middle() -> None:
    shown = words(console_panel.legend(Limits(max_sigma=0.002, max_error=0.003)))
    assert '0 3.0 mm, border 6.0 mm' in shown and '0 2.0 mm' in shown


def test_buttons_that_toggle_say_what_they_do() -> None:
    assert console_panel.labels({'collecting': 'true'})['collect'] == 'Pause'
    assert console_panel.labels({'collecting': 'false'})['collect'] == 'New stroke'
    running = console_panel.labels({'calibration': 'calibrate_tip'})
    assert running['calibrate_tip'] == 'End calibration'


def test_text_from_messages_is_not_html() -> None:
    assert '<b>' not in console_panel.verdict({'state': 'idle'}, '<b>bold</b>')
    assert '<b>' not in console_panel.landmarks({}, ['<b>'])
