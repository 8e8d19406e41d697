# SPDX-License-Identifier: Apache-2.0
"""Parameters: the table of them all, settings made from it, and parameter files. No ROS."""

from soft_throw_ros.configuration.settings import (
    change,
    check_together,
    defaults,
    expand,
    rig_of,
    Settings,
)
from soft_throw_ros.configuration.table import (
    BY_NAME,
    check_value,
    CUSTOM,
    Entry,
    LAYERS,
    ParameterError,
    TABLE,
    Value,
)

__all__ = [
    'BY_NAME',
    'CUSTOM',
    'LAYERS',
    'TABLE',
    'Entry',
    'ParameterError',
    'Settings',
    'Value',
    'change',
    'check_together',
    'check_value',
    'defaults',
    'expand',
    'rig_of',
]
