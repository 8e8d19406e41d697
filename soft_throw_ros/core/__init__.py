# SPDX-License-Identifier: Apache-2.0
"""The physics: numbers in, numbers out. No clock, no file, no ROS."""
