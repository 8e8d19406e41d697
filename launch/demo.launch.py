# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
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
    DeclareLaunchArgument('rerun', default_value='viewer', description='Live display in Rerun'),
)


def generate_launch_description() -> LaunchDescription:
    """Return the twin's launch file with the defaults of the demo."""
    return LaunchDescription(
        [
            *ARGUMENTS,
            IncludeLaunchDescription(str(SHARE / 'launch/twin.launch.py')),
        ]
    )
