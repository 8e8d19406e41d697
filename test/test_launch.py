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
from soft_throw_ros.configuration.recorder import RECORDER, VIEWER
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
        get_package_prefix=get_package_prefix,
        PackageNotFoundError=KeyError,
    )
    return kinds


def get_package_prefix(name):
    """Raise for packages that are not installed."""
    if name in not_installed:
        raise KeyError(name)


not_installed = set()


def actions(name):
    """Return the actions of a launch file, including those of groups."""
    description = runpy.run_path(str(ROOT / 'launch' / name))['generate_launch_description']()
    return [
        action
        for entry in description.args[0]
        for action in (entry.args[0] if kind_of(entry) == 'GroupAction' else [entry])
    ]


def description_of(node):
    """Return the parsed model of a robot_state_publisher."""
    text = node['parameters'][0]['robot_description'].args[0]
    return URDF.from_xml_string(text.encode())


def kind_of(action):
    return type(action).__name__


def nodes(**arguments):
    """Return the nodes of twin.launch.py by executable."""
    values = defaults('twin.launch.py')
    assert set(arguments) <= set(values)
    started = actions('twin.launch.py')[-1].kwargs['function']({**values, **arguments})
    return {node.kwargs['executable']: node.kwargs for node in started}


def defaults(name):
    """Return the arguments of a launch file and their defaults."""
    return {
        action.name: action.kwargs['default_value']
        for action in actions(name)
        if kind_of(action) == 'DeclareLaunchArgument'
    }


@pytest.mark.parametrize('name', FILES)
def test_named_files_and_executables_exist(name):
    for action in actions(name):
        if kind_of(action) == 'DeclareLaunchArgument' and action.name == 'params_file':
            assert Path(action.kwargs['default_value']).is_file()
        if kind_of(action) == 'IncludeLaunchDescription':
            assert Path(action.name).is_file()
            assert 'launch_arguments' not in action.kwargs  # would override the user's
        if kind_of(action) == 'Node':
            assert action.kwargs['package'] == 'soft_throw_ros'
            assert action.kwargs['executable'] in EXECUTABLES


def test_twin_starts_alone_with_its_parameter_file():
    (twin,) = nodes(namespace='rig1').values()
    assert (twin['executable'], twin['name'], twin['namespace']) == ('twin', 'twin', 'rig1')
    path, values = twin['parameters']
    assert yaml.safe_load(Path(path).read_text())
    assert values == {'use_sim_time': False}


@pytest.mark.parametrize('folder', ['', 'bags'])
def test_recorder_and_viewer_are_started_on_request(folder):
    recorder = nodes(folder=folder, record='true')['recorder']
    assert recorder['parameters'][-1] == ({'folder': folder} if folder else {})
    started = nodes(folder=folder, rerun='file')
    assert 'recorder' not in started
    display = started['viewer']['parameters'][-1]
    assert display == {'sink': 'file', 'file': str(Path(folder, 'live.rrd'))}
    assert set(display) <= set(VIEWER.by_name)
    assert nodes(output='a/b', rerun='viewer')['viewer']['parameters'][-1]['file'] == 'a/b.rrd'


def test_one_path_of_a_bag_starts_the_recorder_as_in_rosbag2():
    for name in ('output', 'uri'):
        recording = nodes(folder='other', **{name: 'bags/first'})['recorder']['parameters'][-1]
        assert recording == {'folder': 'bags', 'name': 'first'}
        assert set(recording) <= set(RECORDER.by_name)
    with pytest.raises(RuntimeError, match='output:=a and uri:=b'):
        nodes(output='a', uri='b')


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


def test_description_has_the_sizes_of_the_twin_of_the_namespace(tmp_path):
    path = tmp_path / 'two_rigs.yaml'
    path.write_text(
        '/rig1/twin: {ros__parameters: {layer: {thickness: 0.03}}}\n'
        '/rig2/twin: {ros__parameters: {layer: {diameter: 0.02}}}\n'
    )
    started = nodes(description='true', namespace='rig2', params_file=str(path))
    assert set(started) == {'twin', 'robot_state_publisher'}
    robot = description_of(started['robot_state_publisher'])
    assert robot.link_map['rig2/layer_00'].visual.geometry.radius == 0.01
    assert robot.link_map['rig2/layer_00'].visual.geometry.length == pytest.approx(1.2e-3)


def test_description_of_a_refused_parameter_is_refused_with_its_file(tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text('twin:\n  ros__parameters:\n    layer:\n      thickness: -1.0\n')
    with pytest.raises(ParameterError, match=r'mine\.yaml: layer\.thickness must be'):
        nodes(description='true', params_file=str(path))


def test_bag_that_exists_is_refused_before_any_node_starts(tmp_path):
    with pytest.raises(RuntimeError, match=f'output:={tmp_path}: exists'):
        nodes(output=str(tmp_path))


def test_failure_of_the_recorder_ends_the_launch():
    on_exit = nodes(record='true')['recorder']['on_exit']
    on_exit(SimpleNamespace(returncode=0), None)
    with pytest.raises(RuntimeError, match='exit code 2'):
        on_exit(SimpleNamespace(returncode=2), None)


@pytest.mark.parametrize('true', ['true', 'True'])
def test_true_and_false_may_begin_with_a_capital_letter(true):
    flags = dict.fromkeys(('record', 'description', 'use_sim_time'), true)
    started = nodes(**flags, rviz='False')
    assert set(started) == {'twin', 'recorder', 'robot_state_publisher'}
    assert started['twin']['parameters'][-1] == {'use_sim_time': True}
    for action in actions('twin.launch.py'):
        if kind_of(action) == 'DeclareLaunchArgument' and action.name in flags:
            assert {true, 'false', 'False'} <= set(action.kwargs['choices'])


@pytest.mark.parametrize('name', FILES)
def test_every_launch_file_declares_only_arguments_of_twin_launch(name):
    assert set(defaults(name)) - {'topic'} <= set(defaults('twin.launch.py'))


def test_rig_and_calibrator_follow_the_clock_of_the_twin():
    started = [*actions('loop.launch.py'), *actions('measured.launch.py')]
    declared = [action.kwargs for action in started if kind_of(action) == 'Node']
    assert [node['executable'] for node in declared] == ['rig', 'calibrator', 'calibrator']
    for node in declared:
        path, values = node['parameters']
        assert (path.name, values['use_sim_time'].name) == ('params_file', 'use_sim_time')


def test_missing_parameter_file_is_refused_before_any_node_starts():
    with pytest.raises(RuntimeError, match=r'params_file:=nope\.yaml'):
        nodes(params_file='nope.yaml')


@pytest.mark.parametrize('argument', ['description', 'use_rviz'])
def test_missing_package_is_refused_with_its_name(monkeypatch, argument):
    monkeypatch.setenv('ROS_DISTRO', 'jazzy')
    monkeypatch.setattr(sys.modules[__name__], 'not_installed', {'robot_state_publisher'})
    message = rf'{argument}:=true .* apt install ros-jazzy-robot-state-publisher$'
    with pytest.raises(RuntimeError, match=message):
        nodes(**{argument: 'true'})
