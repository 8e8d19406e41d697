# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Trials of `soft-throw identify` on simulated rigs with faults, whose parameters are known."""
