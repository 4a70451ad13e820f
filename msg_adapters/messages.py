# SPDX-License-Identifier: Apache-2.0
"""
Classes of the standard messages, and their serialized form.

They are those of ROS or, on a machine without it, those of rosbags, which have the same names and
fields. So one function makes a message for a topic and for a recording.
"""

from __future__ import annotations

import array
from typing import Any

import numpy as np

try:
    from builtin_interfaces.msg import Time
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from geometry_msgs.msg import (
        Point,
        PointStamped,
        Pose,
        PoseStamped,
        PoseWithCovariance,
        PoseWithCovarianceStamped,
        Quaternion,
        Transform,
        TransformStamped,
        Vector3,
    )
    from sensor_msgs.msg import PointCloud2, PointField
    from std_msgs.msg import Header
except ImportError:
    from msg_adapters.bag import TYPES
    Time = TYPES.types['builtin_interfaces/msg/Time']
    DiagnosticArray, DiagnosticStatus, KeyValue = (
        TYPES.types[f'diagnostic_msgs/msg/{name}']
        for name in ('DiagnosticArray', 'DiagnosticStatus', 'KeyValue'))
    (Point, PointStamped, Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped,
     Quaternion, Transform, TransformStamped, Vector3) = (
        TYPES.types[f'geometry_msgs/msg/{name}'] for name in (
            'Point', 'PointStamped', 'Pose', 'PoseStamped', 'PoseWithCovariance',
            'PoseWithCovarianceStamped', 'Quaternion', 'Transform', 'TransformStamped', 'Vector3'))
    PointCloud2, PointField = (TYPES.types[f'sensor_msgs/msg/{name}']
                               for name in ('PointCloud2', 'PointField'))
    Header = TYPES.types['std_msgs/msg/Header']

__all__ = ['DiagnosticArray', 'DiagnosticStatus', 'Header', 'KeyValue', 'Point', 'PointCloud2',
           'PointField', 'PointStamped', 'Pose', 'PoseStamped', 'PoseWithCovariance',
           'PoseWithCovarianceStamped', 'Quaternion', 'Time', 'Transform', 'TransformStamped',
           'Vector3', 'octets', 'serialized', 'tf_message', 'type_of']


def octets(data: bytes) -> Any:
    """Return bytes as a field of type uint8[]."""
    if hasattr(PointCloud2, '__msgtype__'):
        return np.frombuffer(data, np.uint8)
    return array.array('B', data)   # rclpy accepts an array as it is, but checks bytes one by one


def tf_message(transforms: list[Any]) -> Any:
    """Return a tf2_msgs/msg/TFMessage for a recording; ROS has no wheel of tf2_msgs."""
    from msg_adapters.bag import TYPES
    return TYPES.types['tf2_msgs/msg/TFMessage'](transforms)


def type_of(message: Any) -> str:
    """Return the type of a message, such as std_msgs/msg/Header."""
    kind = type(message)
    return getattr(kind, '__msgtype__', f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}')


def serialized(message: Any) -> bytes:
    """Return a message in CDR."""
    if hasattr(message, '__msgtype__'):
        from msg_adapters.bag import TYPES
        return bytes(TYPES.serialize_cdr(message, message.__msgtype__))
    from rclpy.serialization import serialize_message
    return bytes(serialize_message(message))
