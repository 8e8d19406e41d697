# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""All private parts of rclpy that this package uses, each with the reason."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from typing import Any

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


def open_event(handle: Any, kind: Any) -> Any:
    """
    Return an event of a subscription, to be polled by `take_event`.

    An executor that waits for events wakes for every message as well.
    """
    with handle:
        return rclpy_implementation.EventHandle(handle, kind)


def take_event(event: Any) -> Any:
    """Return the status of an event that occurred since the last call, or None."""
    with event:
        return event.take_event()


def close_event(event: Any) -> None:
    """Release an event, which would keep its subscription."""
    event.destroy_when_not_in_use()


def parameter_overrides(node: Node) -> list[Parameter]:
    """
    Return the parameters given to a node at its start, including undeclared ones.

    Undeclared parameters are misspelled names, which rclpy ignores and this package refuses.
    """
    return list(node._parameter_overrides.values())
