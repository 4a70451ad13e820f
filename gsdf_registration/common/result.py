# SPDX-License-Identifier: Apache-2.0
"""What a registration says: the pose, how good it is, or why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common.rigid import Array, inverse

ON_BONE = 0.5       # a point of more weight lies on the bone


class Reason(str, Enum):
    """Why a registration ended; everything but `CONVERGED` is a refusal."""

    CONVERGED = 'converged'
    TOO_FEW_POINTS = 'too_few_points'
    REGION_TOO_SMALL = 'region_too_small'
    UNDER_CONSTRAINED = 'under_constrained'
    AMBIGUOUS = 'ambiguous'
    TOO_FEW_INLIERS = 'too_few_inliers'
    MODEL_MISMATCH = 'model_mismatch'
    NOT_CONVERGED = 'not_converged'
    WRONG_UNIT = 'wrong_unit'
    BAD_INPUT = 'bad_input'
    NO_MODEL = 'no_model'

    def __str__(self) -> str:
        """Return the lower-case word used in JSON, logs and status."""
        return self.value


@dataclass(frozen=True)
class Touch:
    """
    A patch of bone worth touching, because it would hold the pose, or tell it from another.

    position, normal : (3,) float, m, bone frame
    predicted_tre : float, m, RMS at the targets once a short stroke was drawn over it; None: it
        tells which of several poses is right
    present_tre : float, m, RMS at the targets now
    """

    position: Array
    normal: Array
    predicted_tre: float | None = None
    present_tre: float | None = None

    @property
    def promise(self) -> str:
        """What touching there gains, in words."""
        if self.predicted_tre is None or self.present_tre is None:
            return 'it decides which of the poses is right'
        return (f'the expected error falls from {1e3 * self.present_tre:.1f} to '
                f'{1e3 * self.predicted_tre:.1f} mm')

    @property
    def label(self) -> str:
        """The same in a word, to stand beside the place."""
        return 'decides' if self.predicted_tre is None else f'{1e3 * self.predicted_tre:.1f} mm'


class Refusal(Exception):
    """
    A plain sentence instead of an answer: what is wrong, where, and what to do.

    Raised at the door of every function that cannot give a true answer; the node and the command
    line turn it into their own form of "no".

    ``touch``: where a touch would help, as in "touch the bone near X"; empty if none would.
    ``touches``: that place and others on the bone, best first.
    """

    def __init__(self, reason: Reason, message: str, touch: str = '',
                 touches: Sequence[Touch] = ()) -> None:
        super().__init__(message)
        self.reason = reason
        self.message = message
        self.touch = touch
        self.touches = tuple(touches)


class InputError(Refusal):
    """Something given cannot be read or used as it is; reason `bad_input` unless said otherwise."""

    def __init__(self, message: str, reason: Reason = Reason.BAD_INPUT) -> None:
        super().__init__(reason, message)


class Cancelled(Refusal):
    """The work was ended by who asked for it."""

    def __init__(self) -> None:
        super().__init__(Reason.NOT_CONVERGED,
                         'the registration was cancelled; the points are kept')


def as_numbers(values: ArrayLike, what: str) -> Array:
    """Return ``values`` as a float64 array, or raise an InputError that names ``what`` they are."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f'{what} must be an array of numbers: {error}') from None


@dataclass(frozen=True)
class Iteration:
    """One Gauss-Newton step of the history: cost (m^2), step (rad, m) and points in use."""

    cost: float
    rotation_step: float
    translation_step: float
    inliers: int


@dataclass(frozen=True)
class WeakestDirection:
    """The rigid motion the data hold least: a screw axis in the bone frame, in words too."""

    axis: Array                 # (3,) unit
    point: Array                # (3,) m, on the axis
    pitch_m_per_rad: float      # translation along the axis per radian; inf: pure translation
    rotation_sigma_rad: float   # standard deviation of the motion
    translation_sigma_m: float
    sentence: str


@dataclass(frozen=True)
class RegistrationResult:
    """
    The outcome of `register`.

    ``T_tracker_bone`` is None unless `success`.  Lengths in metres, angles in radians; covariance
    in REP-103 order (x y z rx ry rz) of the bone's pose, fixed axes of the tracker frame, rotation
    about the bone's origin.
    """

    reason: Reason
    message: str
    T_tracker_bone: Array | None = None         # (4, 4)
    covariance: Array | None = None             # (6, 6)
    received: int = 0                           # points given
    used: int = 0                               # points given to the solver
    inliers: int = 0                            # points that bear the pose
    # estimated noise of a point along the surface normal
    sigma_m: float | None = None
    # of the inliers; not the accuracy (Fitzpatrick 2009)
    residual_rms_m: float | None = None
    predicted_tre_m: dict[str, float] = field(default_factory=dict)     # targets, rms, max
    weakest_direction: WeakestDirection | None = None
    runner_up_ratio: float | None = None        # cost of the next-best basin over ours
    iterations: int = 0
    timing_s: dict[str, float] = field(default_factory=dict)
    residuals_m: Array | None = None            # (used,) signed distances at the pose
    weights: Array | None = None                # (used,) in [0, 1]
    history: tuple[Iteration, ...] = ()

    @property
    def success(self) -> bool:
        """Whether there is a pose to be used."""
        return self.reason is Reason.CONVERGED

    @property
    def T_bone_tracker(self) -> Array | None:
        """The inverse of `T_tracker_bone`, what the solver estimates."""
        return None if self.T_tracker_bone is None else inverse(self.T_tracker_bone)

    @classmethod
    def refused(cls, reason: Reason, message: str, **known: Any) -> RegistrationResult:
        """Return a refusal; ``known`` is whatever else is true of it, never a pose."""
        assert reason is not Reason.CONVERGED and 'T_tracker_bone' not in known
        return cls(reason=reason, message=message, **known)
