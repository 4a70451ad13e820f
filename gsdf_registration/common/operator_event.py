# SPDX-License-Identifier: Apache-2.0
"""
What an operator did: a request, its answer, and which samples the node had received before it.

The node publishes these events, so that a recording of its topics can be replayed.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

TOPIC = 'events'        # of the node, after its name
LAST = 'last.'          # key of the last sample of a topic: its number and stamp
UNKNOWN = -1            # number of points that is not recorded
BUSY = 'another request is running; wait for its answer'    # answer to a request refused at once


@dataclass(frozen=True)
class OperatorEvent:
    """
    One request, or a change of the node's state.

    number : int, from 1, in the order in which the requests took effect
    name : str, of the service; or 'configure', 'activate', 'deactivate', 'parameters',
        'initial_pose' or 'model'
    stamp : float, s, clock of the node, when the request came
    success, message : the answer
    request : dict, its values, as for JSON
    performed : bool, whether the session carried it out: a request that was refused at once, or
        was cancelled, has changed nothing
    follow_up : str, after a stroke was dropped that the pose used: 'registered', 'refused' (and the
        pose withdrawn) or 'withdrawn' (without a registration); 'unknown': not recorded; else empty
    kept : int, number of points in the session when the request came; or `UNKNOWN`
    last : dict, number and stamp (s) of the last message received on each topic of the tracker
        when the request came; the number counts from the start of the node
    """

    number: int
    name: str
    stamp: float
    success: bool = True
    message: str = ''
    request: dict[str, Any] = field(default_factory=dict)
    performed: bool = True
    follow_up: str = ''
    kept: int = 0
    last: dict[str, tuple[int, float]] = field(default_factory=dict)

    @property
    def begins_session(self) -> bool:
        """Whether everything that was collected before is dropped."""
        return self.name in ('clear', 'configure') and self.performed and self.success

    def values(self) -> dict[str, str]:
        """Return keys and values of a message, see `from_values`; the message is not among them."""
        return {
            'event': self.name, 'number': str(self.number), 'stamp': repr(self.stamp),
            'success': json.dumps(self.success), 'performed': json.dumps(self.performed),
            'follow_up': self.follow_up, 'request': json.dumps(self.request),
            'kept': str(self.kept),
            **{f'{LAST}{topic}': f'{number} {stamp!r}'
               for topic, (number, stamp) in self.last.items()}}

    @classmethod
    def from_values(cls, values: Mapping[str, str], message: str) -> OperatorEvent:
        """
        Return the event of a message.

        Raises
        ------
        KeyError, ValueError
            If a value is missing or not valid.

        """
        last = {}
        for key, value in values.items():
            if key.startswith(LAST):
                number, stamp = value.split()
                last[key[len(LAST):]] = int(number), float(stamp)
        request = json.loads(values['request'])
        if not isinstance(request, dict):
            raise ValueError('the request is no object')
        return cls(int(values['number']), values['event'], float(values['stamp']),
                   json.loads(values['success']), message, request,
                   json.loads(values['performed']), values['follow_up'], int(values['kept']), last)
