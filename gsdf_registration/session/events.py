# SPDX-License-Identifier: Apache-2.0
"""
What happens to a session, event by event, and the session that follows from it.

Who listens to a session (`Session.listen`) is told, in order, every change of what it holds; each
value is made of what JSON knows:

============  ======================================================================================
event         value
============  ======================================================================================
model         SHA-256 of the bone, or None; the first event of all
clear         None: all is dropped but the model; the sources and the pose that stands follow
session       a whole session that takes the place of what was held, as `SessionRecord.to_dict`
collecting    whether points are collected from now on
frame         name of the frame of the points
source        name of a source; the first one is number 0
point         [stroke, source, stamp, x, y, z], kept; s and m
rejected      {cause: number} of points not kept
undo          number of the stroke dropped
withdrawn     [source, stamp]: what that source delivered since then is dropped
landmark      as in the session
verification  as in the session
registration  {result, pose_frame_id, verifications: measured anew, fit: [residual, weight] of each
              point held, or None}; the last three are None for a refusal
pose          [frame, result]: a good registration that stands although its points were dropped
============  ======================================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gsdf_registration.session.record import FIT, SOURCE, STAMP, STROKE, empty_record

Listener = Callable[[str, Any], None]


class Replay:
    """Follows events and knows the session they lead to, as `SessionRecord.to_dict` gives it."""

    def __init__(self) -> None:
        self.session: dict[str, Any] = empty_record(None)

    def take(self, event: str, value: Any) -> None:
        """
        Take in one event.

        Raises
        ------
        KeyError, TypeError, ValueError, IndexError
            When it is none, or its value is not what it must be; the session is then not to be used
            any more.

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
        elif event == 'pose':
            session['frames']['pose'], session['pose_result'] = value
        elif event == 'model':
            self._take_model(value)
        elif event == 'clear':
            self.session = empty_record(session['model_sha256']) | {
                'collecting': session['collecting']}
        elif event == 'session':
            self.session = {**empty_record(None), **value}
        else:
            raise ValueError(f'there is no event "{event}"')

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

    def _take_model(self, model_sha256: str | None) -> None:
        session = self.session
        if session['model_sha256'] != model_sha256:
            session |= {'result': None, 'pose_result': None, 'verifications': []}
            if session['model_sha256'] is not None:
                session['landmarks'] = []
            session['frames']['pose'] = ''
            for row in session['points']:
                row[FIT:] = [None, None]
        session['model_sha256'] = model_sha256
