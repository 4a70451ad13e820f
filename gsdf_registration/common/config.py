# SPDX-License-Identifier: Apache-2.0
"""
Every setting, once: one dotted name here, in ``config/*.yaml``, ``--config`` and ROS parameters.

You need none of this to run the system; the defaults are meant to do.
"""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from gsdf_registration.common.result import InputError
from gsdf_registration.common.settings_schema import checked, declared, flattened


@dataclass(frozen=True)
class ModelConfig:
    """The bone."""

    path: str = declared('', 'mesh (STL, PLY, OBJ, OFF), .gsdf field or point cloud with normals; '
                         'a path or a package:// URI')
    unit: str = declared('mm', 'unit of the lengths in the model file', choices=('mm', 'm'))
    frame_id: str = declared('bone', 'name of the frame of the bone model', fixed=True)
    voxel_size: float = declared(0.001, 'spacing of the signed-distance samples near the surface',
                                 'm', 1e-4, 0.01)


@dataclass(frozen=True)
class ProbeConfig:
    """Where points come from."""

    topics: list[str] = declared(['/probe/tip'], 'PointStamped topics of the probe tip')
    frame_id: str = declared('', 'frame the points must be in, or that /tf leads to; empty: that '
                             'of the first point')


@dataclass(frozen=True)
class ReferenceConfig:
    """The array fixed to the bone, if it moves."""

    topic: str = declared(
        '',
        'PoseStamped topic of the reference array in the tracker frame; empty: none',
        fixed=True)
    frame_id: str = declared('reference_array', 'name of the frame of the array, in which the bone '
                             'is then registered', fixed=True)


@dataclass(frozen=True)
class CollectConfig:
    """When points are kept."""

    automatic: bool = declared(True, 'collect from activation on, without a call of ~/collect')
    max_points: int = declared(200_000, 'points kept at most; further ones are refused and counted',
                               '', 100, 10_000_000)


@dataclass(frozen=True)
class GateConfig:
    """Which points are believed."""

    max_speed: float = declared(1.0, 'a point that needs a faster tip is refused', 'm/s', 0.0,
                                100.0)
    max_gap: float = declared(0.5, 'a longer silence starts a new stroke', 's', 0.0, 3600.0)
    lift_ratio: float = declared(3.0, 'a tip so many times as fast as this hand mostly is has '
                                 'lifted off, which starts a new stroke, as does its landing; '
                                 '0: never', '', 0.0, 100.0)
    min_distance: float = declared(0.0, 'a point this near to the last one is a duplicate', 'm',
                                   0.0, 0.01)
    max_age: float = declared(0.5, 'a point older than this when it arrives is refused', 's', 0.0,
                              3600.0)
    quality: float = declared(0.001,
                              "a point whose tracker error exceeds this is refused; 0: don't look",
                              'm', 0.0, 0.1)


@dataclass(frozen=True)
class LiveConfig:
    """The pose that is kept up while points come in."""

    enabled: bool = declared(True, 'whether to keep a pose up while points come in')
    max_rate: float = declared(100.0, 'the live pose is found and published this often at most',
                               'Hz', 0.1, 1000.0)
    max_points: int = declared(2000, 'points it is found from at most; of more, so many spread '
                               'over all', '', 100, 1_000_000)
    status_rate: float = declared(2.0, 'status and markers follow it this often at most', 'Hz',
                                  0.1, 50.0)


@dataclass(frozen=True)
class LandmarksConfig:
    """Named model points that the operator touches for a first guess."""

    names: list[str] = declared([], 'landmarks in the order they are touched')
    positions: list[float] = declared([], 'their positions, x y z each, bone frame', 'm')
    dwell: float = declared(0.5, 'the tip must have rested this long', 's', 0.05, 10.0)
    radius: float = declared(0.002, 'a tip that stays within this radius rests', 'm', 1e-4, 0.02)


@dataclass(frozen=True)
class SearchConfig:
    """The global search for a first guess."""

    rotations: int = declared(200, 'attitudes tried', '', 1, 100_000)
    places: int = declared(100, 'places on the bone tried for each of them', '', 1, 10_000)
    parts: int = declared(7, 'places round which parts of the points are also tried alone', '', 0,
                          100)
    reach: float = declared(0.02, 'a start this far off is pulled in', 'm', 1e-3, 0.5)
    radius: float = declared(0.004, 'a point with few neighbours within this radius is stray', 'm',
                             1e-4, 0.1)
    spacing: float = declared(0.002,
                              'points nearer to one another than this count as one in the search',
                              'm', 1e-5, 0.1)
    solutions: int = declared(6, 'poses that fit best which are solved to the end', '', 1, 100)
    threads: int = declared(0, 'worker threads; 0: one a core', '', 0, 256)


@dataclass(frozen=True)
class SolverConfig:
    """The estimate of the pose from a first guess."""

    method: str = declared('mixture', 'how the pose is estimated: mixture, or the published method',
                           choices=('mixture', 'paper'))
    max_iterations: int = declared(200, 'Gauss-Newton steps at most', '', 1, 100_000)
    neighbours: int = declared(16,
                               'mixture: points whose mean residual tells bone from interference',
                               '', 2, 1000)
    reach: float = declared(0.006, 'mixture: interference is reckoned with this far from the bone',
                            'm', 1e-4, 0.1)
    model_error: float = declared(0.0006, 'mixture: how far the model may be off over a stretch',
                                  'm', 0.0, 0.01)
    tolerance: float = declared(1e-6, 'mixture: a shorter step is not taken any more', 'm', 1e-15,
                                1e-3)
    cauchy_scale: float = declared(0.001, 'c of the Cauchy weight 1/(1+(e/c)^2), equation 13', 'm',
                                   1e-5, 0.1)
    discard_below: float = declared(
        0.1, 'paper: a point of less weight is discarded (delta of Algorithm 1)', '', 0.0, 1.0)
    weight_tolerance: float = declared(
        1e-3, 'paper: IRLS ends when the weights move less, root mean square (epsilon of '
        'Algorithm 1)', '', 1e-12, 1.0)
    hold: int = declared(2, 'paper: the end must be met this many times in a row', '', 1, 100)


@dataclass(frozen=True)
class LimitsConfig:
    """When to refuse."""

    min_points: int = declared(30, 'fewer points are no registration', '', 6, 100_000)
    min_extent: float = declared(0.02, 'the points must span this much', 'm', 0.0, 1.0)
    min_inliers: float = declared(0.5, 'share of the points on strokes that must lie on the bone',
                                  '', 0.0, 1.0)
    max_pattern: float = declared(
        1.55, 'residuals that vary together along the strokes this many times more than noise '
        'does are not of this bone', '', 1.0, 1000.0)
    clear_inliers: float = declared(
        0.93, 'with this share of the points on the bone a pattern is put down to the model', '',
        0.0, 1.0)
    max_sigma: float = declared(0.002, 'more noise than this is not this bone or not this tracker',
                                'm', 1e-5, 0.1)
    min_gap: float = declared(
        24.0, 'natural logarithm of how much likelier the pose must be than any other; less is '
        'ambiguous', '', 0.0, 1e6)
    max_predicted_tre: float = declared(
        0.002, 'predicted TRE (RMS) allowed at the targets; without any, on the bone within 100 mm '
        'of what was touched', 'm', 1e-5, 1.0)
    max_bone_tre: float = declared(
        0.0013, 'predicted TRE (RMS) allowed over the whole bone, where no targets are named', 'm',
        1e-5, 1.0)
    verification: float = declared(0.002, 'distance at a verification point that still passes', 'm',
                                   1e-5, 0.1)


@dataclass(frozen=True)
class TargetsConfig:
    """Where on the bone the accuracy matters."""

    names: list[str] = declared([], 'targets at which TRE is predicted')
    positions: list[float] = declared([], 'their positions, x y z each, bone frame', 'm')


@dataclass(frozen=True)
class GuidanceConfig:
    """Where to touch next."""

    reach: float = declared(0.05, 'places on the bone this near to what was touched are proposed',
                            'm', 0.01, 1.0)
    near: list[str] = declared([], 'landmarks or targets near which places are proposed instead, '
                               'such as the middle of what the wound exposes')


@dataclass(frozen=True)
class TfConfig:
    """The transform on /tf."""

    rate: float = declared(10.0, 'the bone transform is re-sent this often; 0: never', 'Hz', 0.0,
                           1000.0)


@dataclass(frozen=True)
class SessionConfig:
    """The file of ~/save and ~/load."""

    path: str = declared('registration_session.json', 'session file')
    resume: bool = declared(False, 'take up at start what the journal beside session.path holds, '
                            'as after a crash', fixed=True)


@dataclass(frozen=True)
class Config:
    """All settings, a section each; SI units throughout."""

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
        Return the defaults changed by dotted names, as ROS parameters give them.

        Raises
        ------
        InputError
            At an unknown name, a wrong type, a value out of range, or positions that do not match
            their names.

        """
        return cls().replaced(values)

    @classmethod
    def from_nested(cls, values: Mapping[str, Any]) -> Config:
        """
        Return a config from nested mappings, also in the shape of a ROS parameter file.

        A node name (``registration:`` or ``/**:``) and ``ros__parameters:`` above the sections are
        stepped over, so one file serves the node and the command line.

        Raises
        ------
        InputError
            As `from_flat`.

        """
        while len(values) == 1:
            key, inner = next(iter(values.items()))
            if key != 'ros__parameters' and not (isinstance(inner, Mapping)
                                                 and 'ros__parameters' in inner):
                break
            values = inner
        return cls.from_flat(dict(flattened(values)))

    def replaced(self, values: Mapping[str, Any]) -> Config:
        """Return a copy with the dotted names in ``values`` changed; raises as `from_flat`."""
        known = dict(settings())
        changes: dict[str, dict[str, Any]] = {}
        for name, value in values.items():
            if name not in known:
                alike = difflib.get_close_matches(name, known, 1)
                raise InputError(f'unknown parameter "{name}"; '
                                 + (f'did you mean {alike[0]}? All' if alike else 'known ones')
                                 + ' are listed in config/registration.yaml')
            section, key = name.split('.')
            changes.setdefault(section, {})[key] = checked(name, value, known[name])
        config = dataclasses.replace(self, **{
            section: dataclasses.replace(getattr(self, section), **keys)
            for section, keys in changes.items()})
        for section in ('landmarks', 'targets'):
            points = getattr(config, section)
            if len(points.positions) != 3 * len(points.names):
                raise InputError(f'{section}.positions must hold x y z for each of {section}.names:'
                                 f' {3 * len(points.names)} numbers, not {len(points.positions)}')
            if len(set(points.names)) < len(points.names):
                raise InputError(f'{section}.names holds a name twice; name each by its own')
        for name in config.guidance.near:
            if name not in config.landmarks.names + config.targets.names:
                raise InputError(f'guidance.near names "{name}", which is neither a landmark nor a '
                                 'target; add it to landmarks.names or targets.names')
        return config

    @property
    def points_frame(self) -> str:
        """Frame in which a session holds its points; empty: that of the first one."""
        return self.reference.frame_id if self.reference.topic else self.probe.frame_id

    def flat(self) -> dict[str, Any]:
        """Return all settings by dotted name."""
        return {name: getattr(getattr(self, name.split('.')[0]), name.split('.')[1])
                for name, _ in settings()}


def settings() -> Iterator[tuple[str, dataclasses.Field[Any]]]:
    """Yield dotted name and field of every setting; metadata: description, unit, low, high..."""
    for section in dataclasses.fields(Config):
        for setting in dataclasses.fields(section.default_factory):  # type: ignore[arg-type]
            yield f'{section.name}.{setting.name}', setting
