# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Conversions between messages and Python values."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
import math

from bags import accepted
from diagnostic_msgs.msg import DiagnosticStatus
import pytest
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2.metadata import dump_qos_v8, dump_qos_v9, parse_qos
from soft_throw_ros.configuration.interface import TWIN_TOPICS
from soft_throw_ros.nodes.conversions import (
    msg_to_throw_result,
    msg_to_values,
    profile_to_dict,
    status_to_msg,
    text_to_profiles,
    throw_result_to_msg,
)
from soft_throw_ros.nodes.topics import qos_profile
from soft_throw_ros.storage.bag_folder import dump_yaml
from soft_throw_ros.twin.results import ThrowResult
from twin_runs import Run


@pytest.fixture(scope='module')
def results() -> list[ThrowResult]:
    run = Run(engine__motion='measured')
    run.measure(duration=0.1)
    run.session.reset()
    run.go(1)
    return [result for stage in ('predicted', 'release', 'final') for result in run.results(stage)]


def test_results_are_converted_back_and_have_their_warnings(results) -> None:
    final = results[-1]
    assert final.comparison is not None
    for result, is_warning in (
        *((result, False) for result in results),
        (replace(final, peak_strain=0.16), True),
        (replace(final, ended_by='gap'), True),
        (replace(final, first=None, last=None, recontacts=0, apex_height=math.inf), False),
    ):
        message = throw_result_to_msg(result, '/twin')
        assert msg_to_throw_result(message) == result
        assert (message.level == DiagnosticStatus.WARN) == is_warning


def test_result_of_a_throw_with_a_missing_or_wrong_value_is_refused(results) -> None:
    values = msg_to_values(throw_result_to_msg(results[-1], '/twin'))
    refused = set()
    for name in values:
        rest = {key: value for key, value in values.items() if key != name}
        for changed in (rest, {**rest, name: 'text'}):
            message = status_to_msg('/twin', 'throw', '', changed)
            if accepted(partial(msg_to_throw_result, message)) is None:
                refused.add(name)
    assert refused > {'engine.frequency', 'layer.thickness', 'projectile.mass'}


def test_values_are_converted_back_under_the_full_name_of_the_node() -> None:
    values = {'a': 1, 'b': 0.1, 'c': True, 'd': 'text', 'e': -math.inf, 'f': 1e-300}
    message = status_to_msg('/rig1/twin', 'timing', '', values)
    assert msg_to_values(message) == values
    assert (message.name, message.hardware_id) == ('/rig1/twin: timing', '/rig1/twin')


def test_quality_of_service_is_read_as_any_recorder_writes_it() -> None:
    for topic in TWIN_TOPICS:
        profile = qos_profile(topic)
        text = dump_yaml([profile_to_dict(profile)])
        (theirs,) = parse_qos(text)
        assert theirs.depth == topic.depth
        assert (theirs.reliability is QosReliability.RELIABLE) == topic.is_reliable
        assert (theirs.durability is QosDurability.TRANSIENT_LOCAL) == topic.is_latched
        for written in (text, dump_yaml(dump_qos_v9([theirs])), dump_qos_v8([theirs])):
            assert text_to_profiles(written) == [profile]
    for text, count in (
        ('', 0), ('[]', 0), ('[{depth: 3}]', 1), ('[{}, {depth: 1}]', 2), ('{', 0), ('depth', 0),
        ('[3]', 0), ('[{depth: many}]', 0), ('[{deadline: {sec: 1}}]', 1), ('[' * 1000, 0),
    ):
        assert len(text_to_profiles(text)) == count, text
