# SPDX-License-Identifier: Apache-2.0
"""
All settings with their defaults, descriptions and ranges.

A setting has the same dotted name in ``config/*.yaml``, ``--config`` and the ROS parameters.
"""

from __future__ import annotations

import dataclasses
import difflib
import logging
import math
import operator
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from gsdf_registration.common.formatting import format_count
from gsdf_registration.common.parameter_file import (
    foreign_sentence,
    is_foreign,
    parameters_of_file,
)
from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import flatten, setting, shortened, validate

# The names of frames and files that are left empty; the node puts its own name before them.
NAMES = {'model.frame_id': 'bone', 'reference.frame_id': 'reference_array',
         'session.path': 'registration_session.json'}


# Settings that refer to places on one bone
PLACES = ('landmarks.names', 'landmarks.positions', 'landmarks.sigmas', 'targets.names',
          'targets.positions', 'guidance.near')

MAX_SIGMA = 0.1     # m, of a landmark: one that is less accurate says hardly anything
MIN_RATE = 0.01     # Hz; the period of a timer cannot be arbitrarily long
MAX_TIP = 2.0       # m; the longest tools measure half a metre


class UnmatchedPlaces(InputError):
    """
    Names of landmarks or targets do not match their positions, or ``guidance.near``.

    Attributes
    ----------
    parameters : dotted names of the settings that do not match
    waiting : sentence on what is missing, if they are set one after the other

    """

    def __init__(self, message: str, parameters: tuple[str, ...], waiting: str) -> None:
        super().__init__(message)
        self.parameters = parameters
        self.waiting = waiting


@dataclass(frozen=True)
class ModelConfig:
    """The model of the bone."""

    path: str = setting('', 'mesh (STL, PLY, OBJ, OFF, 3MF, GLB, VTK, VTP), point cloud with '
                        'normals, segmentation (NIfTI, NRRD, DICOM SEG) or field (.gsdf); a path '
                        'or a package:// URI')
    unit: str = setting('mm', 'unit of length of the model file', choices=('mm', 'm'))
    label: str = setting('', 'number or name of the bone in a segmentation; empty: the only one')
    body: str = setting('', 'which bone of a mesh of several bones: its number, largest or all; '
                        'empty: there is only one')
    frame_id: str = setting('', 'frame of the bone model; empty: bone, or femur_bone for the node '
                            '/femur/registration', fixed=True)
    voxel_size: float = setting(0.001, 'spacing of the signed-distance samples near the surface',
                                'm', 1e-4, 0.01)
    surface_error: float = setting(
        0.00025, 'expected standard deviation of the error of the surface: 0 for an exact model, '
        '0.00025 for CT, 0.0005 for MRI; the residuals correct it', 'm', 0.0, 0.005)


@dataclass(frozen=True)
class ProbeConfig:
    """The source of the points."""

    topics: list[str] = setting(
        ['/probe/tip'], 'topics of the probe: PointStamped positions of its tip, or poses of the '
        'tool as PoseStamped, PoseWithCovarianceStamped or TransformStamped')
    type: str = setting('auto', 'what the topics carry: positions of the tip (point) or poses of '
                        'the tool (pose); auto: as they are published',
                        choices=('auto', 'point', 'pose'))
    tip: list[float] = setting(
        [], 'position of the tip in the frame of the tool, x y z, for poses of the tool; empty: '
        'not known, set or calibrate it; 0 0 0: the pose is that of the tip', 'm', items=float)
    tip_radius: float = setting(0.0, 'radius of the ball at the end of the probe, if the positions '
                                'of the tip are those of its centre; 0: a sharp tip', 'm', 0.0,
                                0.01)
    tip_error: float = setting(0.0, 'expected error of the position of the tip, as from its '
                               'calibration, RMS distance; the same at every touch, so it adds to '
                               'the stated error of the pose', 'm', 0.0, 0.01)
    shaft: list[float] = setting(
        [], 'direction of the shaft in the frame of the tool, x y z, from the tip to the handle; '
        'empty: not known', items=float)
    frame_id: str = setting('', 'frame of the points, which /tf may provide; empty: frame of the '
                            'first point')


@dataclass(frozen=True)
class ReferenceConfig:
    """The reference array that is fixed to a moving bone."""

    topic: str = setting(
        '',
        'topic of the poses of the reference array in the tracker frame, as PoseStamped, '
        'PoseWithCovarianceStamped or TransformStamped; empty: none',
        fixed=True)
    frame_id: str = setting('', 'frame of the reference array, in which the bone is then '
                            'registered; empty: reference_array, or femur_reference_array for the '
                            'node /femur/registration', fixed=True)


@dataclass(frozen=True)
class CollectConfig:
    """The collection of points."""

    automatic: bool = setting(True, 'start to collect on activation, without a call of ~/collect')
    mode: str = setting('both', 'what counts: strokes of the moving tip, touches (places where it '
                        'rests), or both', choices=('strokes', 'touches', 'both'))
    max_points: int = setting(200_000, 'maximum number of collected points; further points are '
                              'rejected', '', 100, 10_000_000)
    air: bool = setting(True, 'also use where the probe was in the air, as no bone is there; set '
                        'it to false if bone of the model has been removed')


@dataclass(frozen=True)
class GateConfig:
    """The tests that a point must pass."""

    max_speed: float = setting(1.0, 'reject a point that requires a faster tip', 'm/s', 0.0, 100.0)
    max_gap: float = setting(0.5, 'start a new stroke after a longer pause', 's', 0.0, 3600.0)
    lift_ratio: float = setting(3.0, 'start a new stroke when the tip moves this many times faster '
                                'than its typical speed, which means a lift-off, and when it lands '
                                'again; 0: never', '', 0.0, 100.0)
    min_distance: float = setting(0.0, 'reject a point that is no farther from the previous one',
                                  'm', 0.0, 0.01)
    max_age: float = setting(0.5, 'reject a point that is older on arrival', 's', 0.0, 3600.0)
    quality: float = setting(0.001, 'reject a point with a larger error reported by the tracker; '
                             '0: accept all', 'm', 0.0, 0.1)


@dataclass(frozen=True)
class LiveConfig:
    """The live pose, which is updated while points are collected."""

    enabled: bool = setting(True, 'compute a pose while points are collected')
    max_points: int = setting(2000, 'maximum number of points used for the live pose, sampled '
                              'evenly from all points', '', 100, 1_000_000)


@dataclass(frozen=True)
class LandmarksConfig:
    """Named points of the model that are touched: for an initial guess, or as measurements."""

    names: list[str] = setting([], 'landmarks in the order in which they are touched')
    positions: list[float] = setting([], 'positions of the landmarks, x y z each, bone frame', 'm',
                                    items=float)
    sigmas: list[float] = setting(
        [], 'standard deviation of each landmark along each axis, if it is also a measurement of '
        'the pose; 0: only for an initial guess; empty: all 0', 'm', items=float)
    dwell: float = setting(0.5, 'time for which the tip must be stationary at a landmark', 's',
                           0.05, 10.0)
    radius: float = setting(0.002, 'a tip that stays within this radius is stationary', 'm', 1e-4,
                            0.02)
    joint_centre: str = setting('hip_centre', 'landmark that ~/find_joint_centre finds; it is not '
                                'touched')

    def sigma_of(self, name: str) -> float:
        """Return the standard deviation of a landmark along each axis, m; 0: none is set."""
        return self.sigmas[self.names.index(name)] if self.sigmas else 0.0


@dataclass(frozen=True)
class SearchConfig:
    """The global search for an initial guess; at the upper limits it takes about half a minute."""

    rotations: int = setting(200, 'number of rotations to try', '', 1, 1000)
    places: int = setting(100, 'number of places on the bone to try for each rotation', '', 1,
                          300)
    parts: int = setting(7, 'number of places around which subsets of the points are also tried '
                         'alone', '', 0, 20)
    threads: int = setting(0, 'number of threads; 0: one per core', '', 0, 256)


@dataclass(frozen=True)
class SolverConfig:
    """The estimate of the pose from an initial guess."""

    method: str = setting('mixture', 'estimator of the pose: mixture, or the published method',
                          choices=('mixture', 'paper'))
    max_iterations: int = setting(200, 'maximum number of Gauss-Newton steps', '', 1, 100_000)
    cauchy_scale: float = setting(0.001, 'c of the Cauchy weight 1/(1+(e/c)^2), equation 13', 'm',
                                  1e-5, 0.1)


@dataclass(frozen=True)
class LimitsConfig:
    """The acceptance criteria of a registration."""

    min_points: int = setting(30, 'minimum number of points', '', 6, 100_000)
    min_extent: float = setting(0.02, 'minimum extent of the points', 'm', 0.0, 1.0)
    min_inliers: float = setting(0.5, 'minimum share of the points on strokes that lie on the bone',
                                 '', 0.0, 1.0)
    max_pattern: float = setting(
        1.55, 'maximum ratio of the correlation of residuals along the strokes to that of '
        'independent noise, if no local error of the model explains it', '', 1.0, 1000.0)
    max_model_error: float = setting(
        2.2, 'maximum ratio of the local error of the model, as the residuals show it, to '
        'model.surface_error; a larger one is the difference to another bone', '', 1.0, 1000.0)
    max_sigma: float = setting(0.002, 'maximum standard deviation of the noise along the surface '
                               'normal', 'm', 1e-5, 0.1)
    min_gap: float = setting(
        24.0, 'minimum difference in log-likelihood between the pose and any alternative pose', '',
        0.0, 1e6)
    max_error: float = setting(
        0.002, 'a place on the bone is in the zone if its error is smaller with a probability of '
        '95 %', 'm', 1e-5, 1.0)
    require: str = setting(
        '', 'what must be in the zone: touched (the bone within 100 mm of the touched points), '
        'targets or bone; empty: targets if there are any, else touched',
        choices=('', 'touched', 'targets', 'bone'))
    verification: float = setting(0.002, 'maximum distance of a verification point from the bone',
                                  'm', 1e-5, 0.1)


@dataclass(frozen=True)
class TargetsConfig:
    """The points on the bone where the accuracy matters."""

    names: list[str] = setting([], 'targets at which the TRE is predicted')
    positions: list[float] = setting([], 'positions of the targets, x y z each, bone frame', 'm',
                                    items=float)


@dataclass(frozen=True)
class GuidanceConfig:
    """The proposal of the next places to touch."""

    reach: float = setting(0.05, 'maximum distance of a proposed place from the touched points',
                           'm', 0.01, 1.0)
    near: list[str] = setting([], 'landmarks or targets near which places are proposed instead, '
                              'such as one in the middle of the exposed area')


@dataclass(frozen=True)
class TfConfig:
    """The transform on /tf."""

    rate: float = setting(10.0, 'rate at which the bone transform is sent; 0: never', 'Hz', 0.0,
                          1000.0)


@dataclass(frozen=True)
class SessionConfig:
    """The session file of ~/save and ~/load."""

    path: str = setting('', 'session file; empty: registration_session.json, or '
                        'femur_registration_session.json for the node /femur/registration')
    resume: bool = setting(False, 'restore at start the session from the journal beside '
                           'session.path, as after a crash', fixed=True)


@dataclass(frozen=True)
class Config:
    """All settings in SI units, one section per field."""

    model: ModelConfig = field(default_factory=ModelConfig)
    probe: ProbeConfig = field(default_factory=ProbeConfig)
    reference: ReferenceConfig = field(default_factory=ReferenceConfig)
    collect: CollectConfig = field(default_factory=CollectConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    live: LiveConfig = field(default_factory=LiveConfig)
    landmarks: LandmarksConfig = field(default_factory=LandmarksConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    solver: SolverConfig = field(default_factory=SolverConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)
    targets: TargetsConfig = field(default_factory=TargetsConfig)
    guidance: GuidanceConfig = field(default_factory=GuidanceConfig)
    tf: TfConfig = field(default_factory=TfConfig)
    session: SessionConfig = field(default_factory=SessionConfig)

    @classmethod
    def from_flat(cls, values: Mapping[str, Any]) -> Config:
        """
        Return the defaults with the values of dotted names, such as ROS parameters.

        Raises
        ------
        InputError
            If a name is unknown, a value has the wrong type or is out of range, or the positions do
            not match their names.

        """
        return cls().replaced(values)

    @classmethod
    def from_nested(cls, values: Mapping[str, Any]) -> Config:
        """
        Return the defaults with the values of nested mappings, such as a ROS parameter file.

        The node and the command line can read the same file: the sections of other nodes, and
        parameters that are no setting, are ignored.

        Raises
        ------
        InputError
            As `from_flat` and `parameters_of_file`.

        """
        return cls().merged(values)

    def merged(self, values: Mapping[str, Any]) -> Config:
        """Return a copy with the settings of nested mappings, see `from_nested`."""
        known = dict(settings())
        given = parameters_of_file(values, known)
        if given is None:
            return self.replaced(dict(flatten(values)))
        foreign = {name for name in given if is_foreign(name, known)}
        if foreign:
            logging.getLogger(__name__).warning(foreign_sentence(foreign))
        return self.replaced({name: value for name, value in given.items() if name not in foreign})

    def replaced(self, values: Mapping[str, Any]) -> Config:
        """Return a copy with the dotted names in ``values`` changed; raises as `from_flat`."""
        known = dict(settings())
        changes: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            if name not in known:
                similar = difflib.get_close_matches(name[:100], known, 1)
                hint = f'did you mean {similar[0]}? ' if similar else ''
                raise InputError(f'unknown parameter "{shortened(name)}"; {hint}'
                                 'config/registration.yaml lists all parameters')
            section, key = name.split('.')
            changes.setdefault(section, {})[key] = validate(name, value, known[name])
        config = dataclasses.replace(self, **{
            section: dataclasses.replace(getattr(self, section), **keys)
            for section, keys in changes.items()})
        config._check()
        return config

    def _check(self) -> None:
        """Check what involves several settings, or cannot be described as a range."""
        if 0.0 < self.tf.rate < MIN_RATE:
            raise InputError(f'tf.rate must be 0 or at least {MIN_RATE:g} Hz, not '
                             f'{self.tf.rate:g}')
        self._check_probe()
        for section in ('landmarks', 'targets'):
            points = getattr(self, section)
            names, positions = f'{section}.names', f'{section}.positions'
            if len(points.positions) != 3 * len(points.names):
                raise UnmatchedPlaces(
                    f'{positions} must have x, y, z for each of {names}: '
                    f'{3 * len(points.names)} numbers, not {len(points.positions)}',
                    (names, positions),
                    f'{names} has {format_count(len(points.names), "entry", "entries")}, '
                    f'{positions} has {format_count(len(points.positions), "number")}; waiting for '
                    'the other')
            if len(set(points.names)) < len(points.names):
                raise InputError(f'{names} has a duplicate name; use unique names')
        self._check_sigmas()
        if self.limits.require == 'targets' and not self.targets.names:
            missing = 'limits.require is "targets", but there are none'
            raise UnmatchedPlaces(f'{missing}; set targets.names and targets.positions',
                                  ('limits.require', 'targets.names', 'targets.positions'),
                                  f'{missing}; waiting for targets.names')
        for name in self.guidance.near:
            if name not in self.landmarks.names + self.targets.names:
                unknown = (f'guidance.near contains "{shortened(name)}", which is neither a '
                           'landmark nor a target')
                raise UnmatchedPlaces(
                    f'{unknown}; add it to landmarks.names or targets.names',
                    ('guidance.near', 'landmarks.names', 'targets.names'),
                    f'{unknown}; waiting for landmarks.names or targets.names')

    def _check_sigmas(self) -> None:
        """Check the standard deviations of the landmarks."""
        names, sigmas = self.landmarks.names, self.landmarks.sigmas
        if sigmas and len(sigmas) != len(names):
            counts = (f'landmarks.names has {format_count(len(names), "entry", "entries")}, '
                      f'landmarks.sigmas has {format_count(len(sigmas), "number")}')
            raise UnmatchedPlaces(
                f'landmarks.sigmas must be empty or have a number for each of landmarks.names: '
                f'{len(names)} numbers, not {len(sigmas)}',
                ('landmarks.names', 'landmarks.sigmas'), f'{counts}; waiting for the other')
        if not all(0.0 <= sigma <= MAX_SIGMA for sigma in sigmas):
            raise InputError(f'landmarks.sigmas must be from 0 (only for an initial guess) to '
                             f'{MAX_SIGMA:g} m, not {sigmas}; they are in metres')

    def _check_probe(self) -> None:
        """Check the vectors in the frame of the tool."""
        for name, vector in (('tip', self.probe.tip), ('shaft', self.probe.shaft)):
            if len(vector) not in (0, 3):
                raise InputError(f'probe.{name} must have three numbers, x y z in the frame of the '
                                 f'tool, or none if it is not known; not {len(vector)}')
        if any(abs(value) > MAX_TIP for value in self.probe.tip):
            raise InputError(f'probe.tip must lie within {MAX_TIP:g} m of the origin of the tool, '
                             f'not at {self.probe.tip}; it is in metres')
        if self.probe.shaft and not any(self.probe.shaft):
            raise InputError('probe.shaft must have a direction, not 0 0 0')
        # the origin of the tool is on the side of the handle, if it is not the tip
        along = -sum(a * b for a, b in zip(self.probe.shaft, self.probe.tip))
        if along < -0.5 * math.hypot(*self.probe.shaft) * math.hypot(*self.probe.tip):
            raise InputError(f'probe.shaft {self.probe.shaft} points from the handle to the tip '
                             f'{self.probe.tip}; turn it, so that it points to the handle')

    def named(self, prefix: str = '') -> Config:
        """Return a copy with ``prefix`` and a default for each of `NAMES` that is empty."""
        flat = self.flat()
        return self.replaced({name: prefix + default for name, default in NAMES.items()
                              if not flat[name]})

    @property
    def bone_frame(self) -> str:
        """The frame of the bone model."""
        return self.model.frame_id or NAMES['model.frame_id']

    @property
    def points_frame(self) -> str:
        """The frame in which a session stores points; empty: the frame of the first point."""
        if not self.reference.topic:
            return self.probe.frame_id
        return self.reference.frame_id or NAMES['reference.frame_id']

    def flat(self) -> dict[str, Any]:
        """Return all settings by dotted name."""
        return {name: operator.attrgetter(name)(self) for name, _ in settings()}


def settings() -> Iterator[tuple[str, dataclasses.Field[Any]]]:
    """Yield the dotted name and the field of every setting; see `settings_schema.setting`."""
    for section in dataclasses.fields(Config):
        for declared in dataclasses.fields(section.default_factory):  # type: ignore[arg-type]
            yield f'{section.name}.{declared.name}', declared


def valid_value(name: str, value: Any) -> Any:
    """Return a value converted to the type of its setting; raise `InputError` if it cannot be."""
    return validate(name, value, dict(settings())[name])
