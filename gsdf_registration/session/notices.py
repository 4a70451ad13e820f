# SPDX-License-Identifier: Apache-2.0
"""What the status reports of past events, and for how long."""

from __future__ import annotations

from gsdf_registration.session.state import SessionState

NOTICE_LIFETIME = 10    # a notice is shown until so many ``limits.min_points`` points are added


class Notices:
    """The notice of a session, and whether its last registration is still current."""

    def __init__(self, state: SessionState) -> None:
        self._state = state
        self._registered = False    # whether a registration, good or not, is the latest event
        self._text = ''
        self._warning = False
        self._points = 0            # number of points at the event

    def on_registration(self) -> None:
        """Make the registration that was just attempted or loaded the latest event."""
        self._registered, self._text = self._state.result is not None, ''
        self._points = len(self._state.collection)

    def on_stroke(self) -> None:
        """Make the start of a stroke the latest event."""
        self._registered = False

    def on_undo(self) -> None:
        """Keep the registration if the stroke that was dropped came after it."""
        self._registered = (self._registered and self._state.succeeded
                            and not self._state.outdated)

    def clear(self) -> None:
        """Drop everything, after a clear or for another bone."""
        self._registered, self._text = False, ''

    def set(self, text: str, warning: bool = False) -> None:
        """Show a notice; ``warning``: the operator should act on it."""
        self._text, self._warning = text, warning
        self._points = len(self._state.collection)

    @property
    def _progress(self) -> float:
        """Points added since the event, in ``limits.min_points``."""
        points = len(self._state.collection) - self._points
        return points / self._state.config.limits.min_points

    @property
    def registration_is_current(self) -> bool:
        """Whether the status shows the last registration; a refusal is shown for a while."""
        return self._registered and (self._state.succeeded or self._progress < 1.0)

    @property
    def text(self) -> str:
        """The notice; empty if there is none."""
        return self._text if self._progress < NOTICE_LIFETIME else ''

    @property
    def warning(self) -> bool:
        """Whether the notice is one that the operator should act on."""
        return self._warning and bool(self.text)
