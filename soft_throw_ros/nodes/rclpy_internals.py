# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""All private parts of rclpy that this package uses, each with the reason."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from typing import Any

from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.subscription import Subscription


def take_messages(
    subscription: Subscription, message_type: Any
) -> Generator[tuple[bytes, Mapping[str, Any]], None, None]:
    """
    Yield the messages that wait at a subscription, as bytes with their information.

    An executor takes one message each time it wakes, which costs more than everything else that a
    recorder does.
    """
    handle = subscription.handle
    with handle:
        while (message := handle.take_message(message_type, True)) is not None:
            yield message


class LossEvent:
    """
    The losses of a subscription that the middleware reports, for polling.

    An executor that waits for events wakes for every message as well.
    """

    def __init__(self, subscription: Subscription) -> None:
        kind = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
        with subscription.handle:
            self._event = rclpy_implementation.EventHandle(subscription.handle, kind)
        self._count = 0

    def count(self) -> int:
        """Return the number of all lost messages so far."""
        with self._event:
            status = self._event.take_event()
        if status is not None:
            self._count = status.total_count
        return self._count

    def close(self) -> None:
        """Release the event, which would keep its subscription."""
        self._event.destroy_when_not_in_use()


def parameter_overrides(node: Node) -> list[Parameter]:
    """
    Return the parameters given to a node at its start, including undeclared ones.

    Undeclared parameters are misspelled names, which rclpy ignores and this package refuses.
    """
    return list(node._parameter_overrides.values())
