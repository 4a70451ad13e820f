# SPDX-License-Identifier: Apache-2.0
"""A result as JSON, schema "gsdf-registration/2": every key, null for unknown values; SI units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gsdf_registration import __version__
from gsdf_registration.common.config import Config
from gsdf_registration.common.json_values import plain
from gsdf_registration.common.result import RegistrationResult, WeakestDirection
from gsdf_registration.common.rigid import quaternion_from_rotation

SCHEMA = 'gsdf-registration/2'


def result_to_json(result: RegistrationResult, config: Config, *, frame_id: str = '',
                   model_sha256: str | None = None, points_sha256: str | None = None,
                   recording: Mapping[str, Any] | None = None, load_s: float | None = None,
                   total_s: float | None = None) -> dict[str, Any]:
    """
    Return the JSON document of one registration.

    Parameters
    ----------
    result : RegistrationResult
    config : Config
        The settings of the registration.
    frame_id : str
        Frame of the points and of the pose; empty: not known.
    model_sha256, points_sha256 : str, optional
        Hashes of the inputs.
    recording : mapping, optional
        ``complete`` and ``notes`` of a recording; None for other files.
    load_s, total_s : float, optional
        Time to load model and points, and total time, s.

    """
    document = {
        'schema': SCHEMA,
        'success': result.success,
        'reason': result.reason,
        'message': result.message,
        'grade': result.grade,
        'T_tracker_bone': result.T_tracker_bone,
        'bone_pose': _bone_pose(result, frame_id),
        'covariance': result.covariance,
        'points': {'received': result.received, 'used': result.used, 'inliers': result.inliers,
                   'left_out': result.left_out},
        'rejected': result.rejected,
        'recording': recording,
        'sigma_m': result.sigma_m,
        'residual_rms_m': result.residual_rms_m,
        'predicted_tre_m': {'rms': None, 'max': None, **result.predicted_tre_m},
        'zone': result.zone,
        'weakest_direction': dict.fromkeys(WeakestDirection.__dataclass_fields__)
        if result.weakest_direction is None else result.weakest_direction,
        'landmarks': result.landmarks,
        'ambiguity': {'runner_up_ratio': result.runner_up_ratio},
        'timing_s': {'load': load_s, 'search': result.timing_s.get('search'),
                     'solve': result.timing_s.get('solve'), 'total': total_s},
        'inputs': {'model_sha256': model_sha256, 'points_sha256': points_sha256},
        'config': config.named().flat(),
        'version': __version__,
    }
    return plain(document)


def _bone_pose(result: RegistrationResult, frame_id: str) -> dict[str, Any] | None:
    if result.T_tracker_bone is None:
        return None
    T = result.T_tracker_bone
    return {
        'frame_id': frame_id, 'position': T[:3, 3],
        'orientation': quaternion_from_rotation(T[:3, :3])
    }
