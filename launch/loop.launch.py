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
"""Start a simulated rig that ages, a twin that follows its plate, and a calibrator."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(get_package_share_directory('soft_throw_ros'))


def generate_launch_description() -> LaunchDescription:
    """Return the demo with the parameters of the loop, and the rig and the calibrator."""
    # The include comes first: it refuses wrong arguments before any node starts.
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'params_file',
                default_value=str(SHARE / 'config/loop.yaml'),
                description='Parameter file of all nodes',
            ),
            IncludeLaunchDescription(str(SHARE / 'launch/demo.launch.py')),
            *(
                Node(
                    package='soft_throw_ros',
                    executable=name,
                    name=name,
                    namespace=LaunchConfiguration('namespace'),
                    parameters=[
                        LaunchConfiguration('params_file'),
                        {'use_sim_time': LaunchConfiguration('use_sim_time')},
                    ],
                    output='both',
                )
                for name in ('rig', 'calibrator')
            ),
        ]
    )
