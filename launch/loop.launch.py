# SPDX-License-Identifier: Apache-2.0
"""Start a rig that ages, a twin that follows its plate, and a calibrator that finds it out."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SHARE = Path(get_package_share_directory('soft_throw_ros'))
PARAMETERS = str(SHARE / 'config/loop.yaml')


def generate_launch_description() -> LaunchDescription:
    """Return the twin's launch file with the loop's parameters, a rig and a calibrator."""
    others = [
        Node(
            package='soft_throw_ros',
            executable=name,
            name=name,
            namespace=LaunchConfiguration('namespace'),
            parameters=[PARAMETERS],
            output='both',
        )
        for name in ('rig', 'calibrator')
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument('namespace', default_value='', description='Of all nodes'),
            DeclareLaunchArgument(
                'rerun', default_value='viewer', description='rerun.sink of the recorder'
            ),
            IncludeLaunchDescription(
                str(SHARE / 'launch/twin.launch.py'),
                launch_arguments={
                    'params_file': PARAMETERS,
                    'namespace': LaunchConfiguration('namespace'),
                    'record': 'true',
                    'folder': 'loop',
                    'rerun': LaunchConfiguration('rerun'),
                }.items(),
            ),
            *others,
        ]
    )
