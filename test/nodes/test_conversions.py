# SPDX-License-Identifier: Apache-2.0
"""Messages and what they are made of."""

from __future__ import annotations

import dataclasses
import math

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy
from rclpy.serialization import deserialize_message
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.nodes import topics
from soft_throw_ros.nodes.conversions import (
    msg_to_array,
    msg_to_throw_result,
    msg_to_time,
    msg_to_values,
    profile_to_qos,
    qos_to_profile,
    rig_to_values,
    status_to_msg,
    throw_result_to_msg,
    time_to_msg,
    values_to_rig,
)
from soft_throw_ros.recording.cdr import ArrayEncoder
from soft_throw_ros.recording.qos import from_yaml, Qos, to_yaml
from soft_throw_ros.twin.results import Comparison, Release, State, ThrowResult
from std_msgs.msg import Float64MultiArray

STATE = State(1e-3, 0.0168, -0.25, 1.25, -math.pi, math.pi)
STAMP = 1_700_000_000_123_456_789

RESULT = ThrowResult(
    throw=3,
    step=3123,
    stage='final',
    ended_by='period',
    rig=Rig(engine=Engine(frequency=31.1), layer=Layer(thickness=2e-3)),
    first=Release(time=0.1 + 0.2, speed=1.0 / 3.0, energy_transfer=0.499),
    last=Release(time=0.4, speed=2.0 / 3.0, energy_transfer=1.241),
    peak_plate_speed=0.72,
    peak_strain=0.12,
    max_strain=0.1,
    peak_acceleration=1234.5,
    peak_force=1.5,
    plate_work=2.5e-3,
    apex_height=math.inf,
    recontacts=1,
    landings=4,
    models={'spring_mass': Release(time=0.01, speed=1.0, energy_transfer=3.0)},
)


@pytest.mark.parametrize('time_ns', [0, 1, 999_999_999, 10**9, STAMP])
def test_time_comes_back(time_ns) -> None:
    assert msg_to_time(time_to_msg(time_ns)) == time_ns


@pytest.mark.parametrize(
    'result',
    [
        RESULT,
        dataclasses.replace(RESULT, last=RESULT.first, recontacts=0, stage='release', ended_by=''),
        dataclasses.replace(RESULT, first=None, last=None, recontacts=0, models={}),
        dataclasses.replace(
            RESULT,
            lead=1e-3,
            comparison=Comparison(samples=7, position_rms=1e-5, position_max=1.0, threshold=0.1),
        ),
        dataclasses.replace(
            RESULT,
            lead=-0.1,
            comparison=Comparison(
                samples=70,
                position_rms=1e-5,
                position_max=3e-5,
                threshold=1e-5,
                ejection_time_error=-1e-4,
                ejection_speed_error=0.01,
            ),
        ),
    ],
)
def test_throw_result_comes_back(result) -> None:
    message = throw_result_to_msg(result, name='twin: throw', hardware_id='/twin')
    assert msg_to_throw_result(message) == result


@pytest.mark.parametrize(('strain', 'level'), [(0.0999, b'\x00'), (0.1001, b'\x01')])
def test_throw_result_warns_beyond_the_linear_range(strain, level) -> None:
    result = dataclasses.replace(RESULT, peak_strain=strain)
    assert throw_result_to_msg(result, name='', hardware_id='').level == level


def test_throw_result_warns_when_the_plate_was_lost() -> None:
    result = dataclasses.replace(RESULT, peak_strain=0.0, ended_by='gap')
    message = throw_result_to_msg(result, name='', hardware_id='')
    assert message.level == b'\x01'
    assert 'invalid' in message.message


def test_values_come_back() -> None:
    values = {'a': 1, 'b': 0.1, 'c': True, 'd': 'text', 'e': -math.inf, 'f': 1e-300}
    message = status_to_msg('name', hardware_id='', message='', values=values)
    assert msg_to_values(message) == values
    assert message.level == DiagnosticStatus.OK


def test_rig_comes_back() -> None:
    assert values_to_rig(rig_to_values(RESULT.rig)) == RESULT.rig


def test_array_comes_back_through_ros() -> None:
    values = np.random.default_rng(2).normal(size=(4, 7))
    encoded = ArrayEncoder({'t': 4, 'y': 7}).encode(values)
    labels, decoded = msg_to_array(deserialize_message(encoded, Float64MultiArray))
    assert labels == ['t', 'y']
    np.testing.assert_array_equal(decoded, values)


@pytest.mark.parametrize('topic', topics.TOPICS, ids=lambda topic: topic.name)
def test_profile_comes_back(topic) -> None:
    qos = profile_to_qos(topic.qos)
    assert (qos.reliability, qos.durability) == (
        topic.qos.reliability.name.lower(),
        topic.qos.durability.name.lower(),
    )
    assert profile_to_qos(qos_to_profile(qos)) == qos
    assert from_yaml(to_yaml([qos])) == (qos,)


def test_profile_that_is_not_known_in_full_can_be_offered() -> None:
    qos = Qos(
        history='unknown', depth=0, durability='transient_local', liveliness='manual_by_node'
    )
    profile = qos_to_profile(qos)
    assert profile.liveliness is LivelinessPolicy.SYSTEM_DEFAULT
    assert profile.history is HistoryPolicy.KEEP_LAST
    assert profile.depth == 1
    assert profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
