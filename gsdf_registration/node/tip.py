# SPDX-License-Identifier: Apache-2.0
"""The tip of the probe as the node sees it, for displays: calibrated and in the session frame."""

from __future__ import annotations

from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data

from gsdf_registration.common.config import Config
from gsdf_registration.common.rigid import Array
from gsdf_registration.common.samples import Rejection, Sample, SampleSink, at_tip
from msg_adapters import ros


def create_tip_publisher(node: Node) -> Publisher:
    """Return the publisher of ``~/tip``."""
    return node.create_publisher(PointStamped, '~/tip', qos_profile_sensor_data)


class TipPublisher:
    """
    A sink of samples that publishes the tip on ``~/tip`` and passes every sample on.

    Without a subscriber nothing is published: a display costs the node time only while it is open.

    Parameters
    ----------
    publisher : of PointStamped, see `create_tip_publisher`
    sink : SampleSink
        To which the samples are passed.

    """

    def __init__(self, publisher: Publisher, sink: SampleSink) -> None:
        self._publisher, self._sink = publisher, sink

    @property
    def config(self) -> Config:
        """Settings in force."""
        return self._sink.config

    def take(self, sample: Sample) -> bool:
        """Pass a sample on, as it was received."""
        return self._sink.take(sample)

    def add_reference_pose(self, stamp: float, T: Array) -> None:
        """Pass a pose of the reference array on."""
        self._sink.add_reference_pose(stamp, T)

    def add(self, sample: Sample) -> Rejection | None:
        """Pass a sample on, and publish the tip unless the sample is invalid."""
        rejection, tip = self._sink.add(sample), self.config.probe.tip
        valid = rejection is None or not rejection.invalidates_sample
        known = sample.tool is None or bool(tip)
        if valid and known and self._publisher.get_subscription_count():
            self._publisher.publish(ros.point_msg(at_tip(sample, tip).position, sample.frame_id,
                                                  ros.seconds_to_stamp(sample.stamp)))
        return rejection

    def reject(self, sample: Sample, cause: Rejection) -> None:
        """Pass a rejected sample on."""
        self._sink.reject(sample, cause)

    def restart(self, reason: str) -> None:
        """Pass on that the clock of the samples restarted."""
        self._sink.restart(reason)
