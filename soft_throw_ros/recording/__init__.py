# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Writing, checking and playing of bags, and the pictures of the viewer, without ROS.

This package may import `twin`, `design` and the packages below them, but not `identification`.

"""
