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
Start a twin, and beside it, if asked, a recorder, the Rerun viewer and RViz.

Examples
--------
``ros2 launch soft_throw_ros twin.launch.py namespace:=rig1 record:=true rerun:=viewer``

"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

SHARE = Path(get_package_share_directory('soft_throw_ros'))


def _flag(name: str, description: str) -> DeclareLaunchArgument:
    """Declare an argument that is true or false; false by default."""
    return DeclareLaunchArgument(
        name, default_value='false', choices=['true', 'false'], description=description
    )


ARGUMENTS = (
    DeclareLaunchArgument(
        'params_file',
        default_value=str(SHARE / 'config/twin.yaml'),
        description='Parameters of all nodes',
    ),
    DeclareLaunchArgument(
        'namespace', default_value='', description='Of all nodes; several rigs have several'
    ),
    DeclareLaunchArgument(
        'motion',
        default_value='',
        description='engine.motion of the twin; as params_file says if empty',
    ),
    _flag('record', 'Whether to record into a bag'),
    DeclareLaunchArgument('folder', default_value='.', description='Where bags are put'),
    DeclareLaunchArgument(
        'rerun',
        default_value='none',
        choices=['none', 'viewer', 'serve', 'file'],
        description='Whether to show it in Rerun: rerun.sink of the recorder',
    ),
    _flag('rviz', 'Whether to show it in RViz'),
    _flag('use_sim_time', 'Whether to follow /clock'),
)


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, and what they ask for."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes that the arguments ask for."""
    asked = {
        argument.name: LaunchConfiguration(argument.name).perform(context)
        for argument in ARGUMENTS
    }
    use_sim_time = asked['use_sim_time'] == 'true'
    common = {'namespace': asked['namespace'], 'output': 'both'}
    parameters = [asked['params_file'], {'use_sim_time': use_sim_time}]
    motion = [{'engine.motion': asked['motion']}] if asked['motion'] else []
    nodes = [_ours('twin', parameters=[*parameters, *motion], **common)]
    if asked['record'] == 'true' or asked['rerun'] != 'none':
        recording = {
            'storage': 'mcap' if asked['record'] == 'true' else 'none',
            'folder': asked['folder'],
            'rerun.sink': asked['rerun'],
        }
        nodes.append(_ours('recorder', parameters=[*parameters, recording], **common))
    if asked['rviz'] == 'true':
        nodes += _rviz_nodes(common, use_sim_time=use_sim_time)
    return nodes


def _ours(name: str, **options: object) -> Node:
    """Return a node of this package by its usual name."""
    return Node(package='soft_throw_ros', executable=name, name=name, **options)


def _rviz_nodes(common: dict[str, str], *, use_sim_time: bool) -> list[Node]:
    """
    Return RViz, and what moves its model of the rig.

    A robot_state_publisher listens to one topic, and layer and bodies come by two, so there are
    two of them. Frames have the namespace before their names, so that rigs do not meet in /tf.

    """
    namespace = common['namespace'].strip('/')
    prefix = f'{namespace}/' if namespace else ''
    model = (SHARE / 'urdf/soft_throw.urdf').read_text()
    parameters = [
        {
            'robot_description': ParameterValue(model, value_type=str),
            'frame_prefix': prefix,
            'publish_frequency': 100.0,
            'use_sim_time': use_sim_time,
        }
    ]
    publishers = [
        Node(
            package='robot_state_publisher',
            executable='robot_state_publisher',
            name=f'{name}_state_publisher',
            parameters=parameters,
            remappings=[('joint_states', topic)],
            **common,
        )
        for name, topic in (('body', 'twin/joint_states'), ('layer', 'twin/layer/joint_states'))
    ]
    view = str(SHARE / 'rviz/soft_throw.rviz')
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        name='rviz',
        arguments=['-d', view, '-f', f'{prefix}rig'],
        parameters=[{'use_sim_time': use_sim_time}],
        **common,
    )
    return [*publishers, rviz]
