# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The physics of one throw: rigs, the closed form, the steppers, and batches of throws.

Numbers in SI units go in, numbers come out; there is no clock, no file and no ROS. This package
imports the standard library, numpy, numba and SciPy only.

"""
