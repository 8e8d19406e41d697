# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
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
