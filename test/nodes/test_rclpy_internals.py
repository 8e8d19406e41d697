# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The private parts of rclpy in use: each test fails by the name of the part that has changed."""

from __future__ import annotations

from typing import Any

import pytest
from rclpy.event_handler import QoSPublisherEventType, QoSSubscriptionEventType
from rclpy.impl import implementation_singleton
from rclpy.node import Node
from rclpy.serialization import deserialize_message
from soft_throw_ros.nodes import rclpy_internals
from std_msgs.msg import String


@pytest.fixture
def node(ros: Any) -> Node:
    return ros.node(Node, 'tester', ros_args=('-p', 'misspelled:=7'))


def require(owner: Any, name: str, purpose: str) -> None:
    """Fail with a sentence if an object has no such attribute."""
    assert hasattr(owner, name), f'rclpy has changed: {owner!r} has no {name}, {purpose}'


def test_waiting_messages_are_read_as_bytes_with_their_number(ros, node) -> None:
    subscription = node.create_subscription(String, '/talk', lambda _: None, 10, raw=True)
    require(subscription.handle, 'take_message', 'which takes a message without an executor')
    publisher = node.create_publisher(String, '/talk', 10)
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    publisher.publish(String(data='hello'))
    taken: list[Any] = []

    def is_there() -> bool:
        taken.extend(rclpy_internals.take_messages(subscription, String))
        return bool(taken)

    ros.spin_until(is_there, 'the message')
    ((data, information),) = taken
    assert deserialize_message(data, String).data == 'hello'
    for name in ('publication_sequence_number', 'received_timestamp', 'source_timestamp'):
        assert name in information, f'rclpy has changed: a taken message lacks {name}'
    assert information['publication_sequence_number'] == 1


def test_events_are_polled(node) -> None:
    implementation = implementation_singleton.rclpy_implementation
    require(implementation, 'EventHandle', 'which polls an event without an executor')
    publisher = node.create_publisher(String, '/talk', 10)
    subscription = node.create_subscription(String, '/other', lambda _: None, 10)
    for handle, kind in (
        (publisher.handle, QoSPublisherEventType.RCL_PUBLISHER_OFFERED_INCOMPATIBLE_QOS),
        (subscription.handle, QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST),
    ):
        event = rclpy_internals.open_event(handle, kind)
        status = rclpy_internals.take_event(event)
        assert status is None or status.total_count == 0
        rclpy_internals.close_event(event)


def test_undeclared_parameters_are_seen(node) -> None:
    require(node, '_parameter_overrides', 'which has the parameters given at the start')
    values = {item.name: item.value for item in rclpy_internals.parameter_overrides(node)}
    assert values['misspelled'] == 7
