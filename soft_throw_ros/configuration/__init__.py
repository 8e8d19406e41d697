# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameters without ROS: a table for every node, its settings, and parameter files.

The tables of parameters and topics are the source of docs/parameters.md, docs/topics.md and the
options of the commands. This package may import `core` and `storage`.

"""

from soft_throw_ros.configuration.node_tables import RECORDER
from soft_throw_ros.configuration.table import ParameterError, Scalar, Settings, Table, Value
from soft_throw_ros.configuration.twin import rig_of, rig_values, TWIN

__all__ = [
    'RECORDER', 'TWIN', 'ParameterError', 'Scalar', 'Settings', 'Table', 'Value', 'rig_of',
    'rig_values',
]
