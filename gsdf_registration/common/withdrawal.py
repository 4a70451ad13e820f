# SPDX-License-Identifier: Apache-2.0
"""The reasons for which there is no pose, or no longer one."""

from __future__ import annotations

from enum import Enum


class Withdrawal(str, Enum):
    """The reason of a withdrawal; a constant of the same name is in RegistrationResult.msg."""

    CLEARED = 'cleared'                     # the operator cleared the session
    ARRAY_DISPLACED = 'array_displaced'     # the reference array has moved on the bone
    MODEL_CHANGED = 'model_changed'         # another bone model was loaded
    CLOCK_JUMPED = 'clock_jumped'           # the clock of the points or of the node went back
    POINTS_DROPPED = 'points_dropped'       # without the dropped points there is no registration
    TIP_CHANGED = 'tip_changed'             # the tip of the probe was calibrated or set again
    SESSION_LOADED = 'session_loaded'       # a saved session without a pose was loaded
    DEACTIVATED = 'deactivated'             # the node was deactivated or is shutting down
    NOT_REGISTERED = 'not_registered'       # there has been no pose yet

    def __str__(self) -> str:
        """Return the lower-case name used in logs and status."""
        return self.value
