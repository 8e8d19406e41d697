# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A test of a twin in this process, without launch: pytest test_my_twin.py."""

import time

from diagnostic_msgs.msg import DiagnosticArray
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from soft_throw_ros.nodes.conversions import msg_to_throw_result
from soft_throw_ros.nodes.twin import Twin


def test_my_layer_throws_at_1375_mm_per_second():
    rclpy.init(args=['--ros-args', '-p', 'layer.thickness:=0.0168'])
    twin, results = Twin(), []
    twin.create_subscription(
        DiagnosticArray, '~/throw_result',
        lambda msg: results.append(msg_to_throw_result(msg.status[0])), 10)
    executor = SingleThreadedExecutor()
    executor.add_node(twin)
    twin.start()
    deadline = time.monotonic() + 60.0
    while not results and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    twin.destroy_node()
    rclpy.shutdown()
    assert results[0].first.ejection_speed == pytest.approx(1.375, abs=1e-3)
