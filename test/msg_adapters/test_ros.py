# SPDX-License-Identifier: Apache-2.0
"""Test the conversion between ROS messages and arrays."""

from __future__ import annotations

import array

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField

from gsdf_registration.common.result import InputError
from gsdf_registration.common.rigid import exp
from msg_adapters import ros

FINITE = st.floats(-1e6, 1e6)
VECTORS = st.tuples(FINITE, FINITE, FINITE)
TWISTS = st.tuples(*[st.floats(-1.8, 1.8)] * 3, *[st.floats(-10, 10)] * 3)
NAMES = st.text('abcdefghijklmnopqrstuvwxyz_', min_size=1, max_size=12)
STAMP = ros.seconds_to_stamp(12.25)


def sent(message):
    """Return the message after serialization and deserialization."""
    return deserialize_message(serialize_message(message), type(message))


@settings(deadline=None, max_examples=50)
@given(VECTORS, NAMES, st.integers(0, 2**22), st.integers(0, 999_999_999))
def test_points_survive_the_conversion(position, frame_id, sec, nanosec):
    stamp = ros.Time(sec=sec, nanosec=nanosec)
    message = sent(ros.point_msg(position, frame_id, stamp))
    sample = ros.sample_from(message, '/tip', 3.0)
    assert sample[1:5] == (position, frame_id, '/tip', 3.0)
    assert ros.seconds_to_stamp(sample.stamp) == stamp == message.header.stamp


@settings(deadline=None, max_examples=50)
@given(TWISTS)
def test_poses_and_transforms_survive_the_conversion(twist):
    T = exp(twist)
    seconds, back, frame = ros.pose_from(sent(ros.pose_msg(T, 'tracker', STAMP)))
    assert (seconds, frame) == (12.25, 'tracker')
    np.testing.assert_allclose(back, T, atol=1e-12)
    seconds, back, parent, child = ros.transform_from(
        sent(ros.transform_msg(T, 'tracker', 'bone', STAMP)))
    assert (seconds, parent, child) == (12.25, 'tracker', 'bone')
    np.testing.assert_allclose(back, T, atol=1e-12)


def test_covariance_is_row_major_in_the_order_of_rep_103():
    covariance = np.diag([1.0, 2, 3, 4, 5, 6])
    covariance[0, 5] = covariance[5, 0] = 0.5       # x with rz
    message = sent(ros.pose_with_covariance_msg(np.eye(4), covariance, 'tracker', STAMP))
    assert message.pose.covariance[:6].tolist() == [1, 0, 0, 0, 0, 0.5]
    np.testing.assert_array_equal(message.pose.covariance.reshape(6, 6), covariance)
    assert message.header.frame_id == 'tracker' and message.pose.pose.orientation.w == 1.0


def test_rejects_invalid_poses():
    message = PoseStamped()
    message.pose.orientation.w = 0.0
    with pytest.raises(InputError, match='orientation'):
        ros.pose_from(message)
    message.pose.orientation.w = float('nan')
    with pytest.raises(InputError, match='orientation'):
        ros.pose_from(message)
    message.pose.orientation.w = 0.9        # more than a rounding error
    with pytest.raises(InputError, match='unit length'):
        ros.pose_from(message)
    message.pose.orientation.w = 1.0
    message.pose.position.x = float('inf')
    with pytest.raises(InputError, match='not finite'):
        ros.pose_from(message)


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(*[st.floats(-10, 10, width=32)] * 5, st.integers(-2**31, 2**31 - 1)),
             max_size=20))
def test_clouds_survive_the_conversion(rows):
    columns = [np.array(column) for column in zip(*rows)] if rows else [np.zeros(0)] * 6
    message = sent(ros.cloud_msg(np.column_stack(columns[:3]), *columns[3:], 'bone', STAMP))
    assert (message.width, message.height, message.point_step) == (len(rows), 1, 24)
    assert [field.name for field in message.fields] == ['x', 'y', 'z', 'residual', 'weight',
                                                        'stroke']
    back = ros.cloud_to_arrays(message)
    for name, column in zip(('x', 'y', 'z', 'residual', 'weight', 'stroke'), columns):
        np.testing.assert_array_equal(back[name], column)
    assert back['x'].dtype == np.float32 and back['stroke'].dtype == np.int32


def test_cloud_accepts_scalars_and_nan():
    back = ros.cloud_to_arrays(ros.cloud_msg([[1, 2, 3], [4, 5, 6]], np.nan, 1.0, 0, 'bone', STAMP))
    assert np.isnan(back['residual']).all() and back['weight'].tolist() == [1, 1]


def test_reads_clouds_with_padding_rows_and_big_endian_data():
    points = np.array([[(1.5, 7), (2.5, 8)], [(3.5, 9), (4.5, 10)]],
                      np.dtype({'names': ['x', 'i'], 'formats': ['>f8', '>u2'], 'offsets': [4, 14],
                                'itemsize': 20}))
    data = b''.join(row.tobytes() + b'pad' for row in points)
    message = PointCloud2(height=2, width=2, point_step=20, row_step=43, is_bigendian=True,
                          data=array.array('B', data), fields=[
                              PointField(name='x', offset=4, datatype=PointField.FLOAT64, count=1),
                              PointField(name='i', offset=14, datatype=PointField.UINT16, count=1)])
    back = ros.cloud_to_arrays(message)
    assert back['x'].tolist() == [1.5, 2.5, 3.5, 4.5] and back['i'].tolist() == [7, 8, 9, 10]
    assert back['x'].dtype == np.float64
    message.data = message.data[:-1]
    with pytest.raises(InputError, match='point cloud'):
        ros.cloud_to_arrays(message)


def test_diagnostic_values_are_text():
    message = sent(ros.diagnostic_status('registration', DiagnosticStatus.WARN, 'collecting',
                                         {'received': 12, 'state': 'collecting'}))
    assert (message.name, message.level, message.message) == ('registration', b'\x01', 'collecting')
    values = {pair.key: pair.value for pair in message.values}
    assert values == {'received': '12', 'state': 'collecting'}
