# SPDX-License-Identifier: Apache-2.0
"""
Classes of the standard messages, and their serialized form.

They are those of ROS or, on a machine without it, those of rosbags, which have the same names and
fields. So one function makes a message for a topic and for a recording.
"""

from __future__ import annotations

import array
from functools import cache
from typing import Any

import numpy as np

from msg_adapters.ros_definitions import definition_of

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
           'Vector3', 'definition', 'octets', 'serialized', 'tf_message', 'type_of']


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


def definition(msgtype: str) -> str:
    """Return the text of the definition of a type; empty for a standard one, which is known."""
    from msg_adapters.bag import TYPES
    return '' if msgtype in TYPES.types else definition_of(msgtype)


def serialized(message: Any) -> bytes:
    """Return a message in CDR; equal messages give equal bytes."""
    kind = type_of(message)
    store = _store(kind)
    if not hasattr(message, '__msgtype__'):     # of ROS, which leaves the padding undefined
        from rclpy.serialization import serialize_message
        message = store.deserialize_cdr(serialize_message(message), kind)
    return bytes(store.serialize_cdr(message, kind))


@cache
def _store(msgtype: str) -> Any:
    """Return what serializes the messages of a type."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from msg_adapters.bag import TYPES
    if msgtype in TYPES.types:
        return TYPES
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition_of(msgtype), msgtype))
    return store
