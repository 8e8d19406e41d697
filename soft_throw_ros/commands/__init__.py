# SPDX-License-Identifier: Apache-2.0
"""Executables that need no ROS."""
