# SPDX-License-Identifier: Apache-2.0
"""What is news to the operator, and until when: how a registration ended, what became of a node."""

from __future__ import annotations

from gsdf_registration.session.state import SessionState

REMARKED = 10       # times ``limits.min_points`` points later a remark is no news any more


class News:
    """What has happened last to a session; not thread-safe."""

    def __init__(self, holds: SessionState) -> None:
        self._holds = holds
        self._registered = False    # whether a registration, good or not, is the latest thing
        self._remark = ''
        self._held = 0              # points held then

    def registration(self) -> None:
        """Take note that one has been asked for, or taken up from a file."""
        self._registered, self._remark = self._holds.result is not None, ''
        self._held = len(self._holds.collection)

    def stroke(self) -> None:
        """Take note that a stroke is begun."""
        self._registered = False

    def undo(self) -> None:
        """Take note that a stroke was dropped; it may have come after the pose."""
        self._registered = (self._registered and self._holds.succeeded
                            and not self._holds.outdated)

    def end(self) -> None:
        """Know of nothing: all has been cleared, or the bone is another."""
        self._registered, self._remark = False, ''

    def remark(self, text: str) -> None:
        """Have this said, too."""
        self._remark, self._held = text, len(self._holds.collection)

    @property
    def _gone_on(self) -> float:
        """How far the operator has gone on since, in ``limits.min_points``."""
        points = len(self._holds.collection) - self._held
        return points / self._holds.config.limits.min_points

    @property
    def is_registration(self) -> bool:
        """Whether it is what the last registration came to; a refusal is soon no news any more."""
        return self._registered and (self._holds.succeeded or self._gone_on < 1.0)

    @property
    def remarked(self) -> str:
        """What is to be said of the past."""
        return self._remark if self._gone_on < REMARKED else ''
