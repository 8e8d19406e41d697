# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Executables that need no ROS: throw, design, identify, track, inspect and others.

A command reads options and files, calls one function of an inner package, and prints the result.
This package may import every package except `nodes`.

"""
