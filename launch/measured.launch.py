# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
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
