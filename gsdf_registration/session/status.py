# SPDX-License-Identifier: Apache-2.0
"""The status of a session: its state, and one sentence on what is wrong or what to do next."""

from __future__ import annotations

from dataclasses import dataclass

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.common.samples import Rejection
from gsdf_registration.common.tool_pose import TIP_UNKNOWN
from gsdf_registration.registration.stroke_report import StrokeReport
from gsdf_registration.session.calibration import CalibrationProgress
from gsdf_registration.session.landmark_capture import CapturedLandmark
from gsdf_registration.session.notices import Notices
from gsdf_registration.session.pose_changes import WithdrawnPose
from gsdf_registration.session.state import SessionState
from gsdf_registration.session.verification import VerificationSummary, summarize


@dataclass(frozen=True)
class Status:
    """Snapshot of a session for the operator."""

    state: str      # 'no_model', 'idle', 'collecting', 'solving', 'registered' or 'refused'
    message: str    # for the operator
    received: int
    kept: int
    rejected: dict[str, int]    # samples by cause: every `Rejection`, and causes of a recording
    strokes: int
    landmarks: int
    remaining_landmarks: tuple[str, ...]
    frame_id: str | None        # frame of the points; None until the first one
    reason: Reason | None       # of the last registration
    result: RegistrationResult | None       # of the last registration, accepted or refused
    pose_result: RegistrationResult | None  # of the accepted registration
    pose_frame_id: str          # frame of its pose
    outdated: bool              # whether points of the accepted registration were dropped since
    stroke_reports: tuple[StrokeReport, ...]    # at the accepted registration
    landmark_errors: dict[str, float]       # m, from each landmark to its place on the bone
    verification: VerificationSummary | None    # None without verification points
    notice: str                 # on a past event, as a resumed session; else empty
    warning: bool = False       # whether the operator should act on the notice
    session_id: str = ''
    registration_id: int = 0    # of the accepted registration, from 1; 0: none yet
    pose_stamp: float = 0.0     # s, of the newest point that the accepted registration used
    withdrawn: WithdrawnPose | None = None      # the pose withdrawn last; None after the next one
    captured: tuple[CapturedLandmark, ...] = ()
    calibration: CalibrationProgress | None = None      # of one that runs
    full: bool = False          # whether collecting has stopped because no more points fit
    collecting: bool = False
    progress: float | None = None       # of what the operator waits for, 0 to 1; None: nothing


_ADVICE = {
    Rejection.NOT_FINITE: 'most samples are not numbers: is the probe in view of the tracker?',
    Rejection.BAD_QUATERNION:
        'most poses of the tool have no unit quaternion: does the driver fill in the orientation?',
    Rejection.WRONG_FRAME:
        'most points are in another frame than the first: set probe.frame_id or clear',
    Rejection.NO_REFERENCE:
        'most points have no pose of the reference array, or no transform on /tf, at their time: '
        'is the array in view, and do all stamps come from one clock?',
    Rejection.NOT_MONOTONIC:
        'most stamps do not ascend: does the driver set them? If a recording restarted, clear',
    Rejection.STALE: 'most points arrive late: is the network or the computer overloaded?',
    Rejection.LOST:
        'most points were lost before the node could take them: is the computer overloaded?',
    Rejection.POOR_QUALITY:
        'the tracker reports large errors: turn the probe towards it, keep metal away',
    Rejection.DUPLICATE:
        'most points repeat the one before: the tip does not move, or the tracker has lost it',
    Rejection.TOO_FAST: 'most points jump: is the unit of the points right, is there interference?',
    Rejection.FULL:
        'collecting has stopped: no more points can be stored (collect.max_points); register, undo '
        'the last stroke or clear',
}


def count_points(state: SessionState) -> str:
    """Return the number of points and strokes in words."""
    collection = state.collection
    return (f'{format_count(len(collection), "point")} in '
            f'{format_count(collection.strokes, "stroke")}')


def accepted_stays(state: SessionState) -> str:
    """Return the end of a sentence on dropped data: what happens to the accepted registration."""
    return '' if state.accepted is None else (
        '; the accepted registration stays until the next one')


def make_status(state: SessionState, solving: bool, notices: Notices,
                calibration: CalibrationProgress | None = None) -> Status:
    """Return the status of a session; ``solving``: whether a registration runs."""
    collection = state.collection
    accepted = None if state.accepted is None else state.accepted.result
    remaining = state.landmarks.remaining(state.config.landmarks)
    name = 'collecting' if collection.collecting else 'idle'
    if state.field is None:
        name = 'no_model'
    elif solving:
        name = 'solving'
    elif notices.registration_is_current and state.result is not None:
        name = 'registered' if state.result.success else 'refused'
    return Status(
        state=name,
        message='; '.join(filter(None, (
            '' if calibration is None else calibration.sentence,
            _sentence(name, state, remaining), notices.text))),
        received=collection.received,
        kept=len(collection),
        rejected=dict(collection.counts),
        strokes=collection.strokes,
        landmarks=len(state.landmarks.captured),
        remaining_landmarks=tuple(remaining),
        frame_id=collection.frame_id,
        reason=None if state.result is None else state.result.reason,
        result=state.result,
        pose_result=accepted,
        pose_frame_id='' if state.accepted is None else state.accepted.frame_id,
        outdated=state.outdated,
        stroke_reports=state.reports(),
        landmark_errors={} if accepted is None or accepted.T_tracker_bone is None
        else state.landmarks.errors(accepted.T_tracker_bone),
        verification=summarize(state.verifications, state.config.limits.verification),
        notice=notices.text,
        warning=notices.warning or state.tip_unknown,
        session_id=state.session_id,
        registration_id=state.registration_id,
        pose_stamp=0.0 if state.accepted is None else state.accepted.newest,
        withdrawn=state.withdrawn,
        captured=tuple(state.landmarks.captured),
        calibration=calibration,
        full=_is_full(state),
        collecting=collection.collecting)


def _sentence(name: str, state: SessionState, remaining: list[str]) -> str:
    """Return one or two sentences on a session whose status is ``name``."""
    if name == 'no_model':
        return 'no bone model is loaded; set model.path'
    amount = count_points(state) + accepted_stays(state)
    if name == 'solving':
        return f'registering; {amount}'
    if state.result is not None and name in ('registered', 'refused'):
        return '; '.join(part for part in (state.result.message, input_problem(state)) if part)
    activity = 'collecting' if name == 'collecting' else 'not collecting'
    parts = [f'{activity}; {amount}', input_problem(state)]
    if _is_full(state):     # it collects no more
        parts = [input_problem(state), amount]
    if remaining:
        parts.append(f'next landmark is "{remaining[0]}"')
    return '; '.join(part for part in parts if part)


def input_problem(state: SessionState) -> str:
    """Return why most samples are rejected, or that the collection is full; else empty."""
    collection, counts = state.collection, state.collection.counts
    if _is_full(state):
        return _ADVICE[Rejection.FULL]
    if state.tip_unknown:
        return TIP_UNKNOWN
    while_collecting = collection.received - counts[Rejection.NOT_COLLECTING.value]
    expected = state.config.points_frame
    advice = _ADVICE if not expected else _ADVICE | {
        Rejection.WRONG_FRAME: f'most points are not in "{expected}": is probe.frame_id right?'}
    for cause, text in advice.items():
        if cause is not Rejection.FULL and 2 * counts[cause.value] > max(while_collecting, 20):
            return text
    if collection.frame_id == '':
        return 'the points have no frame: header.frame_id must be set by their driver'
    return ''


def _is_full(state: SessionState) -> bool:
    """Return whether collecting has stopped because no more points can be stored."""
    return len(state.collection) >= state.config.collect.max_points
