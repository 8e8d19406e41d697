# SPDX-License-Identifier: Apache-2.0
"""Start the twin in slow motion, recorded into a bag, and shown in Rerun."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration

SHARE = Path(get_package_share_directory('soft_throw_ros'))


def generate_launch_description() -> LaunchDescription:
    """Return the twin's launch file with the demo's parameters."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'rerun', default_value='viewer', description='rerun.sink of the recorder'
            ),
            IncludeLaunchDescription(
                str(SHARE / 'launch/twin.launch.py'),
                launch_arguments={
                    'params_file': str(SHARE / 'config/demo.yaml'),
                    'record': 'true',
                    'folder': 'demo',
                    'rerun': LaunchConfiguration('rerun'),
                }.items(),
            ),
        ]
    )
