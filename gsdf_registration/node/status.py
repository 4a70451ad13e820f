# SPDX-License-Identifier: Apache-2.0
"""The status message: one sentence for the operator, key-value pairs for programs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

from gsdf_registration.common.result import Reason, RegistrationResult, Zone
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.live import LiveStatus
from gsdf_registration.registration.stroke_report import interference_message
from gsdf_registration.session.calibration import CalibrationProgress
from gsdf_registration.session.pose_changes import WithdrawnPose
from gsdf_registration.session.status import Status
from msg_adapters.ros import diagnostic_status

LEVELS = {'no_model': DiagnosticStatus.ERROR, 'refused': DiagnosticStatus.WARN}     # else OK

# Reasons that are expected before the operator has touched much of the bone
NOT_STARTED = {Reason.TOO_FEW_POINTS, Reason.REGION_TOO_SMALL, Reason.WRONG_UNIT}


def pose_kept(status: Status) -> str:
    """Return what to append to a refusal if an earlier registration stays in use."""
    return '' if status.pose_result is None else '; the accepted registration is kept'


def combined_status(status: Status, live: LiveStatus) -> Status:
    """Return the status of the session with that of the live registration: missing, or ready."""
    registered = status.pose_result is not None and not status.outdated
    if live.ready and not registered and status.state in ('collecting', 'idle', 'refused'):
        return replace(status, state='ready', message=sentence(
            status.message if status.full else '', live.message, status.notice))
    if status.state not in ('collecting', 'idle'):
        return status
    # A good registration need not be repeated, and landmarks come before strokes
    skip_live = live.ready or (status.remaining_landmarks and live.reason in NOT_STARTED)
    return replace(status, message=sentence(
        status.message, interference_message(live.stroke_reports),
        '' if skip_live else live.message))


def not_active(status: Status) -> Status:
    """Return the status of a node that is not active: it publishes no pose."""
    if status.pose_result is None:
        return status
    withdrawn = WithdrawnPose(Withdrawal.DEACTIVATED, '', status.session_id,
                              status.registration_id, status.pose_frame_id)
    return replace(status, state='idle', pose_result=None, withdrawn=withdrawn)


def sentence(*parts: str) -> str:
    """Return the parts that are not empty, joined to one sentence."""
    return '; '.join(part for part in parts if part)


def status_message(status: Status, live: LiveStatus, name: str) -> DiagnosticStatus:
    """Return ``status`` as a message from the node ``name``. Values are SI units or plain text."""
    values: dict[str, Any] = {
        'state': status.state, 'received': status.received, 'kept': status.kept,
        'collecting': str(status.collecting).lower(), 'strokes': status.strokes,
        'landmarks': status.landmarks, 'frame_id': status.frame_id or '',
        'reason': status.reason or '',
        'progress': '' if status.progress is None else f'{status.progress:.2f}', **{
            f'rejected.{cause}': count
            for cause, count in status.rejected.items()
        }, 'pose': 'none' if status.pose_result is None else f'in {status.pose_frame_id}',
        'withdrawn': '' if status.withdrawn is None else status.withdrawn.reason,
        **_calibration(status.calibration),
        **(_accuracy(status.pose_result) if status.pose_result is not None else {}),
        **_live_values(live),
        **{f'stroke.{each.number}': each.sentence
           for each in live.stroke_reports or status.stroke_reports},
        **{f'landmark_miss_m.{name}': f'{error:.6f}'
           for name, error in status.landmark_errors.items()},
        **({} if status.pose_result is None else
           {f'landmark.{fit.name}': fit.sentence for fit in status.pose_result.landmarks}),
    }
    if status.verification is not None:
        values['verification'] = status.verification.sentence
        values |= {f'verification_m.{number}': f'{distance:.6f}'
                   for number, distance in status.verification.distances_m.items()}
    message = status.message + (pose_kept(status) if status.state == 'refused' else '')
    level = LEVELS.get(status.state, DiagnosticStatus.OK)
    full = status.full and status.state in ('collecting', 'idle', 'ready')
    if level == DiagnosticStatus.OK and (full or status.warning):
        level = DiagnosticStatus.WARN
    return diagnostic_status(name, level, message, values)


def with_stamp(status: DiagnosticStatus, stamp: Time) -> DiagnosticStatus:
    """Return a copy with the value ``stamp``, seconds and nanoseconds: it has no header."""
    value = KeyValue(key='stamp', value=f'{stamp.sec}.{stamp.nanosec:09d}')
    return DiagnosticStatus(level=status.level, name=status.name, message=status.message,
                            hardware_id=status.hardware_id, values=[value, *status.values])


def _accuracy(result: RegistrationResult) -> dict[str, str]:
    """Return how accurate the accepted registration is."""
    values = {'used': str(result.used), 'inliers': str(result.inliers),
              'grade': result.grade or ''}
    values |= {
        f'predicted_tre_m.{target}': f'{tre:.6f}'
        for target, tre in result.predicted_tre_m.items() if tre is not None
    }
    for name in ('sigma_m', 'runner_up_ratio'):
        if getattr(result, name) is not None:
            values[name] = f'{getattr(result, name):.6f}'
    if result.zone is not None:
        values |= _zone(result.zone)
    if result.weakest_direction is not None:
        values['weakest_direction'] = result.weakest_direction.sentence
    return values


def _zone(zone: Zone) -> dict[str, str]:
    """Return where the pose may be used."""
    return {'zone.limit_m': f'{zone.limit_m:.6f}', 'zone.distance_m': f'{zone.distance_m:.6f}',
            'zone.bone_share': f'{zone.bone_share:.4f}',
            'zone.touched_p95_m': f'{zone.touched_p95_m:.6f}',
            'zone.bone_p95_m': f'{zone.bone_p95_m:.6f}',
            **{f'zone.p95_m.{target}': f'{p95:.6f}' for target, p95 in zone.p95_m.items()}}


def _calibration(progress: CalibrationProgress | None) -> dict[str, str]:
    """Return the state of a calibration."""
    if progress is None:
        return {'calibration': ''}
    return {'calibration': progress.kind.value, 'calibration.poses': str(progress.poses),
            'calibration.angle_deg': f'{math.degrees(progress.angle):.0f}'}


def _live_values(live: LiveStatus) -> dict[str, str]:
    """Return the state of the live registration."""
    values = {'touch_next': live.touch_next, 'live.points': str(live.used),
              'live.reason': '' if live.reason is None else str(live.reason)}
    values |= {f'live.predicted_tre_m.{target}': f'{tre:.6f}'
               for target, tre in live.predicted_tre_m.items()}
    return values
