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
The launch files, without launch, which no wheel brings: stand-ins note down what they ask for.

What launch itself makes of them is tried by hand on a ROS machine.
"""

from pathlib import Path
import runpy
import sys
from types import ModuleType

import pytest
from soft_throw_ros.__main__ import EXECUTABLES
from soft_throw_ros.configuration.recorder import RECORDER
import yaml

ROOT = Path(__file__).parents[1]
FILES = sorted(path.name for path in (ROOT / 'launch').glob('*.launch.py'))


class Asked:
    """An action or a substitution, with what it was made of."""

    def __init__(self, *args, **kwargs):
        self.args, self.kwargs = args, kwargs

    @property
    def name(self):
        return self.args[0]

    def perform(self, context):
        return context[self.name]


@pytest.fixture
def stand_ins(monkeypatch):
    """Have launch files import classes of this file, each by its name in launch."""
    kinds = {}

    def module(name, **values):
        made = ModuleType(name)
        made.__getattr__ = lambda kind: kinds.setdefault(kind, type(kind, (Asked,), {}))
        vars(made).update(values)
        monkeypatch.setitem(sys.modules, name, made)

    for name in (
        'launch', 'launch.actions', 'launch.substitutions',
        'launch_ros', 'launch_ros.actions', 'launch_ros.parameter_descriptions',
    ):
        module(name)
    module('ament_index_python')
    module('ament_index_python.packages', get_package_share_directory=lambda _name: str(ROOT))
    return kinds


def actions(name):
    """Return what a launch file describes."""
    description = runpy.run_path(str(ROOT / 'launch' / name))['generate_launch_description']()
    return description.args[0]


def kind_of(action):
    return type(action).__name__


def nodes(**asked):
    """Return the nodes that twin.launch.py starts, by executable."""
    described = actions('twin.launch.py')
    values = {
        action.name: action.kwargs['default_value']
        for action in described
        if kind_of(action) == 'DeclareLaunchArgument'
    }
    assert set(asked) <= set(values)
    started = described[-1].kwargs['function']({**values, **asked})
    return {node.kwargs['executable']: node.kwargs for node in started}


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize('name', FILES)
def test_files_and_executables_that_are_named_are_there(name):
    for action in actions(name):
        if kind_of(action) == 'DeclareLaunchArgument' and action.name == 'params_file':
            assert Path(action.kwargs['default_value']).is_file()
        if kind_of(action) == 'IncludeLaunchDescription':
            given = dict(action.kwargs['launch_arguments'])
            assert Path(action.name).is_file()
            named = given.get('params_file', __file__)
            assert not isinstance(named, str) or Path(named).is_file()
            assert set(given) <= {
                each.name
                for each in actions(Path(action.name).name)
                if kind_of(each) == 'DeclareLaunchArgument'
            }
        if kind_of(action) == 'Node':
            assert action.kwargs['package'] == 'soft_throw_ros'
            assert action.kwargs['executable'] in EXECUTABLES


@pytest.mark.usefixtures('stand_ins')
def test_twin_comes_alone_with_its_file_of_parameters():
    (twin,) = nodes(namespace='rig1').values()
    assert (twin['executable'], twin['name'], twin['namespace']) == ('twin', 'twin', 'rig1')
    path, values = twin['parameters']
    assert yaml.safe_load(Path(path).read_text())
    assert values == {'use_sim_time': False}


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize(
    ('asked', 'storage', 'sink'),
    [
        ({'record': 'true'}, 'mcap', 'none'),
        ({'rerun': 'viewer'}, 'none', 'viewer'),
        ({'record': 'true', 'rerun': 'file'}, 'mcap', 'file'),
    ],
)
def test_recorder_records_and_shows_what_is_asked(asked, storage, sink):
    recording = nodes(folder='bags', **asked)['recorder']['parameters'][-1]
    assert recording == {'storage': storage, 'folder': 'bags', 'rerun.sink': sink}
    assert set(recording) <= set(RECORDER.by_name)


@pytest.mark.usefixtures('stand_ins')
@pytest.mark.parametrize(('namespace', 'frame'), [('', 'rig'), ('/rig1', 'rig1/rig')])
def test_rviz_shows_the_rig_of_the_namespace(namespace, frame):
    started = nodes(rviz='true', namespace=namespace)
    (_, view, _, shown) = started['rviz2']['arguments']
    displays = yaml.safe_load(Path(view).read_text())['Visualization Manager']['Displays']
    assert 'rviz_default_plugins/RobotModel' in {display['Class'] for display in displays}
    assert shown == frame
    publisher = started['robot_state_publisher']
    assert publisher['remappings'] == [('joint_states', 'twin/layer/joint_states')]
    assert publisher['parameters'][0]['frame_prefix'] == frame.removesuffix('rig')
