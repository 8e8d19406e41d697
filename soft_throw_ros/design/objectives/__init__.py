# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Objectives of recommendations, one file each; each may import `design` and `core`."""
