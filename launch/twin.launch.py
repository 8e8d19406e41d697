# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Start a twin and, on request, a recorder, the Rerun viewer and RViz.

Examples
--------
``ros2 launch soft_throw_ros twin.launch.py namespace:=rig1 output:=my_bag use_rviz:=true``

"""

import os
from pathlib import Path

from ament_index_python.packages import (
    get_package_prefix,
    get_package_share_directory,
    PackageNotFoundError,
)
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

SHARE = Path(get_package_share_directory('soft_throw_ros'))


def _flag(name: str, description: str) -> DeclareLaunchArgument:
    """Return a boolean launch argument with the default false."""
    return DeclareLaunchArgument(
        name,
        default_value='false',
        choices=['true', 'false', 'True', 'False'],
        description=description,
    )


def _is_set(values: dict[str, str], *flags: str) -> bool:
    """Return whether one of some flags is true."""
    return any(values[flag].lower() == 'true' for flag in flags)


ARGUMENTS = (
    DeclareLaunchArgument(
        'params_file',
        default_value=str(SHARE / 'config/twin.yaml'),
        description='Parameter file of all nodes',
    ),
    DeclareLaunchArgument(
        'namespace', default_value='', description='Namespace of all nodes, one for each rig'
    ),
    DeclareLaunchArgument(
        'motion',
        default_value='',
        description='engine.motion of the twin; empty: the value of params_file',
    ),
    _flag('record', 'Record into a bag'),
    DeclareLaunchArgument(
        'output',
        default_value='',
        description='Path of the new bag, as of `ros2 bag record --output`; sets record:=true',
    ),
    DeclareLaunchArgument(
        'uri', default_value='', description='The same, by the name in the parameters of rosbag2'
    ),
    DeclareLaunchArgument(
        'folder',
        default_value='',
        description='Folder of bags with the time as name; empty: the value of params_file',
    ),
    DeclareLaunchArgument(
        'rerun',
        default_value='none',
        choices=['none', 'viewer', 'serve', 'file'],
        description='Live display: sink of the viewer',
    ),
    _flag('description', 'Publish the frames of the rig and its model, robot_description'),
    _flag('use_rviz', 'Start RViz with the model of the rig; sets description:=true'),
    _flag('rviz', 'The same as use_rviz'),
    _flag('use_sim_time', 'Follow /clock'),
)


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes that they select."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=_nodes)])


def _nodes(context: LaunchContext) -> list[Node]:
    """Check all arguments, then return the nodes, so that a refusal leaves no node running."""
    values = {
        argument.name: LaunchConfiguration(argument.name).perform(context)
        for argument in ARGUMENTS
    }
    if not Path(values['params_file']).is_file():
        raise RuntimeError(f'params_file:={values["params_file"]}: file not found')
    use_sim_time = _is_set(values, 'use_sim_time')
    common = {'namespace': values['namespace'], 'output': 'both'}
    parameters = [values['params_file'], {'use_sim_time': use_sim_time}]
    motion = [{'engine.motion': values['motion']}] if values['motion'] else []
    nodes = [_ours('twin', parameters=[*parameters, *motion], **common)]
    recording = _recording(values)
    if recording is not None:
        recorder = {**common, 'parameters': [*parameters, recording], 'on_exit': _on_recorder_exit}
        nodes.append(_ours('recorder', **recorder))
    if values['rerun'] != 'none':
        name = values['output'] or values['uri'] or str(Path(values['folder'], 'live'))
        display = {'sink': values['rerun'], 'file': f'{name}.rrd'}
        nodes.append(_ours('viewer', **common, parameters=[*parameters, display]))
    with_rviz = _is_set(values, 'use_rviz', 'rviz')
    if with_rviz:
        _check_installed('use_rviz', 'robot_state_publisher', 'rviz2')
    elif _is_set(values, 'description'):
        _check_installed('description', 'robot_state_publisher')
    else:
        return nodes
    namespace = values['namespace'].strip('/')
    prefix = f'{namespace}/' if namespace else ''
    nodes += _state_publishers(values['params_file'], prefix, common, use_sim_time=use_sim_time)
    if with_rviz:
        nodes.append(_rviz(prefix, common, use_sim_time=use_sim_time))
    return nodes


def _on_recorder_exit(event: ProcessExited, _context: LaunchContext) -> None:
    """End the launch with an error if the recorder fails, since nothing would be recorded."""
    if event.returncode:
        raise RuntimeError(f'the recorder has ended with exit code {event.returncode}')


def _recording(values: dict[str, str]) -> dict[str, str] | None:
    """Return the parameters of the recorder, or None without a recorder."""
    paths = {name: values[name] for name in ('output', 'uri') if values[name]}
    if len(paths) > 1:
        given = ' and '.join(f'{name}:={path}' for name, path in paths.items())
        raise RuntimeError(f'{given}: both name the bag; leave one of the two out')
    for name, path in paths.items():
        if Path(path).exists():
            raise RuntimeError(f'{name}:={path}: exists already, and no bag is overwritten')
    if not paths and not _is_set(values, 'record'):
        return None
    recording = {'folder': values['folder']} if values['folder'] else {}
    for path in paths.values():
        recording |= {'folder': str(Path(path).parent), 'name': Path(path).name}
    return recording


def _check_installed(argument: str, *packages: str) -> None:
    """Raise if packages are missing that an argument needs, with the command to install them."""
    missing = []
    for package in packages:
        try:
            get_package_prefix(package)
        except PackageNotFoundError:
            missing.append(package)
    if missing:
        distribution = os.environ.get('ROS_DISTRO', '$ROS_DISTRO')
        names = ' '.join(f'ros-{distribution}-{name.replace("_", "-")}' for name in missing)
        raise RuntimeError(
            f'{argument}:=true needs {" and ".join(missing)}: sudo apt install {names}'
        )


def _ours(name: str, **options: object) -> Node:
    """Return a node of this package with its default name."""
    return Node(package='soft_throw_ros', executable=name, name=name, **options)


def _state_publishers(
    params_file: str, prefix: str, common: dict[str, str], *, use_sim_time: bool
) -> list[Node]:
    """
    Return the publishers of the frames and of `robot_description`, in the sizes of the parameters.

    A robot_state_publisher subscribes to one topic. The layer and the bodies have a topic each,
    so there are two publishers of the same model.

    """
    from soft_throw_ros.configuration.robot_model import urdf_of_file  # imports numba

    model = urdf_of_file(
        (SHARE / 'urdf/soft_throw.urdf').read_text(),
        params_file,
        node=f'/{prefix}twin',
        frame_prefix=prefix,
    )
    parameters = [
        {
            'robot_description': ParameterValue(model, value_type=str),
            'publish_frequency': 100.0,
            'use_sim_time': use_sim_time,
        }
    ]
    return [
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


def _rviz(prefix: str, common: dict[str, str], *, use_sim_time: bool) -> Node:
    """Return RViz, with the frame of the rig as the fixed one."""
    return Node(
        package='rviz2',
        executable='rviz2',
        name='rviz',
        arguments=['-d', str(SHARE / 'rviz/soft_throw.rviz'), '-f', f'{prefix}rig'],
        parameters=[{'use_sim_time': use_sim_time}],
        **common,
    )
