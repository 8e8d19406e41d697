# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Choice of a layer, of a plate motion and of an amplitude for a throw.

A recommendation maximises an objective over layers within limits; a landscape evaluates it on a
grid. This package may import `configuration` and `core`.

"""
