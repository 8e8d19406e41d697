# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The table of parameters as parameters of a node."""

import math
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from soft_throw_ros.configuration import ParameterError, RECORDER, TWIN
from soft_throw_ros.nodes.parameters import NodeParameters
from soft_throw_ros.nodes.process import RunnableNode
import yaml


class Watched(RunnableNode):
    """A node with parameters only."""

    def __init__(self, *, table: Any = TWIN, check: Any = lambda *_: None, **kwargs: Any) -> None:
        super().__init__(table.node, **kwargs)
        self.table, self.changes = table, list[dict[str, Any]]()
        self.parameters = NodeParameters(
            self, table, self.changes.append, check=check, arguments=kwargs['cli_args']
        )


@pytest.fixture
def start(ros: Any) -> Any:
    return lambda *ros_args, **kwargs: ros.node(Watched, ros_args=ros_args, **kwargs)


@pytest.fixture
def twin(start: Any) -> Watched:
    return start()


class Client(AsyncParameterClient):
    """Requests to the parameter services of a node from another node, `a__b` for a.b."""

    def __init__(self, ros: Any, node: Node) -> None:
        super().__init__(ros.node(Node, 'client'), node.get_fully_qualified_name())
        ros.spin_until(self.services_are_ready, 'parameter services')
        self._ros = ros

    def set(self, *, atomically: bool = False, **values: Any) -> list[str]:  # noqa: A003
        """Set parameters, and return the reasons, '' for accepted ones."""
        items = [Parameter(name.replace('__', '.'), value=each) for name, each in values.items()]
        request = self.set_parameters_atomically if atomically else self.set_parameters
        response = self._ros.result(request(items))
        results = [response.result] if atomically else response.results
        assert all(result.successful == (not result.reason) for result in results)
        return [result.reason for result in results]


@pytest.fixture
def client(ros: Any, twin: Watched) -> Client:
    return Client(ros, twin)


def test_start_declares_the_whole_table_with_types_ranges_and_units(twin, start) -> None:
    for node in (twin, start(table=RECORDER)):
        for entry in node.table.entries:
            value = node.get_parameter(entry.name).value
            value = value if isinstance(value, (str, float, int)) else tuple(value)
            assert type(value) is type(entry.default)
            assert value == entry.default or (entry.is_result and math.isnan(value))
    assert '[m]' in twin.describe_parameter('layer.thickness').description
    for name, low, high in (
        ('layer.thickness', 5e-4, 0.1), ('throw.max_events', 1, 1000), ('throw.period', 0.0, 3600)
    ):
        described = twin.describe_parameter(name)
        (limits,) = (*described.floating_point_range, *described.integer_range)
        assert (limits.from_value, limits.to_value) == (low, high)
    assert "'harmonic'" in twin.describe_parameter('engine.motion').additional_constraints
    assert 'gelatin_2.0mm' in twin.describe_parameter('layer.name').additional_constraints


def test_value_is_accepted_as_every_parameter_type(twin, client) -> None:
    expected = TWIN.defaults()
    for name, request, value in (
        ('layer.thickness', 0.01, 0.01),
        ('gravity', 0, 0.0),
        ('measured.position_noise', '7e-06', 7e-6),  # as a tool that reads YAML 1.1 gives it
        ('throw.max_events', '7', 7),
        ('recommendation.masses', ['1e-3', '2e-3'], (1e-3, 2e-3)),
    ):
        before = twin.parameters.settings
        assert client.set(**{name.replace('.', '__'): request}) == ['']
        changes = {name: value, **({'layer.name': 'custom'} if name == 'layer.thickness' else {})}
        assert (twin.changes[-1], before) == (changes, expected)
        expected |= changes
        assert twin.parameters.settings == expected
        received = twin.get_parameter(name).value
        assert (tuple(received) if isinstance(value, tuple) else received) == value


def test_bad_value_is_refused_in_short_with_its_name_and_value(twin, client) -> None:
    for value in (math.nan, math.inf, -0.01, 0, 'soft', True, ['a'], None):
        (reason,) = client.set(layer__thickness=value)
        assert reason.startswith('layer.thickness must be ')
        assert repr(value) in reason or str(value[0]) in reason
        assert client.set(atomically=True, layer__thickness=value) == [reason]
    assert twin.get_parameter('layer.thickness').value == 0.0168
    for request, reason in (
        ({'layer__thicknes': 0.01}, "no parameter of the twin is named 'layer.thicknes'"),
        ({'gravity': 1.0, 'layer__thickness': -1.0}, '-1.0'),
        ({'use_sim_time': True, 'layer__thickness': -1.0}, '-1.0'),
        ({'joint_names__plate': 'carriage'}, "read-only, set at the start; got 'carriage'"),
        ({'layer__stack': '8e-3 gelatin,' * 80_000}, '...'),
        ({'x' * 100_000: 1.0}, '...'),
        ({'gravity': [0.001] * 1_000_000}, '...'),
    ):
        (given,) = client.set(atomically=True, **request)
        assert reason in given
        assert len(given) < 300
    assert not twin.get_parameter('use_sim_time').value
    assert (twin.changes, twin.parameters.settings) == ([], TWIN.defaults())


def test_check_of_the_node_can_refuse(ros) -> None:
    def check(settings: Any, former: Any) -> int:
        if settings['gravity'] == 0.0:
            raise ValueError(f'no gravity, got {settings["gravity"]}')
        return (former or 0) + 1

    twin = ros.node(Watched, check=check)
    assert Client(ros, twin).set(gravity=0, time_scale=2) == ['no gravity, got 0.0', '']
    assert twin.changes == [{'time_scale': 2.0}]
    assert twin.parameters.checked == 2  # at the start, and for the accepted change
    with pytest.raises(ParameterError, match=r'^no gravity, got 0\.0$'):
        ros.node(Watched, ros_args=('-p', 'gravity:=0'), check=check)


def test_dump_with_results_starts_another_twin_below_arguments_and_is_loaded(
    ros, start, tmp_path
) -> None:
    first = start('-p', 'engine.motion:=harmonic', '-p', 'measured.position_noise:=6.0e-06')
    first.parameters.set_results({'thickness': 0.04, 'density': 1})
    values = {name: first.get_parameter(name).value for name in TWIN.by_name}
    assert (values['recommended.density'], values['recommended.layer']) == (1.0, '')
    assert math.isnan(values['recommended.wave_speed'])
    path = tmp_path / 'dump.yaml'
    path.write_text(yaml.safe_dump({'/twin': {'ros__parameters': values}}))
    second = start(
        '--params-file', str(path), '-p', 'gravity:=0', '-p', 'layer.thickness:=0.01',
        '-p', 'use_sim_time:=true', '-p', 'qos_overrides./twin/text.publisher.depth:=7',
    )
    own = {'gravity': 0.0, 'layer.thickness': 0.01, 'layer.name': 'custom'}
    assert second.parameters.settings == {**first.parameters.settings, **own}
    assert second.get_clock().ros_time_is_active
    assert math.isnan(second.get_parameter('recommended.thickness').value)
    third = start('-r', '__node:=third')
    # as `ros2 param load` does, which reads YAML 1.1
    loaded = {**values, 'measured.position_noise': '6e-06', 'recommended.wave_speed': 'nan'}
    reasons = dict(zip(loaded, Client(ros, third).set(**loaded), strict=True))
    refused = {name: reason for name, reason in reasons.items() if reason}
    assert refused.keys() == {'recommended.thickness', 'recommended.density'}
    assert 'read-only, set by the twin; got 0.04' in refused['recommended.thickness']
    assert third.parameters.settings == first.parameters.settings
