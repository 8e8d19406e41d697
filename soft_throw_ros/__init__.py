# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A digital twin of a soft-layer throwing rig: numbers first, ROS 2 at the edge.

Nothing is imported here, so that the physics needs no ROS.

"""

__version__ = '0.2.0'
