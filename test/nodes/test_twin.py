# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The twin in this process, on a clock set by the test."""

from __future__ import annotations

import math
from pathlib import Path
import re
from types import SimpleNamespace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from ros_nodes import MILLISECOND
from rosgraph_msgs.msg import Clock as ClockMessage
from soft_throw_ros.configuration import ParameterError, rig_of, rig_values
from soft_throw_ros.configuration.interface import ENERGIES, FRAME, TWIN_SERVICES, TWIN_TOPICS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.nodes import recommendations
from soft_throw_ros.nodes.conversions import (
    msg_to_throw_result,
    msg_to_time,
    msg_to_values,
    time_to_msg,
    values_to_rig,
)
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.topics import create_service
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin import journal

PUBLISHED = [topic for topic in TWIN_TOPICS if not topic.is_input]
NUMBERS = TWIN_TOPICS.ejection_time, TWIN_TOPICS.ejection_speed, TWIN_TOPICS.energy_transfer
NAME = '/thrown/twin'


@pytest.fixture(scope='module')
def thrown(module_ros: Any) -> SimpleNamespace:
    """Return a twin of its own name that has thrown once, and a listener from the start."""
    twin = module_ros.start_twin('-r', '__ns:=/thrown', throw__period=0.0)
    listener = module_ros.listen_to(twin)
    listener.listen(*PUBLISHED)
    twin.change(throw__max_events=1, uncertainty__wave_speed=0.6, uncertainty__mass=0.0)
    twin.settle()
    listener.trigger(TWIN_SERVICES.throw)
    twin.go(700)
    listener.hear(TWIN_TOPICS.throw_result, 2)
    listener.hear(TWIN_TOPICS.joint_states, 700)
    return SimpleNamespace(ros=module_ros, twin=twin, listener=listener, heard=listener.heard)


def test_every_tick_and_phase_has_a_message_with_its_stamp(thrown) -> None:
    messages, outputs = thrown.heard[TWIN_TOPICS.joint_states.name][:700], thrown.twin.outputs
    for step, (message, out) in enumerate(zip(messages, outputs[1:701], strict=True), 1):
        assert msg_to_time(message.header.stamp) == SECOND + step * MILLISECOND
        assert (*message.position, *message.velocity, *message.effort) == out.state
    first = messages[0]
    assert (first.header.frame_id, first.name) == (f'thrown/{FRAME}', ['plate', 'projectile'])
    states = [out.state for out in outputs[1:] if out.layer is not None]
    layers = thrown.listener.hear(TWIN_TOPICS.layer_joint_states, len(states))[:10]
    for message, state in zip(layers, states, strict=False):
        assert list(message.name) == [f'layer_{index:02d}' for index in range(64)]
        assert (np.diff(message.position) > 0.0).all()
        bottom = message.position[0], message.velocity[0], -message.effort[0]
        expected = state.plate_position, state.plate_velocity, state.plate_force
        assert bottom == pytest.approx(expected, abs=1e-9)
    stamps = [msg_to_time(message.header.stamp) for message in layers]
    assert set(np.diff(stamps)) == {20 * MILLISECOND}
    changes = [change for out in outputs for change in out.phases]
    messages = thrown.listener.hear(TWIN_TOPICS.phase_change, len(changes))
    phases = ['rest', 'contact', 'flight', 'landed', 'returning']
    assert [(phases[int(m.position[0])], msg_to_time(m.header.stamp)) for m in messages] == [
        (change.phase.value, change.stamp_ns) for change in changes
    ]


def test_both_results_have_documented_keys_and_the_stamps_of_their_events(thrown, result_keys):
    messages = thrown.heard[TWIN_TOPICS.throw_result.name]
    statuses = [message.status[0] for message in messages]
    assert [msg_to_throw_result(status) for status in statuses] == thrown.twin.results
    release, final = thrown.twin.results
    assert (release.stage, final.stage, final.ended_by) == ('release', 'final', 'max_events')
    assert (statuses[0].name, statuses[0].hardware_id) == (f'{NAME}: throw', NAME)
    names = result_keys | set(rig_values(Rig()))
    assert all(msg_to_values(status).keys() <= names for status in statuses)
    since = release.first.release_ns - release.start_ns
    assert since == pytest.approx(1e9 * release.first.ejection_time, abs=1.5)
    assert [msg_to_time(message.header.stamp) for message in messages] == [
        release.first.release_ns, SECOND + final.step * MILLISECOND
    ]


def test_latched_topics_reach_late_subscribers(thrown) -> None:
    def points_of(cloud: Any) -> Any:
        shape = cloud.height, cloud.width, len(cloud.fields)
        return np.frombuffer(bytes(cloud.data)).reshape(shape)

    late = thrown.ros.listen_to(thrown.twin)
    late.listen(*(topic for topic in PUBLISHED if topic.is_latched))
    assert [message.data for message in late.hear(TWIN_TOPICS.phase)] == ['rest']
    result = msg_to_throw_result(late.hear(TWIN_TOPICS.throw_result)[0].status[0])
    assert result.first.energy_transfer == pytest.approx(3.6366, abs=1e-4)
    for topic in NUMBERS:
        number = getattr(result.first, topic.name.rpartition('/')[2])
        assert late.hear(topic)[0].data == number
    (published,) = (out.throw_field() for out in thrown.twin.outputs if out.throw_field)
    (field,) = late.hear(TWIN_TOPICS.throw_field)
    t, y, strain = np.moveaxis(points_of(field), -1, 0)
    assert field.header.frame_id == f'thrown/{FRAME}'
    assert msg_to_time(field.header.stamp) == result.start_ns
    np.testing.assert_array_equal(strain, published.strain)
    np.testing.assert_array_equal(t, np.tile(published.times, (64, 1)).T)
    np.testing.assert_allclose(y, np.tile(np.linspace(0.0, 16.8e-3, 64), (200, 1)))
    (energies,) = late.hear(TWIN_TOPICS.throw_energies)
    assert [item.name for item in energies.fields] == list(ENERGIES)
    np.testing.assert_array_equal(points_of(energies)[0], published.energies)
    assert late.hear(TWIN_TOPICS.recommendation)[0].status[0].level == DiagnosticStatus.OK
    lines = [message.data for message in late.hear(TWIN_TOPICS.journal, 6)]
    assert 'throw' in [journal.decode(line)['kind'] for line in lines]


def test_log_sums_up_ten_seconds_and_warns_once_of_a_strain(ros, capfd) -> None:
    twin = ros.start_twin(throw__period=0.25, throw__max_events=1, rate__state=200.0)

    def lines(level: str, milliseconds: int = 1020) -> list[str]:
        twin.go(milliseconds)
        return re.findall(rf'.*\[{level}\].*: throw .*', capfd.readouterr().err)

    assert len(lines('INFO')) == 1
    assert lines('INFO', 8000) == []
    twin.ticker.counts['ticks_skipped'] += 3
    (line,) = lines('INFO', 2000)
    assert line.endswith('; 41 throws, 3 ticks skipped since the start')
    assert lines('WARN') == []
    twin.change(engine__amplitude=3e-3)
    (line,) = lines('WARN')
    assert 'exceeds the linear range of 15 %' in line
    assert lines('WARN') == []


def test_diagnostics_report_the_timing_and_pending_changes(thrown) -> None:
    thrown.twin.change(layer__thickness=0.01)

    def values(task: str, done: Any) -> Any:
        return msg_to_values(thrown.listener.status(
            TWIN_TOPICS.diagnostics, task, lambda item: done(msg_to_values(item))
        ))

    pending = {'pending': 2, 'layer.name': 'custom', 'layer.thickness': 0.01}
    assert values('parameters', lambda values: values['pending']) == pending
    timing = values('timing', lambda values: values['ticks'] == thrown.twin.session.step)
    assert timing['ticks_skipped'] == 0
    assert {'lateness_p99', 'compute_p50', 'scheduler'} <= timing.keys()


def test_throw_is_accepted_at_rest_and_has_numbers_if_it_releases(ros) -> None:
    throw, reset = TWIN_SERVICES.throw, TWIN_SERVICES.reset
    twin = ros.start_twin(throw__period=0.0, engine__amplitude=1e-5)
    listener = ros.listen_to(twin)
    listener.listen(*NUMBERS)
    for milliseconds, service, is_accepted in (
        (10, throw, True), (300, throw, False), (0, reset, True), (110, throw, True)
    ):
        twin.go(milliseconds)
        response = listener.trigger(service)
        assert response.success == is_accepted
        assert 'throw 1' in response.message or is_accepted
    twin.go(1)
    names = ['rest', 'contact', 'returning', 'rest', 'contact']
    assert [change.phase.value for out in twin.outputs for change in out.phases] == names
    assert all(math.isnan(listener.hear(topic)[0].data) for topic in NUMBERS)


def ask(twin: Any, **request: Any) -> Any:
    """Ask for another recommendation, and return it."""
    twin.change(**{f'recommendation__{name}': value for name, value in request.items()})
    return twin.settle().best


@pytest.mark.parametrize(('rig', 'request_', 'changed'), [
    ({'projectile__mass': 2e-3}, {'vary': 'thickness'}, 'layer.thickness'),
    ({'layer__thickness': 2e-3}, {'vary': 'library'}, 'layer.name'),
    ({'gravity': 0.0}, {'vary': 'motion'}, 'engine.motion_file'),
    ({'gravity': 9.0}, {'objective': 'aim', 'target_height': 0.2}, 'engine.amplitude'),
])
def test_recommendation_follows_a_change_is_applied_and_holds(
    ros, twin, listener, monkeypatch, tmp_path, rig, request_, changed
) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    listener.listen(TWIN_TOPICS.recommendation)
    twin.change(engine__amplitude=1.9e-3)
    twin.change(**rig)
    best, before = ask(twin, **request_), twin.parameters.settings
    status = listener.status(
        TWIN_TOPICS.recommendation, 'recommendation',
        lambda status: msg_to_values(status).get('ejection_speed') == best.ejection_speed,
    )
    assert values_to_rig(msg_to_values(status)) == rig_of(before)
    for name, value in twin.recommendation.results().items():
        assert twin.get_parameter(name).value == pytest.approx(value, nan_ok=True)
    assert listener.trigger(TWIN_SERVICES.apply_recommendation).success
    assert twin.parameters.settings[changed] != before[changed]
    if changed == 'engine.motion_file':
        path = Path(twin.parameters.settings[changed])
        assert path.parent == tmp_path / 'soft_throw'
        twin.change(engine__command=True)
    listener.trigger(TWIN_SERVICES.throw)
    twin.go(700)
    throw = twin.results[-1].first
    assert throw.energy_transfer == pytest.approx(best.energy_transfer, rel=1e-3)


def test_request_after_an_impossible_or_failed_one_is_answered(twin, listener, monkeypatch):
    twin.settle()
    listener.listen(TWIN_TOPICS.recommendation)
    with monkeypatch.context() as patch:
        patch.setattr(recommendations, 'solve_request', lambda *_, **__: 1 / 0)
        assert ask(twin, vary='thickness') is None
    assert 'ZeroDivisionError' in twin.recommendation.describe()
    assert ask(twin, objective='aim', target_height=0.2, max_strain=0.12) is None
    refused = listener.trigger(TWIN_SERVICES.apply_recommendation)
    assert (refused.success, 'takes an amplitude' in refused.message) == (False, True)
    error = DiagnosticStatus.ERROR, refused.message
    listener.status(
        TWIN_TOPICS.recommendation, 'recommendation', lambda s: (s.level, s.message) == error
    )
    assert math.isnan(twin.get_parameter('recommended.amplitude').value)
    with pytest.raises(ParameterError, match='command'):
        twin.change(engine__command=True)
    assert ask(twin, objective='peak', vary='wave_speed') is not None


def test_steps_follow_a_clock_topic_that_is_chosen_later_and_a_standstill_is_reported(ros) -> None:
    twin = ros.node(Twin, ros_args=('-p', 'throw.period:=0.2'))
    twin.parameters.apply({'use_sim_time': True})
    listener = ros.listen_to(twin)
    listener.listen(TWIN_TOPICS.joint_states, TWIN_TOPICS.diagnostics)
    clock = listener.create_publisher(ClockMessage, '/clock', 10)
    ros.spin_until(lambda: clock.get_subscription_count() > 0, '/clock')
    twin.ticker.start()
    messages = listener.heard[TWIN_TOPICS.joint_states.name]
    for now in (5000, 5001, 5100, 5350, 6000):  # [ms]
        clock.publish(ClockMessage(clock=time_to_msg(now * MILLISECOND)))
        listener.hear(TWIN_TOPICS.joint_states, now - 5000 + 1)
    status = listener.status(TWIN_TOPICS.diagnostics, 'timing', lambda s: '/clock' in s.message)
    assert status.level == DiagnosticStatus.WARN
    for now, count in ((6010, 1011), (100, 1012), (102, 1014)):  # and then it is set back
        clock.publish(ClockMessage(clock=time_to_msg(now * MILLISECOND)))
        listener.hear(TWIN_TOPICS.joint_states, count)
    assert [msg_to_time(message.header.stamp) for message in messages] == [
        time * MILLISECOND for time in (*range(5000, 6011), 100, 101, 102)
    ]
    counts = twin.ticker.counts
    assert (twin.session.throws, counts['clock_jumps'], counts['ticks_skipped']) == (5, 1, 0)


def test_service_with_a_defect_answers_and_a_value_without_type_is_refused(ros, capfd) -> None:
    node = ros.node(RunnableNode, 'any')
    create_service(node, TWIN_SERVICES.throw, lambda: str(1 // 0))
    listener = ros.listen_to(node)

    def ask(kind: Any, name: str, *parameters: Parameter) -> Any:
        client = listener.create_client(kind, f'/any/{name}')
        return ros.call(client, kind.Request(parameters=parameters))

    no_type = Parameter(name='use_sim_time', value=ParameterValue(type=250))
    good = Parameter(name='use_sim_time', value=ParameterValue(type=1, bool_value=False))
    (result,) = ask(SetParameters, 'set_parameters', good, no_type, good).results
    assert result.successful
    assert '250' in capfd.readouterr().err
    name = 'set_parameters_atomically'
    assert not ask(SetParametersAtomically, name, good, no_type).result.successful
    response = listener.trigger(TWIN_SERVICES.throw)
    assert (response.success, 'division' in response.message) == (False, True)
