# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
A simulated rig with faults of body and sensors, for the node `rig` and the trials.

This package may import `core` and `storage`.

"""
