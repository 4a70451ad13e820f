# SPDX-License-Identifier: Apache-2.0
"""
The events of a session, and the session record that results from them.

A listener (`Session.listen`) receives every change of the session, in order, as an event and its
value.  Values are plain, or contain rows: structured arrays that are not changed afterwards.

============  ======================================================================================
event         value
============  ======================================================================================
model         SHA-256 of the bone, or None; the first event, unless that is a whole session
clear         everything except the model is dropped; the sources follow.  Why, if the operator did
              not ask for it; else None
session       a whole session that replaces the state, as `SessionRecord.to_dict`
points        further rows of its points; a journal writes a session in parts
collecting    whether points are collected
frame         name of the frame of the points
source        topic of a new source; the first has number 0
point         [stroke, source, stamp, x, y, z] of an added point, s and m, followed by the pose of
              the tool, if there is one: x, y, z, qx, qy, qz, qw
air           [x, y, z] of the tip in the air, m, followed by the pose of the tool, if there is one
rejected      {cause: number} of rejected samples
undo          number of the stroke dropped, the last one or any other
withdrawn     [source, stamp]: the points of this source from this stamp on are dropped
landmark      as in the session record; it replaces one of the same name
verification  as in the session record
registration  {result, pose_frame_id, verifications: measured again, fit: rows of residual and
              weight}; the last three are None after a refusal
no_pose       why the accepted registration is withdrawn; the points stay
tip           [x, y, z] of the tip in the frame of the tool, or []: what was touched with a tool is
              at another place, see `tool_pose`
tip_radius    radius of the ball at the end of the probe, m
tip_error     expected error of the tip, m
============  ======================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from gsdf_registration.common.json_values import plain
from gsdf_registration.common.tool_pose import tip_positions
from gsdf_registration.session import air, landmark_capture, verification
from gsdf_registration.session.record import (
    COLUMNS,
    FIT,
    NAMES,
    OPTIONAL,
    POINT_COLUMNS,
    ROW,
    column,
    empty_record,
    landmark_from,
    verification_from,
)

CAPACITY = 1024     # points, at first
# numbers of a point in an event: with the pose of the tool, or without
SIZES = (len(POINT_COLUMNS), len(NAMES) - len(OPTIONAL))

Listener = Callable[[str, Any], None]


class Replay:
    """Applies events to a session record, see `SessionRecord.to_dict`."""

    def __init__(self) -> None:
        self._session: dict[str, Any] = empty_record(None)
        self._rows = np.empty(CAPACITY, ROW)    # of the points, with room for more
        self._size = 0

    @property
    def session(self) -> dict[str, Any]:
        """The record that results from the events so far."""
        return self._session | {'points': self._points}

    @property
    def _points(self) -> np.ndarray:
        return self._rows[:self._size]

    def apply(self, event: str, value: Any) -> None:
        """
        Apply one event.

        Raises
        ------
        KeyError, TypeError, ValueError, IndexError
            If the event is unknown or its value is not valid; the record is unusable afterwards.

        """
        session, points = self._session, self._points
        if event == 'point':
            self._append_point(value)
        elif event == 'air':
            session['air'].append(value)
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
            self._keep(points['stroke'] != value)
        elif event == 'withdrawn':
            source, since = value
            self._keep((points['source'] != source) | (points['stamp'] < since))
        elif event == 'landmark':
            session['landmarks'] = [each for each in session['landmarks']
                                    if each['name'] != value['name']] + [value]
        elif event == 'verification':
            session['verifications'].append(value)
        elif event == 'tip':
            self._apply_tip(value)
        elif event in ('tip_radius', 'tip_error'):
            session['parameters'] = {**session['parameters'], f'probe.{event}': value}
        elif event == 'registration':
            self._register(value)
        elif event == 'no_pose':
            self._withdraw_pose()
        elif event == 'model':
            self._set_model(value)
        elif event == 'clear':
            self._session = empty_record(session['model_sha256']) | {
                'collecting': session['collecting'], 'parameters': session['parameters']}
            self._size = 0
        elif event == 'session':
            self._session, self._size = {**empty_record(None), **value}, 0
            self._append(self._session['points'])
        elif event == 'points':
            self._append(value)
        else:
            raise ValueError(f'unknown event "{event}"')

    def _append_point(self, value: Sequence[float]) -> None:
        if len(value) not in SIZES:
            raise ValueError(f'a point of {len(value)} numbers')
        if self._size == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._size] = (*value, *(len(NAMES) - len(value)) * (np.nan,))
        self._size += 1

    def _append(self, rows: np.ndarray) -> None:
        """Append rows (n,) with other columns, see `column`."""
        added = np.empty(len(rows), ROW)
        for name in NAMES:
            added[name] = column(rows, name)
        self._rows = np.concatenate([self._points, added, np.empty(CAPACITY, ROW)])
        self._size += len(rows)

    def _keep(self, mask: np.ndarray) -> None:
        kept = self._points[mask]
        self._rows[:len(kept)], self._size = kept, len(kept)

    def _register(self, value: dict[str, Any]) -> None:
        session, fit = self._session, value['fit']
        session['result'] = value['result']
        if fit is None:
            return
        session['pose_result'] = value['result']
        session['frames']['pose'] = value['pose_frame_id']
        session['verifications'] = value['verifications']
        if len(fit) != self._size:
            raise ValueError(f'a registration of {len(fit)} points, but there are {self._size}')
        for name in FIT:
            self._points[name] = fit[name]

    def _apply_tip(self, tip: list[float]) -> None:
        session, points = self._session, self._points
        session['parameters'] = {**session['parameters'], 'probe.tip': tip}
        tools = np.stack([points[name] for name in COLUMNS['tools']], axis=1)
        rows = np.flatnonzero(~np.isnan(tools[:, 0]))
        for name, values in zip(COLUMNS['positions'], tip_positions(tools[rows], tip).T):
            points[name][rows] = values
        session['air'] = [list(row) for row in air.with_tip(session['air'], tip)]
        session['landmarks'] = plain(landmark_capture.with_tip(
            [landmark_from(item) for item in session['landmarks']], tip))
        session['verifications'] = plain(verification.with_tip(
            [verification_from(item) for item in session['verifications']], tip))

    def _withdraw_pose(self) -> None:
        session = self._session
        if session['result'] == session['pose_result']:     # else the last attempt was refused
            session['result'] = None
        session['pose_result'], session['frames']['pose'] = None, ''
        for name in FIT:
            self._points[name] = np.nan

    def _set_model(self, model_sha256: str | None) -> None:
        session = self._session
        if session['model_sha256'] != model_sha256:
            self._withdraw_pose()
            session |= {'result': None, 'verifications': []}
            if session['model_sha256'] is not None:
                session['landmarks'] = []
        session['model_sha256'] = model_sha256
