# SPDX-License-Identifier: Apache-2.0
"""The node in this process; its clock, and when it moves, are the test's."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from rcl_interfaces.msg import Log
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock as ClockMessage
from soft_throw_ros.configuration import ParameterError, rig_of, TWIN
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.objective import Limits, Robust, Versatile
from soft_throw_ros.design.recommendation import recommend
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties
from soft_throw_ros.nodes import topics
from soft_throw_ros.nodes.conversions import (
    msg_to_array,
    msg_to_throw_result,
    msg_to_time,
    msg_to_values,
    time_to_msg,
    values_to_rig,
)
from soft_throw_ros.nodes.twin import Twin
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.replay import replay
from soft_throw_ros.twin.results import Outputs
from soft_throw_ros.twin.session import Session
from std_srvs.srv import Trigger

SECOND = 1_000_000_000
MILLISECOND = SECOND // 1000


class GivenClock:
    """A clock that shows what it is told to."""

    epoch = 0
    max_catch_up = 1000 * SECOND
    tolerance = SECOND

    def __init__(self) -> None:
        self.time = SECOND

    def now(self) -> int:
        return self.time

    def wait_until(self, deadline: int) -> None:
        raise AssertionError(f'nobody waits in this test, but until {deadline}')


class Driven(Twin):
    """A twin that goes where the test sends it, and remembers what came out."""

    def __init__(self, **kwargs: Any) -> None:
        self.clock = GivenClock()
        self.outputs: list[Outputs] = []
        super().__init__(system_clock=self.clock, **kwargs)
        self.ticker.run_due()  # the first step

    def _on_step(self, outputs: Outputs, due: int) -> None:
        self.outputs.append(outputs)
        super()._on_step(outputs, due)

    def go(self, milliseconds: int) -> None:
        """Let so much time pass, in moments of 10 ms."""
        end = self.clock.time + milliseconds * MILLISECOND
        while self.clock.time < end:
            self.clock.time = min(end, self.clock.time + 10 * MILLISECOND)
            self.ticker.run_due()


class Listener(Node):
    """Somebody who listens to a twin, from now on."""

    def __init__(self, ros: Any, twin: Node, **kwargs: Any) -> None:
        super().__init__('listener', **kwargs)
        self._ros = ros
        self._twin = twin
        self.heard: dict[str, list[Any]] = {}

    def listen(self, *listed: topics.Topic) -> None:
        """Take a topic, and wait until the twin knows."""
        for topic in listed:
            name = topic.name.replace('~', self._twin.get_fully_qualified_name())
            heard = self.heard.setdefault(topic.name, [])
            self.create_subscription(topic.type, name, heard.append, topic.qos)
            self._ros.spin_until(
                lambda name=name: (
                    self._twin.count_subscribers(name) > 0 and self.count_publishers(name) > 0
                ),
                name,
            )

    def hear(self, topic: topics.Topic, count: int = 1) -> list[Any]:
        """Wait for so many messages in all."""
        heard = self.heard[topic.name]
        self._ros.spin_until(lambda: len(heard) >= count, f'{count} messages on {topic.name}')
        return heard


@pytest.fixture
def twin(ros: Any) -> Driven:
    """Start a twin that throws only when asked."""
    return ros.node(Driven, ros_args=('-p', 'throw.period:=0.0'))


@pytest.fixture
def listener(ros: Any, twin: Driven) -> Listener:
    return ros.node(Listener, ros, twin)


def trigger(ros: Any, listener: Node, twin: Node, service: str) -> Trigger.Response:
    """Call a service of a twin."""
    name = service.replace('~', twin.get_fully_qualified_name())
    return ros.call(listener.create_client(Trigger, name), Trigger.Request())


# ticks


def matched(ros: Any, publisher: Any) -> None:
    ros.spin_until(lambda: publisher.get_subscription_count() > 0, publisher.topic_name)


def test_joint_states_come_once_per_tick_with_its_stamp(ros, twin, listener) -> None:
    listener.listen(topics.JOINT_STATES)
    matched(ros, twin._joint_states)
    trigger(ros, listener, twin, topics.THROW)
    twin.go(700)
    messages = listener.hear(topics.JOINT_STATES, 700)
    assert [msg_to_time(message.header.stamp) for message in messages] == [
        SECOND + step * MILLISECOND for step in range(1, 701)
    ]
    for message, outputs in zip(messages, twin.outputs[1:], strict=True):
        assert (*message.position, *message.velocity, *message.effort) == outputs.state
    assert list(messages[0].name) == ['plate', 'projectile']
    assert messages[0].header.frame_id == 'rig'
    assert max(message.position[1] for message in messages) > 0.1


def test_node_publishes_what_the_session_gives(ros, twin, listener) -> None:
    session = Session({**TWIN.defaults(), 'throw.period': 0.0})
    session.advance()
    trigger(ros, listener, twin, topics.THROW)
    session.request_throw()
    twin.go(500)
    assert [outputs.state for outputs in twin.outputs[1:]] == [
        session.advance().state for _ in range(500)
    ]


def test_fields_come_at_their_rate(ros, twin, listener) -> None:
    listener.listen(topics.STRAIN, topics.VELOCITY)
    matched(ros, twin._strain)
    matched(ros, twin._velocity)
    trigger(ros, listener, twin, topics.THROW)
    for _ in range(10):  # best effort: not more at once than is kept
        count = len(listener.heard[topics.VELOCITY.name])
        twin.go(20)
        listener.hear(topics.STRAIN, count + 1)
        listener.hear(topics.VELOCITY, count + 1)
    fields = [outputs.layer for outputs in twin.outputs[1:] if outputs.layer is not None]
    assert len(fields) == 10
    for message, field in zip(listener.hear(topics.STRAIN), fields, strict=True):
        labels, values = msg_to_array(message)
        assert labels == ['y']
        np.testing.assert_array_equal(values, field.strain)
    for message, field in zip(listener.hear(topics.VELOCITY), fields, strict=True):
        np.testing.assert_array_equal(msg_to_array(message)[1], field.velocity)


def test_rate_may_change(ros, twin, listener) -> None:
    client = ros.parameters(twin)
    assert client.set(rate__state=500.0) == ['']
    trigger(ros, listener, twin, topics.RESET)
    twin.go(1000)
    assert len(twin.outputs) == 501  # one, one at the reset, and every 2 ms one
    assert twin.ticker.account.skipped == 0


# contract


@pytest.mark.parametrize('topic', topics.TOPICS, ids=lambda topic: topic.name)
def test_quality_of_service_is_as_promised(ros, twin, listener, topic) -> None:
    name = topic.name.replace('~', '/twin')
    ros.spin_until(lambda: bool(listener.get_publishers_info_by_topic(name)), name)
    (info,) = listener.get_publishers_info_by_topic(name)
    is_latched = topic.name in ('~/throw_field', '~/phase', '~/throw_result', '~/journal') or (
        topic.name == '~/recommendation'
    )
    is_best_effort = topic.name in ('~/layer/strain', '~/layer/velocity')
    assert info.qos_profile.durability == (
        DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE
    )
    assert info.qos_profile.reliability == (
        ReliabilityPolicy.BEST_EFFORT if is_best_effort else ReliabilityPolicy.RELIABLE
    )


def test_depths_are_as_promised() -> None:
    assert topics.JOINT_STATES.qos.depth == 1000
    assert topics.JOURNAL.qos.depth == 1000
    assert topics.RECOMMENDATION.qos.depth == 1


def test_latched_topics_reach_who_comes_late(ros, twin, listener) -> None:
    trigger(ros, listener, twin, topics.THROW)
    twin.go(300)
    ros.spin_until(lambda: not twin._jobs, 'the queue')
    late = ros.node(Listener, ros, twin)
    late.listen(
        topics.PHASE,
        topics.THROW_RESULT,
        topics.THROW_FIELD,
        topics.RECOMMENDATION,
        topics.JOURNAL,
    )
    phases = [message.data for message in late.hear(topics.PHASE, 3)]
    assert phases[:3] == ['rest', 'contact', 'flight']
    (status,) = late.hear(topics.THROW_RESULT)[0].status
    result = msg_to_throw_result(status)
    assert result.stage == 'release'
    assert result.first is not None
    assert result.first.energy_transfer == pytest.approx(3.6366, abs=1e-4)
    labels, strain = msg_to_array(late.hear(topics.THROW_FIELD)[0])
    assert labels == ['t', 'y']
    assert strain.shape == (200, 64)
    assert strain.min() < -0.1
    assert late.hear(topics.RECOMMENDATION)[0].status[0].level == DiagnosticStatus.OK
    lines = [message.data for message in late.hear(topics.JOURNAL, 5)]
    kinds = [journal.decode(line)['kind'] for line in lines]
    assert kinds == ['start', 'pace', 'input', 'pace', 'throw']


def test_journal_repeats_what_was_published(ros, twin, listener) -> None:
    listener.listen(topics.JOURNAL)
    client = ros.parameters(twin)
    trigger(ros, listener, twin, topics.THROW)
    twin.go(400)
    client.set_atomically(layer__thickness=0.01, gravity=1.62)
    twin.go(100)
    trigger(ros, listener, twin, topics.RESET)
    twin.go(300)
    trigger(ros, listener, twin, topics.THROW)
    twin.go(500)
    lines = [message.data for message in listener.hear(topics.JOURNAL, 10)]
    again = list(replay(lines, until=twin.session.step, throw=1))
    assert [outputs.state for outputs in again] == [outputs.state for outputs in twin.outputs[1:]]
    assert again[-1].state.projectile_position > 0.05


def test_layer_with_loss_is_followed_by_finite_differences(ros, twin, listener) -> None:
    listener.listen(topics.THROW_RESULT)
    assert ros.parameters(twin).set(layer__loss_tangent=0.05) == ['']
    trigger(ros, listener, twin, topics.THROW)
    twin.go(800)
    result = msg_to_throw_result(listener.hear(topics.THROW_RESULT)[0].status[0])
    assert result.rig.layer.loss_tangent == 0.05
    lossless = simulate(Rig()).energy_transfer
    lossy = simulate(result.rig, model='finite_difference', cells=400).energy_transfer
    assert result.first is not None
    assert result.first.energy_transfer == pytest.approx(lossy, rel=2e-3)
    assert result.first.energy_transfer < 0.95 * lossless


def test_both_stages_are_published(ros, twin, listener) -> None:
    listener.listen(topics.THROW_RESULT)
    client = ros.parameters(twin)
    client.set(throw__max_events=1)
    trigger(ros, listener, twin, topics.THROW)
    twin.go(500)
    statuses = [message.status[0] for message in listener.hear(topics.THROW_RESULT, 2)]
    release, final = map(msg_to_throw_result, statuses)
    assert (release.stage, final.stage, final.ended_by) == ('release', 'final', 'max_events')
    expected = [result for outputs in twin.outputs for result in outputs.results]
    assert [release, final] == expected
    assert statuses[0].name == 'twin: throw'
    assert statuses[0].hardware_id == '/twin'
    values = msg_to_values(statuses[1])
    assert values['spring_mass.energy_transfer'] < 3.13
    assert values['layer.thickness'] == 0.0168


# services


def test_throw_is_accepted_at_rest_and_refused_in_flight(ros, twin, listener) -> None:
    listener.listen(topics.PHASE)
    twin.go(10)
    assert trigger(ros, listener, twin, topics.THROW).success
    twin.go(100)
    refused = trigger(ros, listener, twin, topics.THROW)
    assert not refused.success
    assert refused.message.startswith('throw 1 is under way: ready in')
    assert trigger(ros, listener, twin, topics.RESET).success
    twin.go(110)
    assert trigger(ros, listener, twin, topics.THROW).success
    twin.go(1)
    assert twin.session.throws == 2
    heard = [message.data for message in listener.hear(topics.PHASE, 6)]
    assert heard == ['rest', 'contact', 'flight', 'returning', 'rest', 'contact']


def test_throws_come_by_themselves(ros) -> None:
    twin = ros.node(Driven)
    twin.go(3500)
    assert twin.session.throws == 3


# parameters


def test_changes_wait_for_the_next_throw(ros, twin, listener) -> None:
    client = ros.parameters(twin)
    twin.go(10)
    assert client.set(layer__thickness=0.01, layer__wave_speed=9) == ['', '']
    assert client.get('layer.wave_speed') == 9.0
    assert client.get('layer.name') == 'custom'
    assert twin.session.pending == {
        'layer.name': 'custom',
        'layer.thickness': 0.01,
        'layer.wave_speed': 9.0,
    }
    twin.go(100)
    trigger(ros, listener, twin, topics.THROW)
    twin.go(300)
    assert twin.session.pending == {}
    (result,) = (result for outputs in twin.outputs for result in outputs.results)
    assert (result.rig.layer.thickness, result.rig.layer.wave_speed) == (0.01, 9.0)


@pytest.mark.parametrize(
    ('values', 'reason'),
    [
        ({'layer__thickness': 0.01, 'gravity': -1.0}, 'gravity must be .* got -1.0'),
        ({'layer__thickness': math.nan}, 'layer.thickness must be .* got nan'),
        ({'engine__motion': 'sampled'}, "got 'sampled'"),
        ({'layer__thickness': 5e-4, 'layer__wave_speed': 200.0}, 'steps per second'),
        ({'recommended__thickness': 0.01}, 'is a result'),
        ({'layer__name': 'gelatin_2.0mm', 'layer__thickness': 0.01}, 'got 0.01'),
    ],
)
def test_refused_request_changes_nothing(ros, twin, listener, values, reason) -> None:
    client = ros.parameters(twin)
    entries = len(twin.outputs)
    told = client.set_atomically(**values)
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(told)
    assert twin.parameters.settings == {**TWIN.defaults(), 'throw.period': 0.0}
    assert twin.session.pending == {}
    trigger(ros, listener, twin, topics.THROW)
    twin.go(50)
    assert len(twin.outputs) == entries + 50  # it runs on


def test_twin_refuses_to_start_with_what_cannot_be_stepped(ros) -> None:
    with pytest.raises(ParameterError, match='steps per'):
        ros.node(Driven, ros_args=('-p', 'layer.wave_speed:=200.0', '-p', 'layer.thickness:=5e-4'))


# recommendation


def settled(ros: Any, twin: Driven) -> Any:
    """Wait until the recommendation is for what is set, and return it."""
    ros.spin_until(
        lambda: twin._advice is not None and twin._advice.is_for(twin.parameters.settings),
        'the recommendation',
    )
    return twin._advice


def log_of(ros: Any, twin: Node, listener: Node) -> list[str]:
    """Listen to what is said from now on."""
    lines: list[str] = []
    qos = QoSProfile(depth=1000)
    listener.create_subscription(Log, '/rosout', lambda message: lines.append(message.msg), qos)
    ros.spin_until(lambda: twin.count_subscribers('/rosout') > 0, '/rosout')
    return lines


def test_recommendation_follows_every_change(ros, twin, listener) -> None:
    listener.listen(topics.RECOMMENDATION)
    client = ros.parameters(twin)
    settled(ros, twin)
    before = len(listener.hear(topics.RECOMMENDATION))
    for mass in (1e-3, 2e-3, 3e-3):
        assert client.set(projectile__mass=mass) == ['']
    advice = settled(ros, twin)
    messages = listener.hear(topics.RECOMMENDATION, before + 1)
    ros.spin_until(
        lambda: msg_to_values(messages[-1].status[0])['projectile.mass'] == 3e-3, 'the latest'
    )
    for name, value in advice.results().items():
        assert client.get(f'recommended.{name}') == value
        assert isinstance(value, str) or math.isfinite(value)


def test_recommendation_without_an_answer_says_why(ros, twin, listener) -> None:
    listener.listen(topics.RECOMMENDATION)
    lines = log_of(ros, twin, listener)
    client = ros.parameters(twin)
    assert client.set(recommendation__thickness_min=0.05) == ['']
    assert client.set(recommendation__thickness_max=0.01) == ['']
    advice = settled(ros, twin)
    assert advice.recommendation is None
    ros.spin_until(lambda: math.isnan(client.get('recommended.thickness')), 'nan')
    messages = listener.hear(topics.RECOMMENDATION)
    ros.spin_until(lambda: messages[-1].status[0].level == DiagnosticStatus.ERROR, 'the error')
    assert '0.05' in messages[-1].status[0].message
    refused = trigger(ros, listener, twin, topics.APPLY_RECOMMENDATION)
    assert not refused.success
    assert '0.05' in refused.message
    said = 'there is no recommendation: thickness_min must be below thickness_max, got 0.05 and'
    ros.spin_until(lambda: any(line.startswith(said) for line in lines), 'the warning')


@pytest.mark.parametrize('vary', ['thickness', 'wave_speed', 'both'])
def test_recommendation_can_be_applied(ros, twin, listener, vary) -> None:
    client = ros.parameters(twin)
    client.set(recommendation__vary=vary)
    advice = settled(ros, twin)
    response = trigger(ros, listener, twin, topics.APPLY_RECOMMENDATION)
    assert response.success, response.message
    varied = {'thickness', 'wave_speed'} if vary == 'both' else {vary}
    for name in ('thickness', 'wave_speed'):
        expected = TWIN.defaults()[f'layer.{name}']
        if name in varied:
            expected = getattr(advice.recommendation, name)
        assert client.get(f'layer.{name}') == expected
    trigger(ros, listener, twin, topics.THROW)
    twin.go(150)
    (result,) = (result for outputs in twin.outputs for result in outputs.results)
    assert result.first is not None
    assert result.first.energy_transfer == pytest.approx(
        advice.recommendation.energy_transfer, rel=1e-4
    )


JELLY = """\
jelly:
  description: Firm jelly
  source: measured
  density: 1050.0
  wave_speed: {value: 22.0, range: [21.0, 23.0]}
  loss_tangent: 0.0
  thicknesses: [20e-3, 40e-3]
"""


@pytest.fixture
def jelly(tmp_path) -> str:
    """Write a library of one's own, and return its path."""
    path = tmp_path / 'mine.yaml'
    path.write_text(JELLY)
    return str(path)


def test_layer_of_one_s_own_library_is_set_at_once(ros, twin, listener, jelly) -> None:
    client = ros.parameters(twin)
    assert client.set_atomically(layer__library=jelly, layer__name='jelly_20.0mm') == ''
    expected = {
        'layer.library': jelly,
        'layer.name': 'jelly_20.0mm',
        'layer.thickness': 0.02,
        'layer.wave_speed': 22.0,
        'layer.density': 1050.0,
    }
    assert twin.session.pending == expected
    assert {name: client.get(name) for name in expected} == expected
    assert client.set(layer__name='jelly_40.0mm') == ['']
    assert client.get('layer.thickness') == 0.04
    trigger(ros, listener, twin, topics.THROW)
    twin.go(150)
    (result,) = (result for outputs in twin.outputs for result in outputs.results)
    assert result.rig.layer == Layer(thickness=0.04, wave_speed=22.0, density=1050.0)


def test_bad_library_or_name_is_refused_and_changes_nothing(ros, twin, jelly) -> None:
    client = ros.parameters(twin)
    assert client.set(layer__name='jelly_40.0mm')[0].startswith(
        "layer.name must be a name in the library, or 'custom', got 'jelly_40.0mm'; "
    )
    assert client.set(layer__library='no.yaml') == ['no.yaml: No such file or directory']
    Path(jelly).write_text(JELLY.replace('1050.0', 'heavy'))
    (reason,) = client.set(layer__library=jelly)
    assert reason.startswith(f'{jelly}:4: density must be a number ')
    assert reason.endswith("got 'heavy'")
    assert twin.parameters.settings == {**TWIN.defaults(), 'throw.period': 0.0}


@pytest.mark.parametrize(
    ('request_', 'expected'),
    [
        ({'objective': 'robust', 'vary': 'thickness'},
         {'objective': Robust(), 'vary': 'thickness'}),
        ({'objective': 'robust', 'vary': 'thickness', 'quantile': 0.05},
         {'objective': Robust(quantile=0.05), 'vary': 'thickness'}),
        ({'objective': 'versatile', 'masses': [1e-3, 4e-3], 'frequencies': [50.0]},
         {'objective': Versatile(masses=(1e-3, 4e-3), frequencies=(50.0,))}),
        ({'vary': 'library', 'max_loss_tangent': 0.1},
         {'vary': 'library', 'materials': library().materials,
          'limits': Limits(max_loss_tangent=0.1)}),
        ({'thickness_max': 0.02, 'max_strain': 0.12, 'max_acceleration': 400.0},
         {'limits': Limits(thickness_max=0.02, max_strain=0.12, max_acceleration=400.0)}),
    ],
)  # fmt: skip
def test_recommendation_is_what_is_asked_for(ros, twin, request_, expected) -> None:
    client = ros.parameters(twin)
    values = {f'recommendation__{name}': value for name, value in request_.items()}
    assert client.set_atomically(**values) == ''
    best = settled(ros, twin).recommendation
    assert best == recommend(Rig(), **expected)
    ros.spin_until(lambda: client.get('recommended.score') == best.score, 'the result')
    assert client.get('recommended.thickness') == best.thickness
    assert client.get('recommended.layer') == best.layer


def test_recommendation_names_the_rig_that_it_is_for(ros, twin, listener) -> None:
    listener.listen(topics.RECOMMENDATION)
    client = ros.parameters(twin)
    assert client.set_atomically(layer__thickness=0.012, engine__frequency=50.0) == ''
    rig = settled(ros, twin).rig
    messages = listener.hear(topics.RECOMMENDATION)
    ros.spin_until(
        lambda: msg_to_values(messages[-1].status[0])['layer.thickness'] == 0.012, 'the latest'
    )
    values = msg_to_values(messages[-1].status[0])
    assert values_to_rig(values) == rig == rig_of(twin.parameters.settings)
    assert values['now.energy_transfer'] == recommend(rig).now.energy_transfer
    assert values['thickness'] == recommend(rig).thickness


def test_layer_picked_from_a_library_can_be_applied(ros, twin, listener, jelly) -> None:
    client = ros.parameters(twin)
    assert client.set_atomically(layer__library=jelly, recommendation__vary='library') == ''
    best = settled(ros, twin).recommendation
    response = trigger(ros, listener, twin, topics.APPLY_RECOMMENDATION)
    assert response.success, response.message
    assert response.message == 'layer.name jelly_40.0mm, from the next throw or ~/reset on'
    assert client.get('layer.name') == best.layer == 'jelly_40.0mm'
    assert client.get('layer.wave_speed') == 22.0
    again = settled(ros, twin).recommendation
    assert again.now_score == pytest.approx(best.score, rel=1e-9)
    assert again.summary.startswith('the layer as it is cannot be bettered')


def test_material_that_is_cast_as_wanted_is_applied_with_its_thickness(
    ros, twin, listener, jelly
) -> None:
    Path(jelly).write_text(JELLY.replace('  thicknesses: [20e-3, 40e-3]\n', ''))
    client = ros.parameters(twin)
    assert client.set_atomically(layer__library=jelly, recommendation__vary='library') == ''
    best = settled(ros, twin).recommendation
    assert trigger(ros, listener, twin, topics.APPLY_RECOMMENDATION).success
    assert client.get('layer.name') == best.layer == 'jelly'
    assert client.get('layer.thickness') == best.thickness


def test_aim_can_be_applied_and_reaches_its_height(ros, twin, listener) -> None:
    client = ros.parameters(twin)
    values = {'objective': 'aim', 'vary': 'amplitude', 'target_height': 0.15}
    named = {f'recommendation__{name}': value for name, value in values.items()}
    assert client.set_atomically(**named) == ''
    best = settled(ros, twin).recommendation
    assert trigger(ros, listener, twin, topics.APPLY_RECOMMENDATION).success
    assert client.get('engine.amplitude') == best.amplitude
    assert client.get('layer.name') == 'gelatin_16.8mm'
    trigger(ros, listener, twin, topics.THROW)
    twin.go(500)
    heights = [outputs.state.projectile_position for outputs in twin.outputs]
    assert max(heights) - heights[0] == pytest.approx(0.15, rel=1e-4)


def test_aim_out_of_reach_is_a_warning_that_says_what_would_do(ros, twin, listener) -> None:
    listener.listen(topics.RECOMMENDATION)
    client = ros.parameters(twin)
    values = {
        'objective': 'aim', 'vary': 'amplitude', 'target_height': 0.2, 'max_strain': 0.12,
    }  # fmt: skip
    named = {f'recommendation__{name}': value for name, value in values.items()}
    assert client.set_atomically(**named) == ''
    messages = listener.hear(topics.RECOMMENDATION)
    ros.spin_until(lambda: messages[-1].status[0].level == DiagnosticStatus.WARN, 'the warning')
    message = messages[-1].status[0].message
    assert '0.2 m high is not reached: it takes a strain of 16' in message
    assert 'would do it: amplitude' in message


# log and diagnostics


def test_result_says_how_far_it_may_be_off(ros, twin, listener) -> None:
    listener.listen(topics.THROW_RESULT)
    client = ros.parameters(twin)
    assert client.set_atomically(uncertainty__wave_speed=0.6, uncertainty__mass=0.0) == ''
    trigger(ros, listener, twin, topics.THROW)
    twin.go(150)
    values = msg_to_values(listener.hear(topics.THROW_RESULT)[0].status[0])
    expected = prediction_uncertainty(Rig(), Uncertainties(wave_speed=0.6, mass=0.0))
    assert {name: values[f'uncertainty.{name}'] for name in expected.values()} == expected.values()
    assert expected.energy_transfer.low < values['energy_transfer'] < expected.energy_transfer.high


def test_log_has_a_line_per_ejection_landing_and_change(ros, twin, listener) -> None:
    lines = log_of(ros, twin, listener)
    settled(ros, twin)
    client = ros.parameters(twin)
    trigger(ros, listener, twin, topics.THROW)
    twin.go(400)
    client.set(projectile__mass=2e-3)
    ros.spin_until(lambda: any('projectile.mass' in line for line in lines), 'the last line')
    (thrown,) = (line for line in lines if ': left after' in line)
    assert thrown.startswith('throw 1: left after 7.647 ms at 1.3750 m/s, alpha 3.637')
    assert (
        f'(by the uncertainties of the rig {prediction_uncertainty(Rig()).describe()})' in thrown
    )
    assert 'the recommended layer of' in thrown
    (landed,) = (line for line in lines if ': landed after' in line)
    assert landed == 'throw 1: landed after 0.291 s at 1.400 m/s'
    assert 'projectile.mass is now 0.002, from the next throw or ~/reset on' in lines


def test_diagnostics_tell_how_time_is_kept(ros, twin, listener) -> None:
    listener.listen(topics.DIAGNOSTICS)
    client = ros.parameters(twin)
    trigger(ros, listener, twin, topics.THROW)
    twin.go(500)
    client.set(layer__thickness=0.01)
    twin._on_second()
    (array,) = listener.hear(topics.DIAGNOSTICS)[:1]
    while 'pending' not in array.status[2].message and not array.status[2].values:
        array = listener.hear(topics.DIAGNOSTICS)[-1]
    status = {item.name: item for item in array.status}
    assert set(status) == {'twin: deadlines', 'twin: load', 'twin: parameters', 'twin: layer'}
    assert {item.hardware_id for item in array.status} == {'/twin'}
    deadlines = msg_to_values(status['twin: deadlines'])
    assert deadlines['ticks'] == 501
    assert deadlines['ticks_skipped'] == 0
    assert deadlines['ticks_caught_up'] == 450  # ten at a time
    assert deadlines['lateness_max'] == 0.009
    assert msg_to_values(status['twin: load'])['compute_p50'] > 0.0
    pending = msg_to_values(status['twin: parameters'])
    assert pending == {'pending': 2, 'layer.name': 'custom', 'layer.thickness': 0.01}
    assert status['twin: layer'].level == DiagnosticStatus.WARN
    assert 'beyond the linear 10 %' in status['twin: layer'].message


# clock


def test_steps_follow_the_clock_topic(ros) -> None:
    twin = ros.node(Twin, ros_args=('-p', 'use_sim_time:=true', '-p', 'throw.period:=0.2'))
    listener = ros.node(Listener, ros, twin)
    listener.listen(topics.JOINT_STATES)
    clock = listener.create_publisher(ClockMessage, '/clock', 10)
    matched(ros, twin._joint_states)
    matched(ros, clock)
    twin.ticker.start()
    messages = listener.heard[topics.JOINT_STATES.name]
    assert messages == []
    shown = [5000, 5001, 5100, 5350, 6000]  # [ms]
    for now in shown:
        clock.publish(ClockMessage(clock=time_to_msg(now * MILLISECOND)))
        listener.hear(topics.JOINT_STATES, now - 5000 + 1)
    stamps = [msg_to_time(message.header.stamp) for message in messages]
    assert stamps == [time * MILLISECOND for time in range(5000, 6001)]
    assert twin.session.throws == 5
    clock.publish(ClockMessage(clock=time_to_msg(100 * MILLISECOND)))  # it is set back
    listener.hear(topics.JOINT_STATES, 1002)
    clock.publish(ClockMessage(clock=time_to_msg(102 * MILLISECOND)))
    listener.hear(topics.JOINT_STATES, 1004)
    assert [msg_to_time(message.header.stamp) for message in messages[1001:]] == [
        time * MILLISECOND for time in (100, 101, 102)
    ]
    assert twin.ticker.account.jumps == 1
    assert twin.ticker.account.skipped == 0


def test_clock_may_be_changed_for_the_topic(ros, twin, listener) -> None:
    twin.go(10)
    clock = listener.create_publisher(ClockMessage, '/clock', 10)
    assert ros.parameters(twin).set(use_sim_time=True) == ['']
    matched(ros, clock)
    twin.go(100)  # the system's clock goes on, but does not count
    assert len(twin.outputs) == 11
    for now in (50, 53):
        clock.publish(ClockMessage(clock=time_to_msg(now * MILLISECOND)))
        ros.spin_until(
            lambda now=now: twin.get_clock().now().nanoseconds == now * MILLISECOND, '/clock'
        )
        twin.ticker.run_due()
    assert len(twin.outputs) == 11 + 4
    assert twin.ticker.account.skipped == 0


# two


def test_two_twins_in_two_namespaces_do_not_meet(ros) -> None:
    first, second = (
        ros.node(Driven, ros_args=('-r', f'__ns:=/rig{k}', '-p', f'layer.thickness:=0.0{k}'))
        for k in (1, 2)
    )
    listeners = [ros.node(Listener, ros, twin) for twin in (first, second)]
    for listener, twin in zip(listeners, (first, second), strict=True):
        listener.listen(topics.JOINT_STATES, topics.DIAGNOSTICS)
        matched(ros, twin._joint_states)
    first.go(30)
    second.go(20)
    heights = [
        {message.position[1] for message in listener.hear(topics.JOINT_STATES, count)}
        for listener, count in zip(listeners, (30, 20), strict=True)
    ]
    assert heights[0] == {first.outputs[0].state.projectile_position}
    assert heights[1] == {second.outputs[0].state.projectile_position}
    assert heights[0] != heights[1]
    trigger(ros, listeners[0], second, topics.THROW)
    first.go(10)
    second.go(10)
    assert (first.session.throws, second.session.throws) == (0, 1)
    first._on_second()
    second._on_second()
    hardware = {
        status.hardware_id
        for message in listeners[0].hear(topics.DIAGNOSTICS, 2)
        for status in message.status
    }
    assert hardware == {'/rig1/twin', '/rig2/twin'}


def test_change_through_the_table_is_what_the_session_gets(ros, twin) -> None:
    client = ros.parameters(twin)
    client.set(layer__name='gelatin_5.6mm')
    expected = TWIN.change(TWIN.defaults(), {'layer.name': 'gelatin_5.6mm'})
    pending = twin.session.pending
    assert pending == {'layer.name': 'gelatin_5.6mm', 'layer.thickness': 5.6e-3}
    assert pending.items() <= expected.items()
