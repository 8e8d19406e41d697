# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Print speed, alpha and recommended thickness of each throw of the node /twin."""

import math

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from soft_throw_ros.nodes.conversions import msg_to_throw_result, msg_to_time, msg_to_values


class Results(Node):
    def __init__(self):
        super().__init__('results')
        self.thickness = math.nan
        qos = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, callback in (('recommendation', self.recommend), ('throw_result', self.show)):
            self.create_subscription(DiagnosticArray, f'/twin/{topic}', callback, qos)

    def recommend(self, msg):
        self.thickness = msg_to_values(msg.status[0]).get('thickness', math.nan)

    def show(self, msg):
        result, seconds = msg_to_throw_result(msg.status[0]), 1e-9 * msg_to_time(msg.header.stamp)
        if result.stage == 'release':
            print(f'{seconds:.6f} s: {result.first.ejection_speed:.3f} m/s, '
                  f'alpha {result.first.energy_transfer:.3f}, '
                  f'recommended {1e3 * self.thickness:.1f} mm', flush=True)


rclpy.init()
rclpy.spin(Results())
