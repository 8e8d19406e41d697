# SPDX-License-Identifier: Apache-2.0
"""Bags, and messages in them, without ROS; what the viewer shows."""
