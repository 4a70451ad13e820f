# SPDX-License-Identifier: Apache-2.0
"""The report of a session: replayed from a recording, or saved in a file."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gsdf_registration.cli import inputs, landmark_files, outputs
from gsdf_registration.common.command_line import spinner
from gsdf_registration.common.result import InputError, Refusal

if TYPE_CHECKING:
    from gsdf_registration.common.config import Config
    from gsdf_registration.common.landmarks import Landmarks
    from gsdf_registration.common.result import RegistrationResult
    from gsdf_registration.common.rigid import Array
    from gsdf_registration.field import Field
    from gsdf_registration.session import Session
    from gsdf_registration.visualization.report_content import ReportContent


def content_of(session: Session, result: RegistrationResult, config: Config, field: Field, *,
               title: str, case: str, axes: str, about: Mapping[str, str],
               landmarks: Landmarks | None = None) -> ReportContent:
    """
    Return the content of the report of a session.

    Parameters
    ----------
    session : with the points
    result : accepted or refused
    config, field : of the registration
    title, case, axes, about : as in `ReportContent`
    landmarks : those of a file; None: those of the session

    """
    from gsdf_registration.common.landmarks import Landmarks
    from gsdf_registration.visualization.report_content import ReportContent, VerificationPoint
    status, points = session.status(), session.points()
    registered = session.registered_points()
    if result.success and registered is not None:
        points = registered
    captured, stamps = status.captured, [each.stamp for each in status.captured]
    if landmarks is not None:
        stamps = []
    elif captured:
        landmarks = Landmarks.of([each.model for each in captured],
                                 [each.tracker for each in captured],
                                 [each.sigma_m for each in captured],
                                 [each.name for each in captured])
    verifications = [
        VerificationPoint(f'checkpoint {each.checkpoint}', each.position, each.distance_m,
                          each.stamp, each.moved_m) for each in session.verifications()]
    known: dict[str, Any] = {}
    if landmarks is not None:
        known = {'landmarks': landmarks, 'landmark_stamps': stamps}
    about = {**about, 'frame of the points': status.frame_id or 'not known'}
    return ReportContent(title, result, config, field, points, verifications=verifications,
                         case=case, date=outputs.day_of(points.stamps), axes=axes, about=about,
                         **known)


def content_of_refusal(result: RegistrationResult, config: Config, positions: Array, *, title: str,
                       case: str, axes: str, about: Mapping[str, str]) -> ReportContent:
    """Return the content of a report without a bone; ``positions`` (n, 3), m, of a recording."""
    from gsdf_registration.common.samples import untimed
    from gsdf_registration.visualization.report_content import ReportContent
    return ReportContent(title, result, config, None, untimed(positions), timed=False, case=case,
                         axes=axes, about=about)


def run(args: argparse.Namespace) -> int:
    """Write the report of a saved session; return 1 if it has no accepted registration."""
    from msg_adapters.files import sha256_of
    from msg_adapters.session_file import read_session
    path = Path(args.points)
    if path.suffix.lower() != '.json':
        raise InputError(f'{path}: --report needs a saved session (.json); for a recording use '
                         'gsdf replay --report, for a file of points gsdf register --report')
    outputs.require_report(args.report)
    record = read_session(path)
    config = inputs.effective_config(args, settings_of(record))
    with spinner('loading the bone'):
        field = inputs.field_or_refusal(config)
    if isinstance(field, Refusal):
        raise InputError(field.message)
    result = write_report(args.report, record, config, field,
                          title=f'{Path(args.model).name} from {path.name}', case=args.case,
                          axes=landmark_files.axes_of(args, config).model,
                          about={'session': str(path), 'session SHA-256': sha256_of(str(path))})
    verdict = 'Registered' if result.success else f'Refused ({result.reason})'
    print(f'{verdict}: {result.message}\n  report         {args.report}')
    return 0 if result.success else 1


def settings_of(record: Mapping[str, Any]) -> Config:
    """Return the settings of a saved session; those that this version does not have are ignored."""
    from gsdf_registration.common.config import Config
    known = Config().flat()
    return Config().replaced({name: value for name, value in record['parameters'].items()
                              if name in known})


def write_report(path: str, record: Mapping[str, Any], config: Config, field: Field, *, title: str,
                 axes: str, about: Mapping[str, str], case: str = '') -> RegistrationResult:
    """
    Write the report of a saved session and return the result that it shows.

    Parameters
    ----------
    path : of the report
    record : of the session
    config, field, title, axes, about, case : as in `content_of`

    """
    from gsdf_registration.session import Session
    session = Session(config, field)
    session.restore(record)
    result, source = _outcome(session)
    outputs.write_report(path, content_of(
        session, result, config, field, title=title, case=case, axes=axes, about={
            'model': config.model.path, 'model SHA-256': field.bone_sha256, **about,
            'result': source}))
    return result


def _outcome(session: Session) -> tuple[RegistrationResult, str]:
    """Return the accepted registration; if the last one was refused, register again to see why."""
    status = session.status()
    if status.pose_result is not None and (status.result is None or status.result.success):
        return status.pose_result, 'as saved in the session'
    with spinner('registering'):
        return session.register(), 'registered again from the points of the session'
