# SPDX-License-Identifier: Apache-2.0
"""Trials of `soft-throw identify` on rigs that are no models: what it finds, and what it says."""
