# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Launch files, the model of the rig, and layouts and groups for the programs of others.

Replacements of the package launch, which is not on PyPI, record the actions of launch files;
launch itself is tested by hand, from its sources.
"""

import itertools
import json
from pathlib import Path
import re
import runpy
import sys
from types import ModuleType, SimpleNamespace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from soft_throw_ros.__main__ import EXECUTABLES
from soft_throw_ros.configuration import files, ParameterError, TWIN
from soft_throw_ros.configuration.interface import (
    ARRAY,
    FRAME,
    JOINTS,
    LAYER_JOINTS,
    resolve,
    TWIN_TOPICS,
)
from soft_throw_ros.configuration.node_tables import RECORDER, VIEWER
from soft_throw_ros.configuration.robot_model import urdf_of_file
from urdf_parser_py.urdf import URDF
import yaml

ROOT = Path(__file__).parents[1]
FILES = sorted(path.name for path in (ROOT / 'launch').glob('*.launch.py'))
MODEL = (ROOT / 'urdf/soft_throw.urdf').read_text()

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

    class Module(ModuleType):

        def __getattr__(self, kind):
            return kinds.setdefault(kind, type(kind, (Recorded,), {}))

    for name in (
        'launch', 'launch.actions', 'launch.events.process', 'launch.substitutions',
        'launch_ros', 'launch_ros.actions', 'launch_ros.parameter_descriptions',
        'ament_index_python', 'ament_index_python.packages',
    ):
        monkeypatch.setitem(sys.modules, name, Module(name))
    installed = sys.modules['ament_index_python.packages']
    installed.get_package_share_directory = lambda _name: str(ROOT)
    installed.get_package_prefix = lambda _name: str(ROOT)
    installed.PackageNotFoundError = KeyError
    return installed


def actions(name, kind):
    """Return the actions of a kind in a launch file, including those of groups."""
    description = runpy.run_path(str(ROOT / 'launch' / name))['generate_launch_description']()
    entries = [
        action
        for entry in description.args[0]
        for action in (entry.args[0] if type(entry).__name__ == 'GroupAction' else [entry])
    ]
    return [action for action in entries if type(action).__name__ == kind]


def defaults(name):
    """Return the arguments of a launch file and their defaults."""
    declared = actions(name, 'DeclareLaunchArgument')
    return {action.name: action.kwargs['default_value'] for action in declared}


def parsed(model):
    return URDF.from_xml_string(model.encode())


def nodes(**arguments):
    """Return the nodes of twin.launch.py by executable."""
    values = defaults('twin.launch.py')
    assert set(arguments) <= set(values)
    (start,) = actions('twin.launch.py', 'OpaqueFunction')
    started = start.kwargs['function']({**values, **arguments})
    return {node.kwargs['executable']: node.kwargs for node in started}


@pytest.mark.parametrize('name', FILES)
def test_named_files_arguments_and_executables_exist(name):
    arguments = defaults(name)
    assert set(arguments) - {'topic'} <= set(defaults('twin.launch.py'))
    assert Path(arguments.get('params_file', __file__)).is_file()
    for included in actions(name, 'IncludeLaunchDescription'):
        assert Path(included.name).is_file()
        assert 'launch_arguments' not in included.kwargs  # would override the user's
    for node in actions(name, 'Node'):  # follows the clock of the twin
        assert node.kwargs['package'] == 'soft_throw_ros'
        assert node.kwargs['executable'] in EXECUTABLES
        path, values = node.kwargs['parameters']
        assert (path.name, values['use_sim_time'].name) == ('params_file', 'use_sim_time')


@pytest.mark.parametrize('is_set', [False, True])
def test_twin_starts_alone_or_with_all_that_is_true_with_a_capital_letter(is_set):
    flags = {'record': 'recorder', 'description': 'robot_state_publisher', 'use_sim_time': 'twin'}
    started = nodes(namespace='rig1', rviz='False', **dict.fromkeys(flags, str(is_set)))
    assert set(started) == (set(flags.values()) if is_set else {'twin'})
    twin = started['twin']
    assert (twin['executable'], twin['name'], twin['namespace']) == ('twin', 'twin', 'rig1')
    path, values = twin['parameters']
    assert yaml.safe_load(Path(path).read_text())
    assert values == {'use_sim_time': is_set}
    for action in actions('twin.launch.py', 'DeclareLaunchArgument'):
        if action.name in flags:
            assert {'true', 'True', 'false', 'False'} <= set(action.kwargs['choices'])


@pytest.mark.parametrize(
    ('arguments', 'node', 'expected'),
    [
        ({'record': 'true'}, 'recorder', {}),
        ({'record': 'true', 'folder': 'bags'}, 'recorder', {'folder': 'bags'}),
        ({'output': 'a/b', 'folder': 'c'}, 'recorder', {'folder': 'a', 'name': 'b'}),  # as rosbag2
        ({'uri': 'a/b', 'folder': 'c'}, 'recorder', {'folder': 'a', 'name': 'b'}),
        ({'rerun': 'file'}, 'viewer', {'sink': 'file', 'file': 'live.rrd'}),
        ({'rerun': 'file', 'folder': 'a'}, 'viewer', {'sink': 'file', 'file': 'a/live.rrd'}),
        ({'rerun': 'viewer', 'output': 'a/b'}, 'viewer', {'sink': 'viewer', 'file': 'a/b.rrd'}),
    ],
)
def test_recorder_and_viewer_are_started_on_request(arguments, node, expected):
    started = nodes(**arguments)
    assert started[node]['parameters'][-1] == expected
    assert set(expected) <= set({'recorder': RECORDER, 'viewer': VIEWER}[node].by_name)
    assert ('recorder' in started) is (arguments.keys() & {'record', 'output', 'uri'} != set())
    assert ('viewer' in started) is ('rerun' in arguments)


@pytest.mark.parametrize('argument', ['rviz', 'use_rviz'])
@pytest.mark.parametrize(('namespace', 'prefix'), [('', ''), ('/rig2', 'rig2/')])
def test_rviz_shows_the_rig_of_the_namespace_in_its_sizes(write, argument, namespace, prefix):
    path = write(
        '/rig1/twin: {ros__parameters: {layer: {diameter: 0.03}}}\n'
        f'{namespace}/twin: {{ros__parameters: {{layer: {{diameter: 0.02}}}}}}\n'
    )
    started = nodes(namespace=namespace, params_file=str(path), **{argument: 'true'})
    assert set(started) == {'twin', 'robot_state_publisher', 'rviz2'}
    (_, view, _, fixed_frame) = started['rviz2']['arguments']
    displays = yaml.safe_load(Path(view).read_text())['Visualization Manager']['Displays']
    assert 'rviz_default_plugins/RobotModel' in {display['Class'] for display in displays}
    publisher = started['robot_state_publisher']
    assert publisher['remappings'] == [('joint_states', 'twin/layer/joint_states')]
    robot = parsed(publisher['parameters'][0]['robot_description'].args[0])
    assert fixed_frame == robot.get_root() == f'{prefix}rig'
    assert robot.link_map[f'{prefix}layer_00'].visual.geometry.radius == 0.01


@pytest.mark.parametrize(
    ('arguments', 'error', 'message'),
    [
        ({'description': 'true', 'params_file': 'mine.yaml'}, ParameterError,
         r'mine\.yaml: layer\.thickness must be'),
        ({'params_file': 'nope.yaml'}, RuntimeError, r'params_file:=nope\.yaml'),
        ({'output': '.'}, RuntimeError, r'output:=\.: exists'),
        ({'output': 'a', 'uri': 'b'}, RuntimeError, 'output:=a and uri:=b'),
        ({'use_rviz': 'true'}, RuntimeError, 'use_rviz:=true .* apt install ros-jazzy-rviz2'),
    ],
)
def test_bad_argument_or_missing_package_is_refused_before_any_node_starts(
    write, tmp_path, monkeypatch, stand_ins, arguments, error, message
):
    monkeypatch.setenv('ROS_DISTRO', 'jazzy')
    stand_ins.get_package_prefix = {'robot_state_publisher': '/opt'}.__getitem__  # and no other
    write('twin: {ros__parameters: {layer.thickness: -1.0}}', 'mine.yaml')
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=message):
        nodes(**arguments)


def test_failure_of_the_recorder_ends_the_launch():
    on_exit = nodes(record='true')['recorder']['on_exit']
    on_exit(SimpleNamespace(returncode=0), None)
    with pytest.raises(RuntimeError, match='exit code 2'):
        on_exit(SimpleNamespace(returncode=2), None)


def test_joints_of_the_model_agree_with_the_twin_and_it_can_be_the_value_of_a_parameter():
    assert ' '.join(yaml.safe_load(MODEL).split()) == ' '.join(MODEL.split())
    robot = parsed(MODEL)
    assert robot.get_root() == FRAME
    names = tuple(joint.name for joint in robot.joints)
    assert names[:2] == JOINTS
    assert set(names[2:]) <= set(LAYER_JOINTS)
    assert {names[2], names[-1]} == {LAYER_JOINTS[0], LAYER_JOINTS[-1]}
    for joint in robot.joints:  # positions are heights above the plate at rest
        assert (joint.type, joint.parent, joint.origin) == ('prismatic', FRAME, None)
        assert joint.axis == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ('request_', 'thickness'),
    [
        ({}, 16.8e-3),
        ({'layer.thickness': 5.6e-3, 'layer.diameter': 0.02, 'projectile.length': 0.0163}, 5.6e-3),
        ({'layer.stack': '8e-3 19 1350, 20e-3 5 1000'}, 28e-3),
    ],
    ids=['default', 'layer', 'stack'],
)
def test_sizes_of_the_model_are_those_of_the_parameters(write, request_, thickness):
    settings = TWIN.defaults()
    settings |= TWIN.change(settings, request_)
    sized = parsed(urdf_of_file(MODEL, write(files.render(settings)), node='/twin'))
    assert [joint.name for joint in sized.joints] == [joint.name for joint in parsed(MODEL).joints]
    visuals = {link.name: link.visual for link in sized.links if link.visual is not None}
    diameter = settings['layer.diameter']
    plate, projectile = visuals['plate'], visuals['projectile']
    assert plate.origin.xyz == pytest.approx([0.0, 0.0, -0.5 * plate.geometry.length])
    assert 2.0 * plate.geometry.radius == 2.5 * diameter
    assert projectile.geometry.length == settings['projectile.length']
    assert projectile.origin.xyz == [0.0, 0.0, 0.5 * settings['projectile.length']]
    names = [name for name in LAYER_JOINTS if name in visuals]
    slices = [visuals[name] for name in names]
    assert {2.0 * item.geometry.radius for item in [projectile, *slices]} == {diameter}
    # At rest the slices fill the same part of every layer, from the plate to the top
    heights = [thickness * LAYER_JOINTS.index(name) / (len(LAYER_JOINTS) - 1) for name in names]
    middles = [z + item.origin.xyz[2] for z, item in zip(heights, slices, strict=True)]
    halves = [0.5 * item.geometry.length for item in slices]
    assert middles[0] - halves[0] == pytest.approx(0.0, abs=1e-12)
    assert middles[-1] + halves[-1] == pytest.approx(thickness)
    assert np.sum(halves) == pytest.approx(0.5 * thickness * 10.0 / 14.0)


def test_layouts_plot_numbers_of_topics_of_the_twin(result_keys):
    names = set()
    for topic in TWIN_TOPICS:
        name = resolve(topic.name, '/twin')
        for (number, joint), quantity in itertools.product(
            enumerate(topic.joints), topic.quantities
        ):
            names |= {f'{name}.{quantity}[{number}]', f'{name}/{joint}/{quantity}'}
        if topic.type == ARRAY:
            names |= {f'{name}.status[0].values[:]{{key=="{key}"}}.value' for key in result_keys}
            names |= {  # with hardware_id, name and key
                f'{name}//twin//twin: {task}/{key}'
                for key in result_keys for task in ('throw', 'recommendation')
            }
    panels = json.loads((ROOT / 'config/foxglove.json').read_text())['configById'].values()
    paths = {path['value'] for panel in panels for path in panel.get('paths', [])}
    curves = ET.parse(ROOT / 'config/plotjuggler.xml').iter('curve')
    assert paths | {curve.get('name') for curve in curves} <= names


@pytest.mark.parametrize(
    ('node', 'task'), [('twin', 'timing'), ('recorder', 'bag'), ('calibrator', 'identification')]
)
def test_diagnostics_are_grouped_in_every_namespace_by_the_kind_of_node(node, task):
    file = ROOT / 'config/diagnostic_aggregator.yaml'
    (parameters,) = yaml.safe_load(file.read_text()).values()
    values = parameters['ros__parameters'].items()
    groups = {key: value['regex'][0] for key, value in values if isinstance(value, dict)}
    for name in (f'/{node}', '/rig1/renamed', '/hall/rig1/t'):
        status = f'{name}: {task}'
        assert [key for key, regex in groups.items() if re.fullmatch(regex, status)] == [node]
