# SPDX-License-Identifier: Apache-2.0
"""QoS profiles of the topics, which clients of the node must match; and the clock of timers."""

from __future__ import annotations

from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

# Late joiners receive the last message: poses, status, points, markers.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)

# A subscriber that asks for a lease of 3 s sees within it that the node was killed, instead of
# after the 20 s for which Fast DDS keeps a participant that is silent
RESULT = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                    durability=DurabilityPolicy.TRANSIENT_LOCAL,
                    liveliness=LivelinessPolicy.AUTOMATIC,
                    liveliness_lease_duration=Duration(seconds=2.0))

# Best effort is compatible with reliable publishers as well. Of a longer queue Fast DDS holds 5000
# messages, 5 s of points at 1 kHz. It rejects further ones and counts them, see
# `ros_lost_messages`. In a queue of up to 5000 the latest message replaces the first one, and
# nothing is counted.
POINTS = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT,
                    durability=DurabilityPolicy.VOLATILE)

# No event handlers for incompatible QoS. rclpy checks them with every message, which takes a third
# of the time to receive a point.
UNWATCHED = PublisherEventCallbacks(use_default_callbacks=False)
UNWATCHED_POINTS = SubscriptionEventCallbacks(use_default_callbacks=False)

# What the node offers where subscribers may ask for something else, see `node.hints`
OFFERED = {'~/status': LATCHED, '~/bone_pose': LATCHED, '~/live_pose': QoSProfile(depth=10),
           '/diagnostics': QoSProfile(depth=10), '/tf': QoSProfile(depth=100)}

# Timers run by this clock: ROS time stands still without /clock, or after the end of a recording
STEADY = Clock(clock_type=ClockType.STEADY_TIME)
