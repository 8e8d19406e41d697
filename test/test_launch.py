# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Launch files, executed with replacements of the package launch, which is not on PyPI.

The replacements record the actions; launch itself is tested by hand, from its sources.
"""

from pathlib import Path
import runpy
import sys
from types import ModuleType, SimpleNamespace

import pytest
from soft_throw_ros.__main__ import EXECUTABLES
from soft_throw_ros.configuration import ParameterError
from soft_throw_ros.configuration.node_tables import RECORDER, VIEWER
from urdf_parser_py.urdf import URDF
import yaml

ROOT = Path(__file__).parents[1]
FILES = sorted(path.name for path in (ROOT / 'launch').glob('*.launch.py'))

pytestmark = pytest.mark.usefixtures('stand_ins')


class Recorded:
    """An action or a substitution with its arguments."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs

    @property
    def name(self):
        return self.args[0]

    def perform(self, context):
        return context[self.name]


@pytest.fixture
def stand_ins(monkeypatch):
    """Replace the modules of launch by recording classes with the same names."""
    kinds = {}

    def module(name, **values):
        replacement = ModuleType(name)
        replacement.__getattr__ = lambda kind: kinds.setdefault(kind, type(kind, (Recorded,), {}))
        vars(replacement).update(values)
        monkeypatch.setitem(sys.modules, name, replacement)

    for name in (
        'launch', 'launch.actions', 'launch.events.process', 'launch.substitutions',
        'launch_ros', 'launch_ros.actions', 'launch_ros.parameter_descriptions',
    ):
        module(name)
    module('ament_index_python')
    module(
        'ament_index_python.packages',
        get_package_share_directory=lambda _name: str(ROOT),
        get_package_prefix=lambda _name: str(ROOT),
        PackageNotFoundError=KeyError,
    )


def actions(name, kind):
    """Return the actions of a kind in a launch file, including those of groups."""
    description = runpy.run_path(str(ROOT / 'launch' / name))['generate_launch_description']()
    entries = [
        action
        for entry in description.args[0]
        for action in (entry.args[0] if type(entry).__name__ == 'GroupAction' else [entry])
    ]
    return [action for action in entries if type(action).__name__ == kind]


def description_of(node):
    """Return the parsed model of a robot_state_publisher."""
    text = node['parameters'][0]['robot_description'].args[0]
    return URDF.from_xml_string(text.encode())


def nodes(**arguments):
    """Return the nodes of twin.launch.py by executable."""
    values = defaults('twin.launch.py')
    assert set(arguments) <= set(values)
    (start,) = actions('twin.launch.py', 'OpaqueFunction')
    started = start.kwargs['function']({**values, **arguments})
    return {node.kwargs['executable']: node.kwargs for node in started}


def defaults(name):
    """Return the arguments of a launch file and their defaults."""
    declared = actions(name, 'DeclareLaunchArgument')
    return {action.name: action.kwargs['default_value'] for action in declared}


@pytest.mark.parametrize('name', FILES)
def test_named_files_arguments_and_executables_exist(name):
    arguments = defaults(name)
    assert set(arguments) - {'topic'} <= set(defaults('twin.launch.py'))
    assert Path(arguments.get('params_file', __file__)).is_file()
    for included in actions(name, 'IncludeLaunchDescription'):
        assert Path(included.name).is_file()
        assert 'launch_arguments' not in included.kwargs  # would override the user's
    for node in actions(name, 'Node'):
        assert node.kwargs['package'] == 'soft_throw_ros'
        assert node.kwargs['executable'] in EXECUTABLES


def test_twin_starts_alone_with_its_parameter_file():
    (twin,) = nodes(namespace='rig1').values()
    assert (twin['executable'], twin['name'], twin['namespace']) == ('twin', 'twin', 'rig1')
    path, values = twin['parameters']
    assert yaml.safe_load(Path(path).read_text())
    assert values == {'use_sim_time': False}


FIRST = {'folder': 'bags', 'name': 'first'}


@pytest.mark.parametrize(
    ('arguments', 'node', 'table', 'expected'),
    [
        ({'record': 'true'}, 'recorder', RECORDER, {}),
        ({'record': 'true', 'folder': 'bags'}, 'recorder', RECORDER, {'folder': 'bags'}),
        ({'output': 'bags/first', 'folder': 'other'}, 'recorder', RECORDER, FIRST),  # as rosbag2
        ({'uri': 'bags/first', 'folder': 'other'}, 'recorder', RECORDER, FIRST),
        ({'rerun': 'file'}, 'viewer', VIEWER, {'sink': 'file', 'file': 'live.rrd'}),
        ({'rerun': 'file', 'folder': 'a'}, 'viewer', VIEWER,
         {'sink': 'file', 'file': 'a/live.rrd'}),
        ({'rerun': 'viewer', 'output': 'a/b'}, 'viewer', VIEWER,
         {'sink': 'viewer', 'file': 'a/b.rrd'}),
    ],
)
def test_recorder_and_viewer_are_started_on_request(arguments, node, table, expected):
    started = nodes(**arguments)
    assert started[node]['parameters'][-1] == expected
    assert set(expected) <= set(table.by_name)
    assert ('recorder' in started) is (arguments.keys() & {'record', 'output', 'uri'} != set())
    assert ('viewer' in started) is ('rerun' in arguments)


@pytest.mark.parametrize('argument', ['rviz', 'use_rviz'])
@pytest.mark.parametrize(('namespace', 'frame'), [('', 'rig'), ('/rig1', 'rig1/rig')])
def test_rviz_shows_the_rig_of_the_namespace(argument, namespace, frame):
    started = nodes(namespace=namespace, **{argument: 'true'})
    (_, view, _, fixed_frame) = started['rviz2']['arguments']
    displays = yaml.safe_load(Path(view).read_text())['Visualization Manager']['Displays']
    assert 'rviz_default_plugins/RobotModel' in {display['Class'] for display in displays}
    assert fixed_frame == frame
    publisher = started['robot_state_publisher']
    assert publisher['remappings'] == [('joint_states', 'twin/layer/joint_states')]
    assert description_of(publisher).get_root() == frame


def test_description_has_the_sizes_of_the_twin_of_the_namespace(write):
    path = write(
        '/rig1/twin: {ros__parameters: {layer: {thickness: 0.03}}}\n'
        '/rig2/twin: {ros__parameters: {layer: {diameter: 0.02}}}\n'
    )
    started = nodes(description='true', namespace='rig2', params_file=str(path))
    assert set(started) == {'twin', 'robot_state_publisher'}
    robot = description_of(started['robot_state_publisher'])
    assert robot.link_map['rig2/layer_00'].visual.geometry.radius == 0.01
    assert robot.link_map['rig2/layer_00'].visual.geometry.length == pytest.approx(1.2e-3)


@pytest.mark.parametrize(
    ('arguments', 'error', 'message'),
    [
        ({'description': 'true', 'params_file': 'mine.yaml'}, ParameterError,
         r'mine\.yaml: layer\.thickness must be'),
        ({'params_file': 'nope.yaml'}, RuntimeError, r'params_file:=nope\.yaml'),
        ({'output': '.'}, RuntimeError, r'output:=\.: exists'),
        ({'output': 'a', 'uri': 'b'}, RuntimeError, 'output:=a and uri:=b'),
    ],
)
def test_bad_argument_is_refused_before_any_node_starts(
    write, tmp_path, monkeypatch, arguments, error, message
):
    write('twin: {ros__parameters: {layer.thickness: -1.0}}', 'mine.yaml')
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        nodes(**arguments)


def test_failure_of_the_recorder_ends_the_launch():
    on_exit = nodes(record='true')['recorder']['on_exit']
    on_exit(SimpleNamespace(returncode=0), None)
    with pytest.raises(RuntimeError, match='exit code 2'):
        on_exit(SimpleNamespace(returncode=2), None)


def test_true_and_false_may_begin_with_a_capital_letter():
    flags = dict.fromkeys(('record', 'description', 'use_sim_time'), 'True')
    started = nodes(**flags, rviz='False')
    assert set(started) == {'twin', 'recorder', 'robot_state_publisher'}
    assert started['twin']['parameters'][-1] == {'use_sim_time': True}
    for action in actions('twin.launch.py', 'DeclareLaunchArgument'):
        if action.name in flags:
            assert {'true', 'True', 'false', 'False'} <= set(action.kwargs['choices'])


def test_rig_and_calibrator_follow_the_clock_of_the_twin():
    declared = actions('loop.launch.py', 'Node') + actions('measured.launch.py', 'Node')
    assert [node.kwargs['executable'] for node in declared] == ['rig', *2 * ['calibrator']]
    for node in declared:
        path, values = node.kwargs['parameters']
        assert (path.name, values['use_sim_time'].name) == ('params_file', 'use_sim_time')


@pytest.mark.parametrize('argument', ['description', 'use_rviz'])
def test_missing_package_is_refused_with_its_name(monkeypatch, argument):
    monkeypatch.setenv('ROS_DISTRO', 'jazzy')
    installed = sys.modules['ament_index_python.packages']
    monkeypatch.setattr(installed, 'get_package_prefix', {}.__getitem__)  # there is none
    message = f'{argument}:=true .* apt install ros-jazzy-robot-state-publisher'
    with pytest.raises(RuntimeError, match=message):
        nodes(**{argument: 'true'})
