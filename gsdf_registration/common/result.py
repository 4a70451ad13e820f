# SPDX-License-Identifier: Apache-2.0
"""The result of a registration: the pose with its accuracy, or the reason why there is none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import ArrayLike

from gsdf_registration.common.formatting import format_error, format_length
from gsdf_registration.common.rigid import Array, inverse

INLIER_WEIGHT = 0.5       # a point with a larger weight is an inlier: it lies on the bone


class Reason(str, Enum):
    """The outcome of a registration; every value but `CONVERGED` is a refusal."""

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
        """Return the lower-case name used in JSON, logs and status."""
        return self.value


@dataclass(frozen=True)
class NextTouch:
    """
    A place on the bone to touch next.

    position, normal : (3,) float, m, bone frame
    predicted_tre : float, m, RMS at the targets after a short stroke at this place; None if the
        place distinguishes between ambiguous poses instead
    current_tre : float, m, RMS at the targets now
    """

    position: Array
    normal: Array
    predicted_tre: float | None = None
    current_tre: float | None = None

    @property
    def expected_gain(self) -> str:
        """The gain of a touch at this place, as part of a sentence."""
        if self.predicted_tre is None or self.current_tre is None:
            return 'it shows which of the poses is right'
        return (f'the expected error falls from {format_error(self.current_tre)} to '
                f'{format_error(self.predicted_tre)}')

    @property
    def label(self) -> str:
        """The gain in one or two words, for a label at the place."""
        return 'disambiguates' if self.predicted_tre is None else format_error(self.predicted_tre)


class Refusal(Exception):
    """
    A function cannot give a valid result; the message says what is wrong and what to do.

    The node reports it in the response of a service, the command line as an error.

    Parameters
    ----------
    reason : Reason
    message : str, one sentence
    advice : str, where a touch would help, as in "touch the bone near X"; empty if none would
    next_touches : of NextTouch, places on the bone where a touch would help, best first

    """

    def __init__(self, reason: Reason, message: str, advice: str = '',
                 next_touches: Sequence[NextTouch] = ()) -> None:
        super().__init__(message)
        self.reason = reason
        self.message = message
        self.advice = advice
        self.next_touches = tuple(next_touches)


class InputError(Refusal):
    """An input cannot be read or is not valid; the reason is `bad_input` by default."""

    def __init__(self, message: str, reason: Reason = Reason.BAD_INPUT) -> None:
        super().__init__(reason, message)


class Cancelled(Refusal):
    """The caller cancelled the registration."""

    def __init__(self) -> None:
        super().__init__(Reason.NOT_CONVERGED,
                         'the registration was cancelled; the points are kept')


def as_numbers(values: ArrayLike, what: str) -> Array:
    """Return ``values`` as a float64 array, or raise an InputError that names them ``what``."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f'{what} must be an array of numbers: {error}') from None


@dataclass(frozen=True)
class Iteration:
    """One Gauss-Newton step: cost (m^2), step (rad, m) and number of inliers."""

    cost: float
    rotation_step: float
    translation_step: float
    inliers: int


@dataclass(frozen=True)
class LandmarkFit:
    """
    How a landmark with a standard deviation fits.

    name : str
    used : whether it was used; if not, it is a mistake
    sigma_m : float, m, its standard deviation along each axis
    residual_m : float, m, distance from its place on the bone at the pose
    deviations : float, its distance from where it was expected without it, in standard deviations:
        of the landmark and of the pose
    """

    name: str
    used: bool
    sigma_m: float
    residual_m: float
    deviations: float

    @property
    def sentence(self) -> str:
        """The distance, and whether the landmark was used."""
        apart = (f'{format_length(self.residual_m)} from its place, {self.deviations:.1f} standard '
                 'deviations from where it is expected without it')
        return apart if self.used else f'{apart}: not used'


@dataclass(frozen=True)
class WeakestDirection:
    """The rigid motion that the points constrain least, as a screw in the bone frame."""

    axis: Array                 # (3,) unit
    point: Array                # (3,) m, on the axis
    pitch_m_per_rad: float      # translation along the axis per radian; inf: pure translation
    rotation_sigma_rad: float   # standard deviation of the rotation and of the translation
    translation_sigma_m: float
    sentence: str


@dataclass(frozen=True)
class Zone:
    """
    The part of the bone where the error is within a limit with a probability of 95 %.

    limit_m : float, m, `limits.max_error`
    distance_m : float, m: every place on the bone this near to the touched points is in the zone
    bone_share : float, share of the surface of the bone in the zone
    p95_m : dict of str to float, m: the error at each target is smaller with 95 % probability
    touched_p95_m, bone_p95_m : float, m, the largest within 100 mm of the touched points, and on
        the whole bone
    """

    limit_m: float
    distance_m: float
    bone_share: float
    p95_m: dict[str, float]
    touched_p95_m: float
    bone_p95_m: float

    @property
    def sentence(self) -> str:
        """Where the pose is accurate, as part of a sentence."""
        accurate = f'accurate to {format_error(self.limit_m)} (95 %)'
        if self.bone_share == 1.0:
            return f'{accurate} on the whole bone'
        return (f'{accurate} within {1e3 * self.distance_m:.0f} mm of the touched area, on '
                f'{math.floor(100.0 * self.bone_share)} % of the bone')


@dataclass(frozen=True)
class ConsideredPoses:
    """
    What led to the outcome, for pictures only: a pose that was refused must not be used.

    T_tracker_bone : (4, 4) float, m, the best pose found
    covariance : (6, 6) float, as in `RegistrationResult`; None if the points do not constrain it
    rivals : of (4, 4) float, T_tracker_bone, poses that fit the points about equally well
    next_touches : of NextTouch, places where a touch would help, best first
    """

    T_tracker_bone: Array
    covariance: Array | None = None
    rivals: tuple[Array, ...] = ()
    next_touches: tuple[NextTouch, ...] = ()


@dataclass(frozen=True)
class RegistrationResult:
    """
    The outcome of `register`.

    ``T_tracker_bone`` is None unless `success`. Lengths are in metres, angles in radians. The
    covariance describes the pose of the bone, in the order x y z rx ry rz (REP-103), about the
    fixed axes of the tracker frame and the origin of the bone.
    """

    reason: Reason
    message: str
    T_tracker_bone: Array | None = None         # (4, 4)
    covariance: Array | None = None             # (6, 6)
    received: int = 0                           # points passed in
    used: int = 0                               # points passed to the solver
    inliers: int = 0                            # points on the bone
    # points passed in but not used, by cause: isolated, repeated, resting (samples of a rest, of
    # which one counts), moving (between touches), downsampled
    left_out: dict[str, int] = field(default_factory=dict)
    # samples received before it that the session did not keep, by cause. Every sample is counted
    # once: received = used + all that are left out + all that are rejected
    rejected: dict[str, int] = field(default_factory=dict)
    # estimated noise of a point along the surface normal
    sigma_m: float | None = None
    # of the inliers; this is not the accuracy (Fitzpatrick 2009)
    residual_rms_m: float | None = None
    predicted_tre_m: dict[str, float] = field(default_factory=dict)     # targets, rms, max
    weakest_direction: WeakestDirection | None = None
    landmarks: tuple[LandmarkFit, ...] = ()     # those with a standard deviation
    zone: Zone | None = None
    # cost of the best alternative pose divided by the cost of this pose
    runner_up_ratio: float | None = None
    iterations: int = 0
    timing_s: dict[str, float] = field(default_factory=dict)
    residuals_m: Array | None = None            # (used,) signed distances at the pose
    weights: Array | None = None                # (used,) in [0, 1]
    history: tuple[Iteration, ...] = ()
    considered: ConsideredPoses | None = None   # None if it stopped before it found a pose

    @property
    def success(self) -> bool:
        """Whether the registration converged to an accepted pose."""
        return self.reason is Reason.CONVERGED

    @property
    def grade(self) -> str | None:
        """
        The grade of an accepted pose; None for a refusal.

        A: the zone is the whole bone. B: the zone contains the part that ``limits.require`` names.
        """
        if not self.success or self.zone is None:
            return None
        return 'A' if self.zone.bone_share == 1.0 else 'B'

    @property
    def T_bone_tracker(self) -> Array | None:
        """The inverse of `T_tracker_bone`."""
        return None if self.T_tracker_bone is None else inverse(self.T_tracker_bone)

    @classmethod
    def refused(cls, reason: Reason, message: str, received: int = 0) -> RegistrationResult:
        """Return the result of a registration that stopped before it found a candidate pose."""
        assert reason is not Reason.CONVERGED
        return cls(reason, message, received=received,
                   left_out={'not_used': received} if received else {})
