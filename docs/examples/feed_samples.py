# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Publish measured heights for a twin with engine.motion:=measured; here those of a model."""

import time

import numpy as np
import rclpy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from soft_throw_ros.core import Rig, simulate

RATE = 2500  # [Hz]
throw = simulate(Rig())
states, _ = throw.trajectory(np.arange(0, RATE // 4) / RATE)
heights = states[:, 1:3]  # of plate and projectile
rest = np.tile(heights[0], (RATE * 3 // 4, 1))
cycle = np.concatenate([rest, heights])  # a second: replace this by your sensor

rclpy.init()
node = rclpy.create_node('sensor')
publisher = node.create_publisher(JointState, '/twin/measured_joint_states', 1000)
message, begin, count = JointState(name=['plate', 'projectile']), time.time_ns(), 0
while rclpy.ok():
    stamp = begin + count * 1_000_000_000 // RATE
    time.sleep(max(stamp - time.time_ns(), 0) * 1e-9)
    message.header.stamp = Time(nanoseconds=stamp).to_msg()
    message.position = cycle[count % RATE].tolist()
    publisher.publish(message)
    count += 1
