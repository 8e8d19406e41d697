# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A rig that is measured, through DDS, and the clock of its sensors."""

from __future__ import annotations

from functools import partial
import math
from typing import Any

from bags import accepted, datas, few
from diagnostic_msgs.msg import DiagnosticStatus
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from ros_nodes import MILLISECOND
from sensor_msgs.msg import JointState
from soft_throw_ros.configuration.interface import FRAME, JOINTS, TWIN_TOPICS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.nodes.conversions import msg_to_values
from soft_throw_ros.nodes.measured import SensorClock, to_samples, TOLERATED
from soft_throw_ros.storage.cdr import JointStateEncoder, JointStateReader
from soft_throw_ros.storage.message import SECOND
from twin_runs import BEGIN, measured_throw, Run, Sample


@pytest.fixture
def twin(ros: Any) -> Any:
    return ros.start_twin(engine__motion='measured')


@pytest.fixture
def sensors(ros: Any, twin: Any) -> Any:
    return ros.sensors_of(twin)


def test_joints_have_the_names_of_the_parameters(ros, capfd) -> None:
    names = 'carriage', 'ball'
    own = {'joint_names__plate': names[0], 'joint_names__projectile': names[1]}
    twin = ros.start_twin(engine__motion='measured', **own)
    sensors, listener = ros.sensors_of(twin), ros.listen_to(twin)
    for sent in (JOINTS, names):
        sensors.send(Sample(twin.clock.time + len(sent[0]), 0.0, 0.0), sent)
    sensors.wait()
    assert "['plate', 'projectile']" in capfd.readouterr().err
    assert twin.measurement.count()['samples'] == 1
    listener.listen(TWIN_TOPICS.joint_states)
    twin.go(1)
    assert tuple(listener.hear(TWIN_TOPICS.joint_states)[0].name) == names


def test_clock_that_is_behind_is_corrected_and_reported(twin, sensors, listener) -> None:
    listener.listen(TWIN_TOPICS.diagnostics, TWIN_TOPICS.throw_result)
    begin_ns = twin.clock.time
    samples = measured_throw(Rig(), begin_ns=begin_ns, onset=0.35, duration=0.4)
    sensors.throw(samples, behind_ns=300 * MILLISECOND)
    release = next(result for result in twin.results if result.stage == 'release')
    exact = simulate(Rig())
    assert release.first.ejection_speed == pytest.approx(exact.ejection_speed, rel=0.01)
    released_ns = begin_ns + round((0.35 + exact.ejection_time) * SECOND)
    assert abs(release.first.release_ns - released_ns) <= 11 * MILLISECOND  # sent so early
    status = listener.status(
        TWIN_TOPICS.diagnostics, 'measurement', lambda s: msg_to_values(s)['clock_offset'] > 0.0
    )
    offset = msg_to_values(status)['clock_offset']
    assert (status.level, offset) == (DiagnosticStatus.WARN, pytest.approx(0.29, abs=0.02))
    values = msg_to_values(listener.hear(TWIN_TOPICS.throw_result)[0].status[0])
    assert values['clock_offset_ns'] == round(offset * SECOND)
    started_ns = values['release_ns'] - round(values['ejection_time'] * SECOND)
    assert values['start_ns'] == pytest.approx(started_ns, abs=1)


def test_clock_topic_that_moves_in_steps_is_no_offset_of_the_sensors(twin, sensors) -> None:
    samples = measured_throw(Rig(), begin_ns=twin.clock.time, onset=0.35, duration=0.4)
    sensors.throw(samples, step_ns=25 * MILLISECOND)  # `/clock` at 40 Hz
    assert twin.measurement.clock.offset_ns == 0
    release = next(result for result in twin.results if result.stage == 'release')
    assert release.lead > 0.0


def test_other_messages_are_refused_with_a_reason(ros, twin, sensors, listener, capfd) -> None:
    listener.listen(TWIN_TOPICS.diagnostics)
    now = twin.clock.time
    sensors.send(Sample(now, 0.0, 0.0), ('plank', 'projectile'))
    sensors.publish(JointState(name=['plate'], position=[0.0, 0.0]))
    sensors.publish(JointState(name=[*map(str, range(2000))]))
    for since_ns, plate in (
        (0, math.nan), (0, 300.0), (SECOND, 0.0), (0, 0.0), (0, 0.0), (-MILLISECOND, 0.0)
    ):
        sensors.send(Sample(now + since_ns, plate, math.nan))
    sensors.wait()
    assert twin.session.sample_counts.refused == {
        'names': 2, 'too large': 1, 'not finite': 1, 'out of range': 1, 'future': 1, 'doubled': 1,
    }

    def reported(name: str) -> int:
        statuses = listener.statuses(TWIN_TOPICS.diagnostics, 'measurement')
        return sum(msg_to_values(status).get(name, 0) for status in statuses)

    ros.spin_until(lambda: reported('samples_refused') == 7, 'the counts')
    assert [reported(name) for name in ('samples', 'refused.names')] == [2, 2]
    assert reported('samples_out_of_order') == 1
    assert 'millimetres' in capfd.readouterr().err


def observe(clock: SensorClock, offset_ns: int, begin_ns: int = BEGIN) -> int:
    """Feed five seconds of stamps with an offset to a clock and count its warnings."""
    delays = np.random.default_rng(0).exponential(3e-4 * SECOND, (5000, 5)).astype(int)
    times = range(begin_ns, begin_ns + 5 * SECOND, MILLISECOND)
    stamps = np.array(times)[:, None] - offset_ns - delays - MILLISECOND // 10
    return sum(map(clock.observe, stamps.tolist(), times))


@pytest.mark.parametrize(('offset_ns', 'is_corrected'), [
    (20 * MILLISECOND, True), (-300 * MILLISECOND, True), (5 * SECOND, True),
    (BEGIN - 3600 * SECOND, True),  # since boot
    (TOLERATED - MILLISECOND, False),  # the time of transport
])
def test_constant_offset_is_found_and_reported_once_until_it_ends(offset_ns, is_corrected) -> None:
    clock = SensorClock()
    assert observe(clock, offset_ns) == is_corrected
    fastest = offset_ns + MILLISECOND // 10
    assert clock.offset_ns == pytest.approx(is_corrected * fastest, abs=MILLISECOND // 50)
    assert (f'{abs(clock.offset_ns) / MILLISECOND:.1f} ms' in clock.problem) == is_corrected
    assert observe(clock, 0, BEGIN + 5 * SECOND) == is_corrected
    assert (clock.offset_ns, clock.problem) == (0, '')


@pytest.mark.parametrize(('step', 'words'), [(0, 'is 0'), (SECOND, 'is of whole seconds')])
def test_stamps_without_the_time_of_the_sample_are_named(step, words) -> None:
    clock = SensorClock()
    for tick in range(1000):
        now_ns = BEGIN + tick * MILLISECOND
        clock.observe([now_ns // step * step if step else 0], now_ns)
    assert f'header.stamp of the samples {words}' in clock.problem
    assert clock.offset_ns == 0


THROW = [
    JointStateEncoder(FRAME, JOINTS, series=1).encode(s.stamp_ns, [s.plate, s.projectile])
    for s in measured_throw(Rig(), begin_ns=BEGIN, onset=0.02, duration=0.06)
]


@settings(few, max_examples=25)
@given(damaged=st.dictionaries(st.integers(0, len(THROW) - 1), datas(*THROW[::50]), max_size=9))
def test_damaged_messages_never_reach_the_outputs(damaged: dict[int, bytes]) -> None:
    run, reader = Run(engine__motion='measured'), JointStateReader()
    for number, message in enumerate(THROW):
        values = accepted(partial(reader.read_all, [damaged.get(number, message)]))
        samples = values and to_samples(values, JOINTS)
        if samples is not None:
            run.session.measure(samples)
        if number % 5 == 0:
            (outputs,) = run.go(1)
            assert all(map(math.isfinite, outputs.state))
