# SPDX-License-Identifier: Apache-2.0
"""The status for operators and programs: one sentence, and values in SI units or plain text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

from gsdf_registration.common.result import Reason, RegistrationResult, Zone
from gsdf_registration.common.withdrawal import Withdrawal
from gsdf_registration.registration.stroke_report import StrokeReport, interference_message
from gsdf_registration.session.calibration import CalibrationProgress
from gsdf_registration.session.pose_changes import WithdrawnPose
from gsdf_registration.session.status import Status

# Reasons that are expected before the operator has touched much of the bone
NOT_STARTED = {Reason.TOO_FEW_POINTS, Reason.REGION_TOO_SMALL, Reason.WRONG_UNIT}


class LiveState(Protocol):
    """What is used of the status of the live registration, see `live.LiveStatus`."""

    @property
    def ready(self) -> bool:
        """Whether the points suffice."""

    @property
    def message(self) -> str:
        """What is missing."""

    @property
    def reason(self) -> Reason | None:
        """Why the pose cannot be registered yet."""

    @property
    def touch_next(self) -> str:
        """Where to touch next."""

    @property
    def used(self) -> int:
        """Points used."""

    @property
    def predicted_tre_m(self) -> Mapping[str, float]:
        """Expected errors, m."""

    @property
    def stroke_reports(self) -> Sequence[StrokeReport]:
        """One per stroke."""


def pose_kept(status: Status) -> str:
    """Return what to append to a refusal if an earlier registration stays in use."""
    return '' if status.pose_result is None else '; the accepted registration is kept'


def shown_message(status: Status) -> str:
    """Return the sentence of ``~/status``."""
    return status.message + (pose_kept(status) if status.state == 'refused' else '')


def level_name(status: Status) -> str:
    """Return the level of ``~/status``: OK, WARN or ERROR."""
    level = {'no_model': 'ERROR', 'refused': 'WARN'}.get(status.state, 'OK')
    full = status.full and status.state in ('collecting', 'idle', 'ready')
    return 'WARN' if level == 'OK' and (full or status.warning) else level


def combined_status(status: Status, live: LiveState) -> Status:
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


def status_values(status: Status, live: LiveState) -> dict[str, str]:
    """Return what programs read of a status, by name; docs/interface.md describes each."""
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
    return {key: str(value) for key, value in values.items()}


def _accuracy(result: RegistrationResult) -> dict[str, str]:
    """Return how accurate the accepted registration is."""
    values = {'used': str(result.used), 'inliers': str(result.inliers),
              'grade': result.grade or ''}
    values |= {f'left_out.{cause}': str(count) for cause, count in result.left_out.items()}
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


def _live_values(live: LiveState) -> dict[str, str]:
    """Return the state of the live registration."""
    values = {'touch_next': live.touch_next, 'live.points': str(live.used),
              'live.reason': '' if live.reason is None else str(live.reason)}
    values |= {f'live.predicted_tre_m.{target}': f'{tre:.6f}'
               for target, tre in live.predicted_tre_m.items()}
    return values
