# SPDX-License-Identifier: Apache-2.0
"""From tracks to a rig: what was measured in, parameters with their uncertainties out. No ROS."""
