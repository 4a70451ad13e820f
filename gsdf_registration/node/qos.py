# SPDX-License-Identifier: Apache-2.0
"""How reliably the topics are carried; what a client of the node must know to match them."""

from __future__ import annotations

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

# Late joiners get the last message: poses, status, points, markers.
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)

# Best effort hears reliable publishers too; deep, because a busy moment must cost no point: 10 s at
# 1 kHz. Where nobody attends for 3 s, a depth of 1000 loses two thirds of them and this none; it
# takes 1 MB more of memory then.
POINTS = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT,
                    durability=DurabilityPolicy.VOLATILE)

# Of what matches whoever is at the other end. rclpy would watch for those that do not, and look
# after that with every point that comes in: a third of what hearing it costs.
UNWATCHED = PublisherEventCallbacks(use_default_callbacks=False)
UNWATCHED_POINTS = SubscriptionEventCallbacks(use_default_callbacks=False)
