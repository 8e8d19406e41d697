# SPDX-License-Identifier: Apache-2.0
"""Choose a layer for a throw. No ROS."""
