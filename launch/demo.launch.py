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
"""Start the twin in slow motion, record it into a bag, and show it in Rerun."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription

SHARE = Path(get_package_share_directory('soft_throw_ros'))
# Arguments of twin.launch.py whose defaults differ here.
ARGUMENTS = (
    DeclareLaunchArgument(
        'params_file',
        default_value=str(SHARE / 'config/demo.yaml'),
        description='Parameter file of all nodes',
    ),
    DeclareLaunchArgument('record', default_value='true', description='Record into a bag'),
    DeclareLaunchArgument(
        'rerun', default_value='viewer', description='rerun.sink of the recorder'
    ),
)


def generate_launch_description() -> LaunchDescription:
    """Return the twin's launch file with the defaults of the demo."""
    return LaunchDescription(
        [
            *ARGUMENTS,
            IncludeLaunchDescription(str(SHARE / 'launch/twin.launch.py')),
        ]
    )
