# SPDX-License-Identifier: Apache-2.0
"""
The events of a session, and the session record that results from them.

A listener (`Session.listen`) receives every change of the session, in order, as an event and its
value.  Values are plain, ready for JSON:

============  ======================================================================================
event         value
============  ======================================================================================
model         SHA-256 of the bone, or None; the first event, unless that is a whole session
clear         everything except the model is dropped; the sources follow.  Why, if the operator did
              not ask for it; else None
session       a whole session that replaces the state, as `SessionRecord.to_dict` with packed points
collecting    whether points are collected
frame         name of the frame of the points
source        topic of a new source; the first has number 0
point         [stroke, source, stamp, x, y, z] of an added point; s and m
rejected      {cause: number} of rejected samples
undo          number of the stroke dropped, the last one or any other
withdrawn     [source, stamp]: the points of this source from this stamp on are dropped
landmark      as in the session record
verification  as in the session record
registration  {result, pose_frame_id, verifications: measured again, fit: [residual, weight] of each
              point, or None}; the last three are None after a refusal
no_pose       why the accepted registration is withdrawn; the points stay
============  ======================================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gsdf_registration.session.record import FIT, SOURCE, STAMP, STROKE, empty_record, unpacked

Listener = Callable[[str, Any], None]


class Replay:
    """Applies events to a session record, see `SessionRecord.to_dict`."""

    def __init__(self) -> None:
        self.session: dict[str, Any] = empty_record(None)

    def apply(self, event: str, value: Any) -> None:
        """
        Apply one event.

        Raises
        ------
        KeyError, TypeError, ValueError, IndexError
            If the event is unknown or its value is not valid; the record is unusable afterwards.

        """
        session, points = self.session, self.session['points']
        if event == 'point':
            stroke, source, stamp, x, y, z = value
            points.append([stroke, source, stamp, x, y, z, None, None])
        elif event == 'rejected':
            for cause, count in value.items():
                session['rejected'][cause] = session['rejected'].get(cause, 0) + count
        elif event == 'collecting':
            session['collecting'] = value
        elif event == 'frame':
            session['frames']['points'] = value
        elif event == 'source':
            session['sources'].append(value)
        elif event == 'undo':
            points[:] = [row for row in points if row[STROKE] != value]
        elif event == 'withdrawn':
            source, since = value
            points[:] = [row for row in points if row[SOURCE] != source or row[STAMP] < since]
        elif event in ('landmark', 'verification'):
            session[f'{event}s'].append(value)
        elif event == 'registration':
            self._register(value)
        elif event == 'no_pose':
            self._withdraw_pose()
        elif event == 'model':
            self._set_model(value)
        elif event == 'clear':
            self.session = empty_record(session['model_sha256']) | {
                'collecting': session['collecting']}
        elif event == 'session':
            self.session = {**empty_record(None), **value, 'points': unpacked(value['points'])}
        else:
            raise ValueError(f'unknown event "{event}"')

    def _register(self, value: dict[str, Any]) -> None:
        session = self.session
        session['result'] = value['result']
        if value['fit'] is None:
            return
        session['pose_result'] = value['result']
        session['frames']['pose'] = value['pose_frame_id']
        session['verifications'] = value['verifications']
        for row, fit in zip(session['points'], value['fit'], strict=True):
            row[FIT:] = fit or [None, None]

    def _withdraw_pose(self) -> None:
        session = self.session
        if session['result'] == session['pose_result']:     # else the last attempt was refused
            session['result'] = None
        session['pose_result'], session['frames']['pose'] = None, ''
        for row in session['points']:
            row[FIT:] = [None, None]

    def _set_model(self, model_sha256: str | None) -> None:
        session = self.session
        if session['model_sha256'] != model_sha256:
            self._withdraw_pose()
            session |= {'result': None, 'verifications': []}
            if session['model_sha256'] is not None:
                session['landmarks'] = []
        session['model_sha256'] = model_sha256
