# SPDX-License-Identifier: Apache-2.0
"""Parameters: a table for every node, settings made from it, and parameter files. No ROS."""

from soft_throw_ros.configuration.layers import CUSTOM
from soft_throw_ros.configuration.recorder import RECORDER
from soft_throw_ros.configuration.table import Entry, ParameterError, Settings, Table, Value
from soft_throw_ros.configuration.twin import LAYERS, rig_of, rig_values, TWIN

__all__ = [
    'CUSTOM',
    'LAYERS',
    'RECORDER',
    'TWIN',
    'Entry',
    'ParameterError',
    'Settings',
    'Table',
    'Value',
    'rig_of',
    'rig_values',
]
