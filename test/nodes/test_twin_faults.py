# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Faults around a twin, and the promises of docs/testing.md."""

from __future__ import annotations

import math
from test.nodes.conftest import SECOND
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from sensor_msgs.msg import JointState
from soft_throw_ros.configuration.interface import TWIN_SERVICES, TWIN_TOPICS
from soft_throw_ros.nodes.conversions import msg_to_values, time_to_msg
from soft_throw_ros.nodes.process import RunnableNode
from soft_throw_ros.nodes.topics import create_service
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.session import Session
from std_srvs.srv import Trigger


def test_two_twins_of_one_name_are_reported_by_both_until_one_ends(
    ros, start_twin, listen_to, capfd
) -> None:
    twins = [start_twin() for _ in range(2)]
    listener = listen_to(twins[0])
    listener.listen(TWIN_TOPICS.diagnostics)
    log = ''

    def is_logged(text: str, count: int) -> bool:
        nonlocal log
        log += capfd.readouterr().err
        return log.count(text) == count

    ros.spin_until(
        lambda: is_logged('another node is named /twin', 2), 'the warnings of both twins'
    )
    status = listener.status(
        TWIN_TOPICS.diagnostics, 'name', lambda s: msg_to_values(s)['duplicate_nodes'] == 1
    )
    assert status.level == DiagnosticStatus.WARN
    assert '/twin' in status.message
    ros.remove(twins[1])
    ros.spin_until(lambda: is_logged('no other node has this name', 1), 'the end of the warning')


def test_clock_that_is_set_changes_stamps_but_no_state(twin, listener) -> None:
    listener.listen(TWIN_TOPICS.joint_states)
    twin.clock.time += 10_000 * SECOND  # so that it can be set back
    twin.clock.epoch += 1
    twin.session.request_throw()
    twin.go(50)
    twin.clock.time -= 3600 * SECOND
    twin.clock.epoch += 1
    twin.ticker.run_due()
    twin.clock.time += 3600 * SECOND  # and forth
    twin.clock.epoch += 1
    twin.go(50)
    twin.session.close()
    assert twin.ticker.counts['clock_jumps'] == 3
    assert twin.ticker.counts['ticks_skipped'] == 0
    assert [outputs.step for outputs in twin.outputs] == list(range(len(twin.outputs)))
    count = len(twin.outputs) - 1  # the first was before anybody listened
    stamps = [m.header.stamp.sec for m in listener.hear(TWIN_TOPICS.joint_states, count)]
    assert max(map(abs, stamps)) - min(map(abs, stamps)) >= 3599
    entries = [journal.decode(line) for line in twin.lines]
    session = Session.from_entry(entries[0])
    again = [outputs for entry in entries[1:] for outputs in session.follow(entry)]
    ours = [outputs.state for outputs in twin.outputs]
    assert [outputs.state for outputs in again] == ours[: len(again)]
    assert len(again) >= len(ours) - 1


def test_participant_that_is_lost_and_comes_back_is_heard_again(ros, start_twin) -> None:
    twin = start_twin('-p', 'engine.motion:=measured')

    def measure(others: Any) -> None:
        sensors = others.node(Node, 'sensors')
        sender = sensors.create_publisher(JointState, '/twin/measured_joint_states', 10)
        others.spin_until(lambda: sender.get_subscription_count() > 0, 'the twin')
        before = twin.session.sample_counts.taken
        twin.go(10)
        message = JointState(name=['plate'], position=[0.0], velocity=[math.inf])
        message.header.stamp = time_to_msg(twin.clock.time)

        def is_taken() -> bool:
            sender.publish(message)  # the twin may not know of the sender yet
            twin.measurement.read_messages()
            return bool(twin.session.sample_counts.taken > before)

        ros.spin_until(is_taken, 'the sample')

    for _ in range(2):
        others = type(ros)(ros.domain_id)  # a participant of its own
        measure(others)
        others.close()
    assert twin.session.sample_counts.taken == 2


class AnyNode(RunnableNode):
    """A node with a defective service."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__('any', **kwargs)
        create_service(self, TWIN_SERVICES.throw, lambda: str(1 // 0))


@pytest.fixture
def call(ros) -> Any:
    """Return a function that calls services of a node with a defective service."""
    ros.node(AnyNode)
    asking = ros.node(Node, 'asking')
    return lambda kind, name, request: ros.call(asking.create_client(kind, name), request)


NO_TYPE = Parameter(name='use_sim_time', value=ParameterValue(type=250))
GOOD = Parameter(name='use_sim_time', value=ParameterValue(type=1, bool_value=False))


def test_parameter_without_type_is_refused_with_all_following(call, capfd) -> None:
    request = SetParameters.Request(parameters=[GOOD, NO_TYPE, GOOD])
    (result,) = call(SetParameters, '/any/set_parameters', request).results
    assert result.successful
    assert '250' in capfd.readouterr().err
    request = SetParametersAtomically.Request(parameters=[GOOD, NO_TYPE])
    result = call(SetParametersAtomically, '/any/set_parameters_atomically', request).result
    assert not result.successful


def test_service_with_a_defect_answers(call) -> None:
    response = call(Trigger, '/any/throw', Trigger.Request())
    assert not response.success
    assert 'division' in response.message
