# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The twin in this process, on a clock set by the test."""

from __future__ import annotations

import io
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from soft_throw_ros.configuration import ParameterError, rig_of, rig_values
from soft_throw_ros.configuration.interface import (
    ENERGIES,
    FRAME,
    TWIN_SERVICES,
    TWIN_TOPICS,
)
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.prediction import prediction_uncertainty, Uncertainties
from soft_throw_ros.nodes import twin as twin_module
from soft_throw_ros.nodes.conversions import (
    msg_to_throw_result,
    msg_to_time,
    msg_to_values,
    time_to_msg,
    values_to_rig,
)
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.topics import create_service, qos_profile
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.storage.cdr import stamp_of
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.sample_buffer import Sample
from std_srvs.srv import Trigger

PUBLISHED = [topic for topic in TWIN_TOPICS if not topic.is_input]
NUMBERS = TWIN_TOPICS.ejection_time, TWIN_TOPICS.ejection_speed, TWIN_TOPICS.energy_transfer
NAME = '/thrown/twin'
MILLISECOND = SECOND // 1000
HOUR = 3600 * SECOND


@pytest.fixture(scope='module')
def thrown(module_ros: Any) -> SimpleNamespace:
    """Return a twin that has thrown once, and a listener with all its messages since the start."""
    # Its own namespace keeps it, for the whole module, apart from the other twins
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
    messages = thrown.heard[TWIN_TOPICS.joint_states.name][:700]
    assert [msg_to_time(message.header.stamp) for message in messages] == [
        SECOND + step * MILLISECOND for step in range(1, 701)
    ]
    for message, outputs in zip(messages, thrown.twin.outputs[1:], strict=False):
        assert (*message.position, *message.velocity, *message.effort) == outputs.state
    assert list(messages[0].name) == ['plate', 'projectile']
    states = [out.state for out in thrown.twin.outputs[1:] if out.layer is not None]
    layers = thrown.listener.hear(TWIN_TOPICS.layer_joint_states, len(states))
    for message, state in zip(layers[:10], states, strict=False):
        assert list(message.name) == [f'layer_{index:02d}' for index in range(64)]
        assert message.position[0] == pytest.approx(state.plate_position, abs=1e-6)
        assert (np.diff(message.position) > 0.0).all()
        assert message.velocity[0] == pytest.approx(state.plate_velocity, abs=1e-9)
        assert message.effort[0] == pytest.approx(-state.plate_force, abs=1e-9)
    stamps = [msg_to_time(message.header.stamp) for message in layers[:10]]
    assert set(np.diff(stamps)) == {20 * MILLISECOND}
    changes = [change for out in thrown.twin.outputs for change in out.phases]
    messages = thrown.listener.hear(TWIN_TOPICS.phase_change, len(changes))
    phases = ['rest', 'contact', 'flight', 'landed', 'returning']
    assert [(phases[int(m.position[0])], msg_to_time(m.header.stamp)) for m in messages] == [
        (change.phase.value, change.stamp_ns) for change in changes
    ]


def test_publishers_have_the_qualities_of_the_table_and_headers_name_the_frame(thrown) -> None:
    for topic in PUBLISHED:
        (info,) = thrown.listener.get_publishers_info_by_topic(topic.at(NAME).name)
        offered = info.qos_profile.durability, info.qos_profile.reliability
        expected = qos_profile(topic)
        assert offered == (expected.durability, expected.reliability), topic
        assert info.topic_type == topic.type
        for message in thrown.heard[topic.name][:1]:
            assert not hasattr(message, 'header') or message.header.frame_id == f'thrown/{FRAME}'


def test_results_of_both_stages_have_uncertainties_and_the_stamps_of_their_events(
    thrown, result_keys
) -> None:
    messages = thrown.heard[TWIN_TOPICS.throw_result.name]
    statuses = [message.status[0] for message in messages]
    assert [msg_to_throw_result(status) for status in statuses] == thrown.twin.results
    release, final = thrown.twin.results
    assert (release.stage, final.stage, final.ended_by) == ('release', 'final', 'max_events')
    assert (statuses[0].name, statuses[0].hardware_id) == (f'{NAME}: throw', NAME)
    names = result_keys | set(rig_values(Rig()))
    assert all(msg_to_values(status).keys() <= names for status in statuses)
    values = msg_to_values(statuses[1])
    expected = prediction_uncertainty(Rig(), Uncertainties(wave_speed=0.6, mass=0.0))
    assert {name: values[f'uncertainty.{name}'] for name in expected.values()} == expected.values()
    assert expected.energy_transfer.low < values['energy_transfer'] < expected.energy_transfer.high
    since = release.first.release_ns - release.start_ns
    assert since == pytest.approx(1e9 * release.first.ejection_time, abs=1.5)
    assert [msg_to_time(message.header.stamp) for message in messages] == [
        release.first.release_ns, SECOND + final.step * MILLISECOND
    ]


def test_numbers_of_a_throw_without_a_release_are_nan(twin, listener) -> None:
    listener.listen(*NUMBERS)
    twin.change(engine__amplitude=1e-5)
    assert listener.trigger(TWIN_SERVICES.throw).message.startswith('throw 1: ')
    twin.go(300)
    listener.trigger(TWIN_SERVICES.reset)
    twin.go(10)
    assert all(math.isnan(listener.hear(topic)[0].data) for topic in NUMBERS)


def points_of(cloud: Any) -> Any:
    fields = len(cloud.fields)
    return np.frombuffer(bytes(cloud.data)).reshape(cloud.height, cloud.width, fields)


def test_latched_topics_reach_late_subscribers(thrown) -> None:
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
        printed = capfd.readouterr().err.splitlines()
        return [line for line in printed if f'[{level}]' in line and ': throw ' in line]

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

    def status(task: str, done: Any) -> Any:
        return thrown.listener.status(
            TWIN_TOPICS.diagnostics, task, lambda item: done(msg_to_values(item))
        )

    pending = status('parameters', lambda values: 'layer.thickness' in values)
    values = msg_to_values(pending)
    assert (values['layer.name'], values['layer.thickness']) == ('custom', 0.01)
    assert values['pending'] == len(values) - 1
    assert pending.hardware_id == NAME
    step = thrown.twin.session.step
    timing = msg_to_values(status('timing', lambda values: values['ticks'] == step))
    assert timing['ticks_skipped'] == 0
    assert {'lateness_p99', 'compute_p50', 'scheduler'} <= timing.keys()


def test_throw_is_accepted_at_rest_and_refused_in_flight(twin, listener) -> None:
    throw, reset = TWIN_SERVICES.throw, TWIN_SERVICES.reset
    for milliseconds, service, is_accepted in (
        (10, throw, True), (100, throw, False), (0, reset, True), (110, throw, True)
    ):
        twin.go(milliseconds)
        response = listener.trigger(service)
        assert response.success == is_accepted
        assert is_accepted or 'throw 1' in response.message
    twin.go(1)
    names = ['rest', 'contact', 'flight', 'returning', 'rest', 'contact']
    assert [change.phase.value for out in twin.outputs for change in out.phases] == names


def ask(twin: Any, **request: Any) -> Any:
    """Ask for another recommendation, and return it."""
    twin.change(**{f'recommendation__{name}': value for name, value in request.items()})
    return twin.settle().best


@pytest.mark.parametrize(
    ('rig', 'request_', 'changed'),
    [
        ({'projectile__mass': 2e-3}, {'vary': 'thickness'}, 'layer.thickness'),
        ({'layer__thickness': 2e-3}, {'vary': 'library'}, 'layer.name'),
        ({'gravity': 0.0}, {'vary': 'motion'}, 'engine.motion_file'),
        ({'gravity': 9.0}, {'objective': 'aim', 'target_height': 0.2}, 'engine.amplitude'),
    ],
)
def test_recommendation_follows_a_change_is_applied_and_holds(
    ros, twin, listener, monkeypatch, tmp_path, rig, request_, changed
) -> None:
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    listener.listen(TWIN_TOPICS.recommendation)
    for changes in ({'engine__amplitude': 1.9e-3}, rig):
        twin.change(**changes)
    best, before = ask(twin, **request_), twin.parameters.settings
    status = listener.status(
        TWIN_TOPICS.recommendation,
        'recommendation',
        lambda status: msg_to_values(status).get('ejection_speed') == best.ejection_speed,
    )
    assert values_to_rig(msg_to_values(status)) == rig_of(before)
    for name, value in twin.recommendation.results().items():
        assert twin.get_parameter(f'recommended.{name}').value == value
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


def test_request_after_one_that_failed_or_is_impossible_is_answered(
    twin, listener, monkeypatch
) -> None:
    twin.settle()
    listener.listen(TWIN_TOPICS.recommendation)
    with monkeypatch.context() as patch:
        patch.setattr(twin_module, 'recommend_for', lambda *_: 1 / 0)
        assert ask(twin, vary='thickness') is None
    assert 'ZeroDivisionError' in twin.recommendation.describe()
    assert ask(twin, objective='aim', target_height=0.2, max_strain=0.12) is None
    status = listener.status(
        TWIN_TOPICS.recommendation, 'recommendation', lambda s: 'takes an amplitude' in s.message
    )
    assert status.level == DiagnosticStatus.ERROR
    refused = listener.trigger(TWIN_SERVICES.apply_recommendation)
    assert (refused.success, refused.message) == (False, status.message)
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
    assert messages == []
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
    assert twin.session.throws == 5
    assert twin.ticker.counts['clock_jumps'] == 1
    assert twin.ticker.counts['ticks_skipped'] == 0


def test_two_twins_of_one_name_are_reported_by_both(ros, capfd) -> None:
    for _ in range(2):
        ros.start_twin()
    log = io.StringIO()
    ros.spin_until(
        lambda: log.write(capfd.readouterr().err)
        and log.getvalue().count('another node is named /twin') >= 2,
        'the errors of both twins',
    )


def test_clock_that_is_set_changes_stamps_and_skips_nothing(twin) -> None:
    twin.session.request_throw()
    for hours in (3, -1, 1):
        twin.clock.epoch += 1
        twin.advance(hours * HOUR)
        twin.go(50)
    counts = twin.ticker.counts
    assert (counts['clock_jumps'], counts['ticks_skipped']) == (3, 0)
    assert [outputs.step for outputs in twin.outputs] == list(range(len(twin.outputs)))
    stamps = [stamp_of(message.data) for message in twin.of(TWIN_TOPICS.joint_states)]
    jumps = np.diff(stamps)
    assert jumps[jumps != MILLISECOND].tolist() == [3 * HOUR, -HOUR, HOUR]


def test_participant_that_is_lost_and_comes_back_is_heard_again(ros) -> None:
    twin = ros.start_twin(engine__motion='measured')
    for count in (1, 2):
        others = type(ros)(ros.domain_id)  # a participant of its own
        sensors = others.sensors_of()
        sample = Sample(twin.go(10).clock.time, 0.0, math.nan)
        ros.spin_until(
            lambda sensors=sensors, sample=sample, count=count: sensors.send(sample)
            or twin.measurement.read_messages()
            or twin.session.sample_counts.taken == count,
            'a sample',  # the twin may not know of the sender yet
        )
        others.close()


def test_service_with_a_defect_answers_and_a_value_without_type_is_refused(ros, capfd) -> None:
    create_service(ros.node(RunnableNode, 'any'), TWIN_SERVICES.throw, lambda: str(1 // 0))
    node = ros.node(Node, 'asking')

    def call(kind: Any, name: str, *parameters: Parameter) -> Any:
        request = kind.Request(parameters=parameters) if parameters else kind.Request()
        return ros.call(node.create_client(kind, f'/any/{name}'), request)

    no_type = Parameter(name='use_sim_time', value=ParameterValue(type=250))
    good = Parameter(name='use_sim_time', value=ParameterValue(type=1, bool_value=False))
    (result,) = call(SetParameters, 'set_parameters', good, no_type, good).results
    assert result.successful
    assert '250' in capfd.readouterr().err
    name = 'set_parameters_atomically'
    assert not call(SetParametersAtomically, name, good, no_type).result.successful
    response = call(Trigger, 'throw')
    assert not response.success
    assert 'division' in response.message
