# SPDX-License-Identifier: Apache-2.0
"""
Convert between ROS messages and arrays; see `markers` for markers.

Lengths are in metres, angles in radians, times in seconds. Quaternions are x y z w. Covariances are
row-major in the order x y z rx ry rz about fixed axes (REP-103).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gsdf_registration.common.operator_event import OperatorEvent
from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import Array, quaternion_from_rotation
from gsdf_registration.common.samples import Sample
from msg_adapters import stamps
from msg_adapters.messages import (
    DiagnosticStatus,
    Header,
    KeyValue,
    Point,
    PointCloud2,
    PointField,
    PointStamped,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    PoseWithCovarianceStamped,
    Quaternion,
    Time,
    Transform,
    TransformStamped,
    Vector3,
    octets,
)
from msg_adapters.motion import to_matrix, tool_pose

# Name and type of the fields of ~/points, four bytes each
CLOUD = [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('residual', '<f4'), ('weight', '<f4'),
         ('stroke', '<i4')]
FIELD_TYPES = {
    PointField.INT8: 'i1', PointField.UINT8: 'u1', PointField.INT16: 'i2', PointField.UINT16: 'u2',
    PointField.INT32: 'i4', PointField.UINT32: 'u4', PointField.FLOAT32: 'f4',
    PointField.FLOAT64: 'f8'
}
TYPE_NUMBERS = {name: number for number, name in FIELD_TYPES.items()}


def stamp_to_seconds(stamp: Time) -> float:
    """Return a stamp in seconds."""
    return stamps.to_seconds(stamp.sec, stamp.nanosec)


def seconds_to_stamp(seconds: float) -> Time:
    """Return the stamp nearest to a time in seconds."""
    sec, nanosec = stamps.split(stamps.to_nanoseconds(seconds))
    return Time(sec=sec, nanosec=nanosec)


def sample_from(message: PointStamped, topic: str = '', arrival: float | None = None) -> Sample:
    """Return a point of ``topic`` that arrived at local time ``arrival``, s, as a sample."""
    point, header = message.point, message.header
    return Sample(stamp_to_seconds(header.stamp), (point.x, point.y, point.z), header.frame_id,
                  topic, arrival)


def tool_sample_from(message: Any, kind: str, topic: str = '',
                     arrival: float | None = None) -> Sample:
    """Return the pose of a tool as a sample; ``kind``: type of the message, of `TOOL_POSES`."""
    tool, header = tool_pose(message, kind), message.header
    return Sample(stamp_to_seconds(header.stamp), tool[:3], header.frame_id, topic, arrival,
                  tool=tool)


def pose_from(message: PoseStamped) -> tuple[float, Array, str]:
    """Return stamp (s), ``T_frame_body`` (4, 4) and frame; raise `InputError` as `to_matrix`."""
    pose, header = message.pose, message.header
    return (stamp_to_seconds(header.stamp), to_matrix(pose.position, pose.orientation),
            header.frame_id)


def transform_from(message: TransformStamped) -> tuple[float, Array, str, str]:
    """Return stamp (s), ``T_parent_child`` (4, 4), parent, child; raise as `to_matrix`."""
    motion, header = message.transform, message.header
    return (stamp_to_seconds(header.stamp), to_matrix(motion.translation, motion.rotation),
            header.frame_id, message.child_frame_id)


def point_msg(position: ArrayLike, frame_id: str, stamp: Time) -> PointStamped:
    """Return a point (3,) m in ``frame_id``."""
    return PointStamped(header=Header(stamp=stamp, frame_id=frame_id), point=_point(position))


def pose_msg(T: ArrayLike, frame_id: str, stamp: Time) -> PoseStamped:
    """Return the pose ``T_frame_body`` (4, 4)."""
    return PoseStamped(header=Header(stamp=stamp, frame_id=frame_id), pose=_pose(T))


def pose_with_covariance_msg(T: ArrayLike, covariance: ArrayLike, frame_id: str,
                             stamp: Time) -> PoseWithCovarianceStamped:
    """Return the pose ``T_frame_body`` (4, 4) with its covariance (6, 6), m and rad."""
    flat = np.asarray(covariance, dtype=np.float64).reshape(36)
    return PoseWithCovarianceStamped(header=Header(stamp=stamp, frame_id=frame_id),
                                     pose=PoseWithCovariance(pose=_pose(T), covariance=flat))


def transform_msg(T: ArrayLike, parent: str, child: str, stamp: Time) -> TransformStamped:
    """Return the transform ``T_parent_child`` (4, 4)."""
    T = np.asarray(T, dtype=np.float64)
    x, y, z = (float(value) for value in T[:3, 3])
    return TransformStamped(header=Header(stamp=stamp, frame_id=parent),
                            child_frame_id=child,
                            transform=Transform(translation=Vector3(x=x, y=y, z=z),
                                                rotation=_quaternion(T)))


def cloud_msg(positions: ArrayLike, residual: ArrayLike, weight: ArrayLike, stroke: ArrayLike,
              frame_id: str, stamp: Time) -> PointCloud2:
    """
    Return points as a cloud with fields x y z residual weight (float32) and stroke (int32).

    Parameters
    ----------
    positions : (n, 3) float
        In ``frame_id``, m.
    residual : (n,) or scalar float
        Distance to the surface, m; NaN if unknown.
    weight : (n,) or scalar float
        In [0, 1]; NaN if unknown.
    stroke : (n,) or scalar int
        Stroke number.
    frame_id, stamp : str, Time
        Of the header.

    """
    positions = np.asarray(positions)
    rows = np.zeros(len(positions), dtype=CLOUD)
    rows['x'], rows['y'], rows['z'] = positions.T
    rows['residual'], rows['weight'], rows['stroke'] = residual, weight, stroke
    fields = [PointField(name=name, offset=4 * i, count=1, datatype=TYPE_NUMBERS[kind[1:]])
              for i, (name, kind) in enumerate(CLOUD)]
    return PointCloud2(
        header=Header(stamp=stamp, frame_id=frame_id), height=1, width=len(rows), fields=fields,
        is_bigendian=False, is_dense=False, point_step=rows.itemsize, row_step=rows.nbytes,
        data=octets(rows.tobytes()))


def cloud_to_arrays(message: PointCloud2) -> dict[str, NDArray[Any]]:
    """
    Return the fields of a point cloud by name, each (n,) or (n, count).

    Raises
    ------
    InputError
        If the description of the fields does not match the data.

    """
    order = '>' if message.is_bigendian else '<'
    size, n = message.point_step, message.width * message.height
    try:
        layout = np.dtype({
            'names': [field.name for field in message.fields], 'formats': [
                (order + FIELD_TYPES[field.datatype], (field.count, ) if field.count > 1 else ())
                for field in message.fields
            ], 'offsets': [field.offset for field in message.fields], 'itemsize': size
        })
        data = np.frombuffer(message.data, dtype=np.uint8)
        # a row may be longer than its points
        rows = data.reshape(message.height, message.row_step)[:, :message.width * size]
        points = np.ascontiguousarray(rows).view(layout).reshape(n)
    except (ValueError, KeyError) as error:
        raise InputError(f'the fields of the point cloud do not match its data: {error}') from None
    return {
        name: points[name].astype(points[name].dtype.newbyteorder('='))
        for name in layout.names or ()
    }


def diagnostic_status(name: str, level: bytes, message: str, values: Mapping[str, Any],
                      hardware_id: str = '') -> DiagnosticStatus:
    """Return a status of ``level`` DiagnosticStatus.OK, WARN, ERROR or STALE."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    return DiagnosticStatus(name=name,
                            level=level,
                            message=message,
                            hardware_id=hardware_id,
                            values=pairs)


def event_msg(event: OperatorEvent, name: str) -> DiagnosticStatus:
    """Return what an operator did as a message from the node ``name``."""
    level = DiagnosticStatus.OK if event.success else DiagnosticStatus.WARN
    return diagnostic_status(name, level, event.message, event.values())


def with_stamp(status: DiagnosticStatus, stamp: Time) -> DiagnosticStatus:
    """Return a copy with the value ``stamp``, seconds and nanoseconds: it has no header."""
    value = KeyValue(key='stamp', value=f'{stamp.sec}.{stamp.nanosec:09d}')
    return DiagnosticStatus(level=status.level, name=status.name, message=status.message,
                            hardware_id=status.hardware_id, values=[value, *status.values])


def _point(position: ArrayLike) -> Point:
    """Return a position (3,) m as a message."""
    x, y, z = (float(value) for value in np.asarray(position, dtype=np.float64))
    return Point(x=x, y=y, z=z)


def _quaternion(T: Array) -> Quaternion:
    """Return the rotation of a matrix (4, 4) as a quaternion."""
    x, y, z, w = (float(value) for value in quaternion_from_rotation(T[:3, :3]))
    return Quaternion(x=x, y=y, z=z, w=w)


def _pose(T: ArrayLike) -> Pose:
    """Return a matrix (4, 4) as a pose."""
    T = np.asarray(T, dtype=np.float64)
    return Pose(position=_point(T[:3, 3]), orientation=_quaternion(T))
