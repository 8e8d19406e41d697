# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Print speed, alpha and recommended thickness of each throw of the node /twin."""

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from soft_throw_ros.nodes.conversions import msg_to_throw_result, msg_to_time, msg_to_values

rclpy.init()
node = rclpy.create_node('results')
qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
recommended = {}


def show(msg):
    result = msg_to_throw_result(msg.status[0])
    if result.stage == 'release':
        print(f'{1e-9 * msg_to_time(msg.header.stamp):.6f} s: '
              f'{result.first.ejection_speed:.3f} m/s, alpha {result.first.energy_transfer:.3f}, '
              f'recommended thickness {recommended.get("thickness")} m', flush=True)


node.create_subscription(DiagnosticArray, '/twin/throw_result', show, qos)
node.create_subscription(
    DiagnosticArray, '/twin/recommendation',
    lambda msg: recommended.update(msg_to_values(msg.status[0])), qos)
rclpy.spin(node)
