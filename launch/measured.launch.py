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
"""
Start a twin that follows a measured plate, and a calibrator that updates the rig's parameters.

Examples
--------
``ros2 launch soft_throw_ros measured.launch.py topic:=/laser/joint_states``

"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, SetRemap

SHARE = Path(get_package_share_directory('soft_throw_ros'))
MEASURED = 'twin/measured_joint_states'


def generate_launch_description() -> LaunchDescription:
    """Return the twin's launch file with a measured plate, and a calibrator."""
    # The group keeps the remappings from nodes of a launch file that includes this one.
    # The include comes first: it refuses wrong arguments before any node starts.
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'topic',
                default_value=MEASURED,
                description='sensor_msgs/JointState with the measured plate and projectile',
            ),
            DeclareLaunchArgument(
                'motion',
                default_value='measured',
                choices=['measured'],
                description='engine.motion of the twin',
            ),
            GroupAction(
                [
                    SetRemap(src='~/measured_joint_states', dst=LaunchConfiguration('topic')),
                    SetRemap(src=MEASURED, dst=LaunchConfiguration('topic')),
                    IncludeLaunchDescription(str(SHARE / 'launch/twin.launch.py')),
                    Node(
                        package='soft_throw_ros',
                        executable='calibrator',
                        name='calibrator',
                        namespace=LaunchConfiguration('namespace'),
                        parameters=[
                            LaunchConfiguration('params_file'),
                            {'use_sim_time': LaunchConfiguration('use_sim_time')},
                        ],
                        output='both',
                    ),
                ]
            ),
        ]
    )
