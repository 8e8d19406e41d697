# SPDX-License-Identifier: Apache-2.0
"""Old name of `soft_throw_ros.commands.options`."""

from soft_throw_ros.commands.options import (
    add_options,
    add_rig_options,
    number_or_text,
    OPTIONS,
    read_settings,
    RECOMMENDATION_OPTIONS,
    UNCERTAINTY_OPTIONS,
)

__all__ = [
    'OPTIONS',
    'RECOMMENDATION_OPTIONS',
    'UNCERTAINTY_OPTIONS',
    'add_options',
    'add_rig_options',
    'number_or_text',
    'read_settings',
]
