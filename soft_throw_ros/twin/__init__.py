# SPDX-License-Identifier: Apache-2.0
"""The twin without ROS: what happens at which step, and all that is needed to repeat it."""
