# SPDX-License-Identifier: Apache-2.0
"""Count messages that the middleware lost: the queue was full, or the network dropped them."""

from __future__ import annotations

from rclpy.event_handler import UnsupportedEventTypeError
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.subscription import Subscription

MESSAGE_LOST = rclpy_implementation.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_MESSAGE_LOST


class LostMessages:
    """
    The messages of one subscription that were lost before the node could take them.

    The event of the middleware is read from time to time. Waiting for it, as rclpy does, would take
    a third of the time to receive a point.
    """

    def __init__(self, subscription: Subscription) -> None:
        self._seen = 0
        self._event = None      # the middleware does not count
        try:
            with subscription.handle:
                self._event = rclpy_implementation.EventHandle(subscription.handle, MESSAGE_LOST)
        except UnsupportedEventTypeError:
            pass

    def take(self) -> int:
        """Return the number of messages lost since the last call."""
        if self._event is None:
            return 0
        with self._event:
            found = self._event.take_event()
        total = self._seen if found is None else found.total_count
        lost, self._seen = total - self._seen, total
        return lost

    def destroy(self) -> None:
        """Forget the subscription; to be called before it is destroyed."""
        if self._event is not None:
            self._event.destroy_when_not_in_use()
