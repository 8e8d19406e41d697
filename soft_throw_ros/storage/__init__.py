# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Files of bounded size, bags in MCAP, and ROS messages as bytes.

Other packages read and write user files only here. This package imports no other package of the
project, and no ROS.

"""
