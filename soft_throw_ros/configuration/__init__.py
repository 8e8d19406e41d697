# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Parameters without ROS: a table for every node, its settings, and parameter files."""

from soft_throw_ros.configuration.recorder import RECORDER
from soft_throw_ros.configuration.table import (
    Entry,
    ParameterError,
    Scalar,
    Settings,
    Table,
    Value,
)
from soft_throw_ros.configuration.twin import rig_of, rig_values, TWIN

__all__ = [
    'RECORDER',
    'TWIN',
    'Entry',
    'ParameterError',
    'Scalar',
    'Settings',
    'Table',
    'Value',
    'rig_of',
    'rig_values',
]
