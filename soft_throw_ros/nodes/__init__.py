# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The ROS 2 nodes: twin, recorder, replay, viewer, calibrator and simulated rig.

Only this package imports rclpy. It may import every other package.

"""
