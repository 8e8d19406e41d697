# SPDX-License-Identifier: Apache-2.0
"""
Start a twin that follows a plate which is measured, and a calibrator that keeps it true.

Examples
--------
``ros2 launch soft_throw_ros measured.launch.py topic:=/laser/joint_states``

"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node, SetRemap

SHARE = Path(get_package_share_directory('soft_throw_ros'))
MEASURED = 'twin/measured_joint_states'


def generate_launch_description() -> LaunchDescription:
    """Return the twin's launch file, whose arguments may be given as well, and a calibrator."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'topic',
                default_value=MEASURED,
                description='Where plate and projectile are measured: sensor_msgs/JointState',
            ),
            SetRemap(src='~/measured_joint_states', dst=LaunchConfiguration('topic')),
            SetRemap(src=MEASURED, dst=LaunchConfiguration('topic')),
            IncludeLaunchDescription(
                str(SHARE / 'launch/twin.launch.py'),
                launch_arguments={'motion': 'measured'}.items(),
            ),
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
    )
