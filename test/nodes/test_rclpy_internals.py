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
"""The private parts of rclpy in use; the tests of their users check the behaviour."""

from __future__ import annotations

from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from std_msgs.msg import String


def test_private_parts_of_rclpy_exist(ros: Any) -> None:
    node = ros.node(Node, 'tester')
    subscription = node.create_subscription(String, '/talk', print, 10)
    for owner, name in (
        (subscription.handle, 'take_message'),
        (rclpy_implementation, 'EventHandle'),
        (node, '_parameter_overrides'),
    ):
        assert hasattr(owner, name), f'rclpy has changed: {owner!r} has no {name}'
