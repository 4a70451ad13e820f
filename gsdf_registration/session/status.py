# SPDX-License-Identifier: Apache-2.0
"""The session at a glance, in an operator's words: where we are, what is wrong, what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gsdf_registration.common.formatting import counted
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.samples import Rejection
from gsdf_registration.registration.stroke_report import StrokeReport
from gsdf_registration.session.collection import Collection
from gsdf_registration.session.news import News
from gsdf_registration.session.state import SessionState
from gsdf_registration.session.verification import VerificationSummary, summary


@dataclass(frozen=True)
class Status:
    """The session at a glance."""

    state: str      # 'no_model', 'idle', 'collecting', 'solving', 'registered' or 'refused'
    message: str    # one plain sentence for the operator
    received: int
    kept: int
    rejected: dict[str, int]    # every cause of `Rejection`, and those a recording knows
    strokes: int
    landmarks: int
    to_come: tuple[str, ...]    # landmarks not captured yet
    frame_id: str | None        # frame of the points; None until the first one
    reason: Reason | None       # of the last registration
    result: RegistrationResult | None       # the last one, refused or not
    pose_result: RegistrationResult | None  # the last good one
    pose_frame_id: str          # frame of its pose
    outdated: bool              # whether points that it was found with have been dropped since
    stroke_reports: tuple[StrokeReport, ...]    # of the strokes held that it was found with
    landmark_misses: dict[str, float]       # m, of each landmark from its place on the bone
    verification: VerificationSummary | None    # None without any
    remark: str                 # what is to be known of the past: taken up from a journal


_ADVICE = {
    Rejection.NOT_FINITE: 'most samples are not numbers: is the probe in view of the tracker?',
    Rejection.WRONG_FRAME:
        'most points are in another frame than the first: set probe.frame_id or clear',
    Rejection.NO_REFERENCE:
        'for most points no pose of the reference array, or transform on /tf, is known at their '
        'time: is the array in view, are all stamped by one clock?',
    Rejection.NOT_MONOTONIC:
        'most stamps do not move forward: are they set? If a recording restarted, clear',
    Rejection.STALE: 'most points come in late: is the network or the computer overloaded?',
    Rejection.POOR_QUALITY:
        'the tracker reports large errors: turn the probe towards it, keep metal away',
    Rejection.DUPLICATE:
        'most points repeat the one before: the tip rests, or the tracker has lost it',
    Rejection.TOO_FAST: 'most points jump: is the unit of the points right, is there interference?',
    Rejection.FULL: 'no more points can be held (collect.max_points); register, undo or clear',
}


def held(holds: SessionState) -> str:
    """Return how much a session holds."""
    points, strokes = len(holds.collection), holds.collection.strokes
    return f'{counted(points, "point")} in {counted(strokes, "stroke")} held'


def pose_stands(holds: SessionState) -> str:
    """Return what becomes of the last good pose when something is dropped."""
    return '' if holds.pose is None else '; the last good pose stands until the next registration'


def status_of(holds: SessionState, solving: bool, news: News) -> Status:
    """Return a session at a glance."""
    collection, touches = holds.collection, holds.touches
    pose = None if holds.pose is None else holds.pose.result
    state = 'collecting' if collection.collecting else 'idle'
    if holds.field is None:
        state = 'no_model'
    elif solving:
        state = 'solving'
    elif news.is_registration and holds.result is not None:
        state = 'registered' if holds.result.success else 'refused'
    words = sentence(state, collection, holds.result, held(holds) + pose_stands(holds),
                     touches.to_come)
    return Status(
        state=state,
        message='; '.join(filter(None, (words, news.remarked))),
        received=collection.received,
        kept=len(collection),
        rejected=dict(collection.counts),
        strokes=collection.strokes,
        landmarks=len(touches.landmarks),
        to_come=tuple(touches.to_come),
        frame_id=collection.frame_id,
        reason=None if holds.result is None else holds.result.reason,
        result=holds.result,
        pose_result=pose,
        pose_frame_id='' if holds.pose is None else holds.pose.frame_id,
        outdated=holds.outdated,
        stroke_reports=holds.reports(),
        landmark_misses={} if pose is None or pose.T_tracker_bone is None else touches.misses(
            pose.T_tracker_bone),
        verification=summary(touches.verifications, holds.config.limits.verification),
        remark=news.remarked)


def sentence(state: str, collection: Collection, result: RegistrationResult | None, held: str,
             landmarks_to_come: Sequence[str]) -> str:
    """Return one or two sentences on a `Session` in ``state``; ``held`` says what it has."""
    if state == 'no_model':
        return 'no bone model is loaded; set model.path'
    if state == 'solving':
        return f'registering; {held}'
    if result is not None and state in ('registered', 'refused'):
        return '; '.join(part for part in (result.message, trouble(collection)) if part)
    parts = [('collecting' if state == 'collecting' else 'not collecting') + f'; {held}',
             trouble(collection)]
    if landmarks_to_come:
        parts.append(f'next landmark is "{landmarks_to_come[0]}"')
    return '; '.join(part for part in parts if part)


def trouble(collection: Collection) -> str:
    """Return what is wrong if most points are refused for one cause, or no more fit in."""
    counts = collection.counts
    looked_at = collection.received - counts[Rejection.NOT_COLLECTING.value]
    wanted = collection.wanted_frame
    other = {Rejection.WRONG_FRAME: f'most points are not in "{wanted}": is probe.frame_id right?'}
    for cause, advice in (_ADVICE | other if wanted else _ADVICE).items():
        full = cause is Rejection.FULL and len(collection) >= collection.max_points
        if full or 2 * counts[cause.value] > max(looked_at, 20):
            return advice
    if collection.frame_id == '':
        return 'the points name no frame: have their driver fill in header.frame_id'
    return ''
