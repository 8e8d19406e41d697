# SPDX-License-Identifier: Apache-2.0
from functools import partial
import math
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.msg import ParameterType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos_overriding_options import QoSOverridingOptions
from soft_throw_ros.configuration import files, LAYERS, ParameterError, RECORDER, Table, TWIN
from soft_throw_ros.nodes.parameters import NodeParameters
from std_msgs.msg import String
import yaml

THICKNESS_RULE = 'layer.thickness must be a number from 0.0005 to 0.1 m, got '


class Twin(Node):
    """A node that has parameters and nothing else."""

    def __init__(
        self, *, check: Any = lambda settings: None, table: Table = TWIN, **kwargs: Any
    ) -> None:
        super().__init__(table.node, **kwargs)
        self.changes: list[dict[str, Any]] = []
        arguments = kwargs.get('cli_args', ())
        self.watched = NodeParameters(
            self, table, self.changes.append, check=check, arguments=arguments
        )


@pytest.fixture
def twin(ros: Any) -> Twin:
    """Start a twin with the default settings."""
    return ros.node(Twin)


@pytest.fixture
def start(ros: Any) -> Any:
    """Start a twin with ROS arguments."""
    return lambda *ros_args, **kwargs: ros.node(Twin, ros_args=ros_args, **kwargs)


def unchanged(twin: Twin) -> bool:
    return not twin.changes and dict(twin.watched.settings) == TWIN.defaults()


def test_start_declares_the_whole_table(ros: Any, twin: Twin) -> None:
    client = ros.parameters(twin)
    assert twin.watched.settings == TWIN.defaults()
    for entry in TWIN.entries:
        value = client.get(entry.name)
        assert type(value) is (list if isinstance(entry.default, tuple) else type(entry.default))
        value = tuple(value) if isinstance(value, list) else value
        assert value == entry.default or (entry.is_result and math.isnan(value))


def test_descriptor_tells_tools_type_range_and_unit(ros: Any, twin: Twin) -> None:
    client = ros.parameters(twin)
    thickness = client.describe('layer.thickness')
    assert thickness.type == ParameterType.PARAMETER_DOUBLE
    assert thickness.description == 'Thickness L_s of the layer [m]'
    (limits,) = thickness.floating_point_range
    assert (limits.from_value, limits.to_value) == (0.5e-3, 0.1)
    (limits,) = client.describe('throw.max_events').integer_range
    assert (limits.from_value, limits.to_value) == (1, 1000)
    (limits,) = client.describe('throw.period').floating_point_range
    assert limits.from_value == 0.0
    motion = client.describe('engine.motion')
    assert motion.additional_constraints == "one of 'underdamped', 'harmonic', 'measured'"


def test_set_is_accepted_and_handed_on(ros: Any, twin: Twin) -> None:
    before = twin.watched.settings
    client = ros.parameters(twin)
    assert client.set(layer__thickness=0.01) == ['']
    assert twin.changes == [{'layer.thickness': 0.01, 'layer.name': 'custom'}]
    assert twin.watched.settings == {**TWIN.defaults(), **twin.changes[0]}
    assert client.get('layer.thickness') == 0.01
    assert client.get('layer.name') == 'custom'
    assert before == TWIN.defaults()


def test_set_takes_a_whole_number_for_a_double(ros: Any, twin: Twin) -> None:
    client = ros.parameters(twin)
    assert client.set(gravity=0) == ['']
    assert type(client.get('gravity')) is float
    assert twin.changes == [{'gravity': 0.0}]


def test_set_to_the_same_changes_nothing(ros: Any, twin: Twin) -> None:
    assert ros.parameters(twin).set(gravity=9.81) == ['']
    assert unchanged(twin)


@pytest.mark.parametrize(
    'value',
    [math.nan, math.inf, -math.inf, -0.01, 0.0, 0, 0.2, 'soft', True, [0.01], [1], ['a'], None],
)
def test_bad_value_is_refused_with_our_words(ros: Any, twin: Twin, value: Any) -> None:
    client = ros.parameters(twin)
    (reason,) = client.set(layer__thickness=value)
    assert reason.startswith(THICKNESS_RULE)
    quoted = reason.removeprefix(THICKNESS_RULE)
    assert quoted == repr(value) or (isinstance(value, list) and str(value[0]) in quoted)
    assert client.set_atomically(layer__thickness=value) == reason
    assert client.get('layer.thickness') == 0.0168
    assert client.describe('layer.thickness').type == ParameterType.PARAMETER_DOUBLE
    assert unchanged(twin)


@pytest.mark.parametrize(
    ('request_', 'reason'),
    [
        ({'layer__thicknes': 0.01}, 'did you mean layer.thickness?'),
        ({'engine__motion': 'sampled'}, "'measured', got 'sampled'"),
        ({'layer__loss_tangent': -0.02}, 'must be a number from 0 to 2, got -0.02'),
        ({'model': 'magic'}, "model must be one of 'travelling_wave', "),
        ({'throw__max_events': 2.0}, 'must be a whole number from 1 to 1000, got 2.0'),
        ({'recommended__thickness': 0.01}, 'is a result; set layer.thickness or call '
                                           '~/apply_recommendation'),
        ({'layer__name': 'gelatin_2.0mm', 'layer__thickness': 0.01}, 'is 0.002, got 0.01'),
        ({'engine__motion': 'harmonic', 'engine__damping_ratio': 0.1}, 'has no damping'),
        ({'recommendation__thickness_min': 0.02, 'recommendation__thickness_max': 0.01},
         'got 0.02 and 0.01'),
        ({'gravity': 1.0, 'layer__thickness': -1.0}, THICKNESS_RULE + '-1.0'),
        ({'use_sim_time': True, 'layer__thickness': -1.0}, THICKNESS_RULE + '-1.0'),
    ],
)  # fmt: skip
def test_bad_request_changes_nothing(
    ros: Any, twin: Twin, request_: dict[str, Any], reason: str
) -> None:
    client = ros.parameters(twin)
    assert reason in client.set_atomically(**request_)
    assert unchanged(twin)
    assert client.get('gravity') == 9.81
    assert client.get('use_sim_time') is False
    assert not twin.get_clock().ros_time_is_active


def test_twice_the_same_name_in_one_request_is_refused(twin: Twin) -> None:
    result = twin.set_parameters_atomically(
        [Parameter('gravity', value=1.0), Parameter('gravity', value=2.0)]
    )
    assert result.reason == 'gravity is given twice, 1.0 and 2.0'
    assert unchanged(twin)


def test_one_by_one_keeps_what_is_good(ros: Any, twin: Twin) -> None:
    reasons = ros.parameters(twin).set(gravity=1.0, layer__thickness=-1.0, time_scale=0.1)
    assert reasons == ['', THICKNESS_RULE + '-1.0', '']
    assert twin.changes == [{'gravity': 1.0}, {'time_scale': 0.1}]


def test_layer_name_sets_all_of_the_layer(ros: Any, twin: Twin) -> None:
    client = ros.parameters(twin)
    assert client.set(layer__thickness=0.01, layer__name='gelatin_5.6mm') == ['', '']
    assert client.get('layer.thickness') == 5.6e-3
    assert twin.watched.settings == {
        **TWIN.defaults(), 'layer.name': 'gelatin_5.6mm', **LAYERS['gelatin_5.6mm'],
    }  # fmt: skip


def test_set_accepts_what_is_not_ours(ros: Any, twin: Twin) -> None:
    assert ros.parameters(twin).set_atomically(use_sim_time=True, gravity=0.0) == ''
    assert twin.get_clock().ros_time_is_active
    assert twin.changes == [{'gravity': 0.0}]


def test_results_are_set_from_inside(ros: Any, twin: Twin) -> None:
    twin.watched.set_results({'thickness': 0.04, 'mass_ratio': 1})
    client = ros.parameters(twin)
    assert client.get('recommended.thickness') == 0.04
    assert client.get('recommended.mass_ratio') == 1.0
    assert math.isnan(client.get('recommended.wave_speed'))
    twin.watched.set_results({'wave_speed': 20.0})
    assert math.isnan(client.get('recommended.thickness'))
    assert unchanged(twin)
    with pytest.raises(ParameterError, match=r"no result is named 'thicknes', got 1\.0"):
        twin.watched.set_results({'thicknes': 1.0})


def test_apply_changes_all_or_nothing(twin: Twin) -> None:
    twin.watched.apply({'layer.thickness': 0.04, 'layer.wave_speed': 20})
    expected = {'layer.thickness': 0.04, 'layer.wave_speed': 20.0, 'layer.name': 'custom'}
    assert twin.changes == [expected]
    with pytest.raises(ParameterError, match=THICKNESS_RULE + '0.2'):
        twin.watched.apply({'layer.wave_speed': 10.0, 'layer.thickness': 0.2})
    assert twin.watched.settings == {**TWIN.defaults(), **expected}


def test_check_of_the_twin_can_refuse(ros: Any) -> None:
    def check(settings: Any) -> None:
        if settings['gravity'] == 0.0:
            raise ValueError(f'no gravity, got {settings["gravity"]}')

    twin = ros.node(partial(Twin, check=check))
    assert ros.parameters(twin).set(gravity=0, time_scale=2) == ['no gravity, got 0.0', '']
    assert twin.changes == [{'time_scale': 2.0}]
    with pytest.raises(ParameterError, match=r'^no gravity, got 0\.0$'):
        ros.node(Twin, ros_args=('-p', 'gravity:=0'), check=check)


def test_start_takes_arguments(start: Any) -> None:
    twin = start('-p', 'gravity:=0', '-p', 'layer.name:=gelatin_2.0mm', '-p', 'use_sim_time:=true')
    assert twin.watched.settings == {
        **TWIN.defaults(),
        'gravity': 0.0,
        'layer.name': 'gelatin_2.0mm',
        **LAYERS['gelatin_2.0mm'],
    }  # fmt: skip
    assert twin.get_parameter('gravity').value == 0.0
    assert twin.get_parameter('layer.thickness').value == 2.0e-3
    assert twin.get_clock().ros_time_is_active
    assert not twin.changes


def test_start_takes_the_installed_file_and_a_namespace(start: Any) -> None:
    path = str(files.default_file())
    twin = start('--params-file', path, '-p', 'layer.thickness:=0.01', '-r', '__ns:=/rig1')
    assert twin.watched.settings == {
        **TWIN.defaults(), 'layer.thickness': 0.01, 'layer.name': 'custom',
    }  # fmt: skip


def test_start_takes_qos_overrides(start: Any) -> None:
    twin = start('-p', 'qos_overrides./twin/text.publisher.depth:=7')
    options = QoSOverridingOptions.with_default_policies()
    twin.create_publisher(String, '~/text', 3, qos_overriding_options=options)
    assert twin.get_parameter('qos_overrides./twin/text.publisher.depth').value == 7


def test_start_takes_overrides_of_a_launching_program(ros: Any) -> None:
    twin = ros.node(Twin, parameter_overrides=[Parameter('gravity', value=1)])
    assert twin.watched.settings['gravity'] == 1.0


@pytest.mark.parametrize(
    ('rule', 'message'),
    [
        ('layer.thickness:=nan', 'got nan'),
        ('layer.thickness:=.inf', 'got inf'),
        ('layer.thickness:=-0.01', 'got -0.01'),
        ('layer.thickness:=0', 'got 0'),
        ('layer.thickness:=16.8', 'got 16.8'),
        ('layer.thickness:=soft', "got 'soft'"),
        ('layer.thickness:=[1, 2]', 'got '),
        ('layer.thicknes:=0.01', 'did you mean layer.thickness'),
        ('recommended.thickness:=0.01', 'is a result'),
        ('engine.motion:=sampled', "got 'sampled'"),
    ],
)
def test_bad_argument_is_one_line(start: Any, rule: str, message: str) -> None:
    with pytest.raises(ParameterError) as refused:
        start('-p', rule)
    assert str(refused.value).startswith(f'-p {rule}: ')
    assert message in str(refused.value)
    assert '\n' not in str(refused.value)


def test_contradicting_arguments_are_refused(start: Any) -> None:
    with pytest.raises(ParameterError, match=r'is 0\.002, got 0\.01'):
        start('-p', 'layer.name:=gelatin_2.0mm', '-p', 'layer.thickness:=0.01')


@pytest.mark.parametrize('pattern', ['/**', 'twin', '/twin', '/**/twin'])
def test_bad_file_is_named_with_the_line(start: Any, tmp_path: Path, pattern: str) -> None:
    path = tmp_path / 'bad.yaml'
    path.write_text(f'{pattern}:\n  ros__parameters:\n    layer:\n      thickness: -1\n')
    with pytest.raises(ParameterError) as refused:
        start('--params-file', str(path))
    assert str(refused.value) == f'{path}:4: {THICKNESS_RULE}-1'


def test_dump_of_a_running_twin_starts_another(ros: Any, start: Any, tmp_path: Path) -> None:
    first = start('-p', 'engine.motion:=harmonic', '-p', 'layer.density:=900')
    first.watched.set_results({'thickness': 0.04})
    values = {
        name: list(item.value) if item.type_ == Parameter.Type.DOUBLE_ARRAY else item.value
        for name, item in first._parameters.items()
    }
    path = tmp_path / 'dump.yaml'
    path.write_text(yaml.safe_dump({'/twin': {'ros__parameters': values}}))
    second = start('--params-file', str(path))
    assert second.watched.settings == first.watched.settings
    assert math.isnan(second.get_parameter('recommended.thickness').value)


@pytest.mark.parametrize(
    'text',
    ['1', '-1', '+1', '010', '08', '0x10', '1_000', '1.5', '.5', '5.', '2e-3', '1e5', '1E+5',
     '.inf', '-.inf', '+.inf', '.Inf', 'inf', '-inf', '.nan', '.NAN', 'nan', 'NaN', 'infinity',
     'yes', 'y', 'Y', 'n', 'on', 'Off', 'true', 'TRUE', 'tRUE', '~', 'null', 'soft', "'1.5'",
     '"yes"', "''", '1e', 'e5', '--1', '0b1', '0o7', '1 2', '[1, 2]', '[1.5]',
     '[a, b]', '1:2', '12:30:45', '2001-01-01', '1,5'],
)  # fmt: skip
def test_files_types_a_value_as_ros_does(ros: Any, tmp_path: Path, text: str) -> None:
    path = tmp_path / 'typed.yaml'
    path.write_text(f'typing:\n  ros__parameters:\n    a: {text}\n')
    arguments = ('--params-file', str(path))
    node = ros.node(
        partial(Node, 'typing', automatically_declare_parameters_from_overrides=True),
        ros_args=arguments,
    )
    theirs = node.get_parameter('a').value
    ours = files.select(files.read_arguments(['--ros-args', *arguments]), '/typing')['a'].value
    if isinstance(ours, list):
        assert list(theirs) == ours
    else:
        assert repr(theirs) == repr(ours)


def test_texts_lists_and_switches_are_parameters_too(ros) -> None:
    ros_args = ('-p', 'topics:=[/rig1, /rosout]', '-p', 'start:=false')
    recorder = ros.node(Twin, table=RECORDER, ros_args=ros_args)
    client = ros.parameters(recorder)
    assert list(client.get('topics')) == ['/rig1', '/rosout']
    assert client.get('start') is False
    assert client.set(topics=['/a', '/b'], name='bag', start=True, split__size=0) == [''] * 4
    assert recorder.watched.settings == {
        **RECORDER.defaults(), 'topics': ('/a', '/b'), 'name': 'bag', 'start': True,
    }  # fmt: skip
    assert list(client.get('topics')) == ['/a', '/b']
    refusals = client.set(topics=['rosout'], start=1, name=2, split__size=7)
    assert refusals[0].startswith('topics must be a list of texts, each beginning with /, got ')
    assert refusals[1:] == [
        'start must be true or false, got 1',
        'name must be a text, got 2',
        'split.size must be a whole number from 1e+06 to 1e+12 byte, or 0, got 7',
    ]
