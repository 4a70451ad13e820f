# SPDX-License-Identifier: Apache-2.0
"""The session's status as a diagnostic message: one line for the operator, numbers for programs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from gsdf_registration.common.result import Reason, RegistrationResult
from gsdf_registration.live import LiveStatus
from gsdf_registration.registration.stroke_report import interference
from gsdf_registration.session.status import Status
from msg_adapters.ros import diagnostic_status

LEVELS = {'no_model': DiagnosticStatus.ERROR, 'refused': DiagnosticStatus.WARN}     # the others: OK

# What is said of points before the bone was really touched
NOT_BEGUN = {Reason.TOO_FEW_POINTS, Reason.REGION_TOO_SMALL, Reason.WRONG_UNIT}


def pose_kept(status: Status) -> str:
    """Return what to add to a refusal when an earlier pose stays on the air."""
    return '' if status.pose_result is None else '; the last good pose is kept'


def with_live(status: Status, live: LiveStatus) -> Status:
    """Return the session at a glance with what the live registration adds: what lacks, or ready."""
    registered = status.pose_result is not None and not status.outdated
    if live.ready and not registered and status.state in ('collecting', 'idle', 'refused'):
        message = '; '.join(filter(None, (live.message, status.remark)))
        return replace(status, state='ready', message=message)
    if status.state not in ('collecting', 'idle'):
        return status
    # what is registered well needs not be registered again, and the landmarks come first
    spare = live.ready or (status.to_come and live.reason in NOT_BEGUN)
    told = (status.message, interference(live.strokes), '' if spare else live.message)
    return replace(status, message='; '.join(sentence for sentence in told if sentence))


def status_message(status: Status, live: LiveStatus, name: str) -> DiagnosticStatus:
    """Return ``status`` as a message from the node ``name``.  Values are SI and plain text."""
    values: dict[str, Any] = {
        'state': status.state, 'received': status.received, 'kept': status.kept,
        'strokes': status.strokes, 'landmarks': status.landmarks, 'frame_id': status.frame_id or '',
        'reason': status.reason or '', **{
            f'rejected.{cause}': count
            for cause, count in status.rejected.items()
        }, 'pose': 'none' if status.pose_result is None else f'in {status.pose_frame_id}',
        **(_confidence(status.pose_result) if status.pose_result is not None else {}),
        **_live(live),
        **{f'stroke.{each.number}': each.sentence
           for each in live.strokes or status.stroke_reports},
        **{f'landmark_miss_m.{name}': f'{miss:.6f}'
           for name, miss in status.landmark_misses.items()}
    }
    if status.verification is not None:
        values['verification'] = status.verification.sentence
    message = status.message + (pose_kept(status) if status.state == 'refused' else '')
    return diagnostic_status(name, LEVELS.get(status.state, DiagnosticStatus.OK), message, values)


def _confidence(result: RegistrationResult) -> dict[str, str]:
    """Return how good the last good pose is."""
    known = {'used': str(result.used), 'inliers': str(result.inliers)}
    known |= {
        f'predicted_tre_m.{target}': f'{tre:.6f}'
        for target, tre in result.predicted_tre_m.items() if tre is not None
    }
    for name in ('sigma_m', 'runner_up_ratio'):
        if getattr(result, name) is not None:
            known[name] = f'{getattr(result, name):.6f}'
    if result.weakest_direction is not None:
        known['weakest_direction'] = result.weakest_direction.sentence
    return known


def _live(live: LiveStatus) -> dict[str, str]:
    """Return how the live registration stands."""
    known = {'touch_next': live.touch_next, 'live.points': str(live.used),
             'live.reason': '' if live.reason is None else str(live.reason)}
    known |= {f'live.predicted_tre_m.{target}': f'{tre:.6f}'
              for target, tre in live.predicted_tre_m.items()}
    return known
