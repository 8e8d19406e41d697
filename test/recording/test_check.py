# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of bags with their journals: complete, damaged and foreign bags of sessions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import json
import math
import struct
from typing import Any

from bags import text, write
import pytest
from ros_nodes import DrivenTwin, MILLISECOND, Ros
from soft_throw_ros import configuration
from soft_throw_ros.configuration.interface import JOINTS, TWIN_TOPICS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.check import check_bag, CheckError, CheckResult, Count
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import decode, JointStateEncoder
from soft_throw_ros.storage.message import Message, SECOND
from soft_throw_ros.twin.results import State
from twin_runs import measured_throw


def entries(twin: DrivenTwin, *kinds: str) -> list[dict[str, Any]]:
    """Return the lines of the journal, or those of some kinds."""
    lines = [json.loads(decode(line).data) for line in twin.of(TWIN_TOPICS.journal)]
    return [entry for entry in lines if not kinds or entry['kind'] in kinds]


def edited(
    twin: DrivenTwin, edit: Callable[[dict[str, Any]], dict[str, Any] | None]
) -> list[Message]:
    """Return the messages with every line of the journal changed, or left out for None."""
    edits = map(edit, entries(twin))
    messages = [
        message._replace(data=text(json.dumps(next(edits))))
        if message.channel.topic.endswith('/journal') else message
        for message in twin.messages
    ]
    return [message for message in messages if message.data != text('null')]


def damaged(twin: DrivenTwin, message: Message, data: bytes) -> list[Message]:
    return [other._replace(data=data) if other is message else other for other in twin.messages]


@pytest.fixture
def check(tmp_path) -> Callable[..., CheckResult]:
    """Return a function that checks messages of one twin."""

    def check_messages(messages: Iterable[Message]) -> CheckResult:
        with BagReader(write(tmp_path / 'bag', messages)) as reader:
            (result,) = check_bag(reader)
        return result

    return check_messages


@pytest.fixture(scope='module')
def plain(module_ros: Ros) -> DrivenTwin:
    """Return a twin with five throws, whose gravity changes after the first one."""
    twin = module_ros.start_twin(throw__period=0.4).go(419)
    twin.change(gravity=9.0)
    twin.go(1780)
    twin.finish()
    return twin


@pytest.fixture(scope='module')
def eventful(module_ros: Ros) -> DrivenTwin:
    """Return a twin with changes, a reset, a stall in flight, a restart and a clock jump."""
    twin = module_ros.start_twin(throw__max_events=4).go(1234)
    twin.clock.max_catch_up = MILLISECOND
    twin.change(time_scale=0.1, layer__loss_tangent=0.01, rate__state=800.0)
    twin.session.reset()
    twin.go(1900)
    twin.advance(125 * MILLISECOND)
    twin.go(1250)
    assert twin.ticker.counts['ticks_skipped'] > 50
    twin.finish()
    twin.clock.time += SECOND
    again = module_ros.node(DrivenTwin, clock=twin.clock)  # with the default settings
    again.messages[:0] = twin.messages
    again.go(1000)
    again.clock.time -= SECOND // 3
    again.clock.epoch += 1
    again.go(1000)
    again.finish()
    return again


@pytest.fixture(scope='module')
def measured(module_ros: Ros) -> DrivenTwin:
    """Return a twin of three measured throws with changes and a stall in between."""
    twin = module_ros.start_twin(engine__motion='measured', measured__latency=2e-4).go(20)
    sensors = module_ros.sensors_of(twin)
    for seed, duration in enumerate((0.2, 0.25, 0.3)):
        sensors.throw(measured_throw(
            Rig(), begin_ns=twin.clock.time, noise=5e-6, jitter=0.4, seed=seed, duration=duration
        ))
        twin.clock.max_catch_up = MILLISECOND
        twin.advance(13 * MILLISECOND)  # a stall
        twin.clock.max_catch_up = SECOND
        twin.session.reset()
        twin.change(layer__wave_speed=8.1, measured__smoothing_window=1.6e-3)
        twin.clock.time += SECOND // 2
        twin.clock.epoch += 1
    twin.finish()
    return twin


@pytest.mark.parametrize('name', ['plain', 'eventful', 'measured'])
def test_bag_agrees_with_its_journal(request, check, name) -> None:
    twin = request.getfixturevalue(name)
    result = check(twin.messages)
    assert (result.twin, result.differences) == ('/twin', [])
    assert result.exit_code == 0
    assert len(entries(twin, 'result')) >= 3
    assert result.results == Count(same=len(entries(twin, 'checksum', 'result')))
    assert result.states == Count(same=len(twin.of(TWIN_TOPICS.joint_states)))
    assert 'to the last bit' in result.describe()


def test_two_twins_in_a_bag_are_checked_and_a_foreign_journal_is_reported(ros, tmp_path) -> None:
    first = ros.start_twin('-r', '__ns:=/left').go(1500)
    second = ros.start_twin('-r', '__ns:=/right', layer__thickness=0.01).go(1500)
    foreign = edited(ros.start_twin('-r', '__node:=x').go(1), lambda _entry: {'moved': True})
    messages = sorted(first.messages + second.messages + foreign, key=lambda m: m.log_time)
    with BagReader(write(tmp_path / 'bag', messages)) as reader:
        codes = {result.twin: result.exit_code for result in check_bag(reader)}
    assert codes == {'/left/twin': 0, '/right/twin': 0, '/x': 2}


@pytest.mark.parametrize(('step', 'index', 'bit'), [(0, 0, 63), (610, 2, 30), (2199, 5, 0)])
def test_one_bit_of_a_recorded_state_is_found_and_named(plain, check, step, index, bit) -> None:
    message = plain.of(TWIN_TOPICS.joint_states)[step]
    blank = JointStateEncoder('rig', JOINTS).encode(0, State(*range(1, 7)))
    data = bytearray(message.data)
    data[blank.index(struct.pack('<d', index + 1)) + bit // 8] ^= 1 << bit % 8
    result = check(damaged(plain, message, bytes(data)))
    assert (result.exit_code, result.results.different) == (1, 0)
    assert result.states == Count(same=2199, different=1)
    (difference,) = result.differences
    assert f'step {step}:' in difference
    assert State._fields[index] in difference


@pytest.mark.parametrize('topic', [TWIN_TOPICS.joint_states, TWIN_TOPICS.journal])
def test_unreadable_message_is_a_difference(plain, check, topic) -> None:
    assert check(damaged(plain, plain.of(topic)[2], b'\0\1\0\0\0')).exit_code == 1


@pytest.mark.parametrize(('kind', 'name', 'count'), [
    ('checksum', 'states', 2), ('checksum', 'fields', 1), ('result', 'ejection_speed', 9),
])
def test_wrong_checksums_and_results_are_found_and_named(plain, check, kind, name, count) -> None:
    def edit(entry: dict[str, Any]) -> dict[str, Any]:
        values = entry.get('result', entry)
        if entry['kind'] == kind and name in values:
            value = values[name]
            values[name] = value ^ 1 if kind == 'checksum' else math.nextafter(value, math.inf)
        return entry

    result = check(edited(plain, edit))
    assert result.exit_code == 1
    assert result.results.different == len(result.differences) >= count
    assert all(name in line for line in result.differences)


@pytest.mark.parametrize('values', [
    {'input': 'sing'}, {'values': {'layer.thickness': 'thick'}}, {'values': None},
    {'values': {'gravity': 3.7}}, {'step': 2**61},
])
def test_inconsistent_journal_is_a_difference(plain, check, values) -> None:
    result = check(edited(plain, lambda e: {**e, **values} if e['kind'] == 'input' else e))
    assert result.exit_code == 1
    assert result.results.same >= 6  # the next throws are checked again


@pytest.mark.parametrize('lost', [range(700, 710), range(2090, 2200)])
def test_missing_states_are_counted_and_no_difference(plain, check, lost) -> None:
    states = {id(plain.of(TWIN_TOPICS.joint_states)[number]) for number in lost}
    result = check([item for item in plain.messages if id(item) not in states])
    assert result.exit_code == 0
    assert result.states == Count(same=2200 - len(lost), missing=len(lost))


def test_bag_that_begins_late_is_checked_from_the_next_throw_on(plain, check) -> None:
    since = 450 * MILLISECOND + plain.messages[0].log_time
    result = check([message for message in plain.messages if message.log_time >= since])
    assert result.exit_code == 0
    assert result.states == Count(same=2200 - entries(plain, 'throw')[1]['step'])
    assert result.results.missing == sum(entry['step'] < 450 for entry in entries(plain))


@pytest.mark.parametrize(('name', 'kind'), [('plain', 'throw'), ('measured', 'samples')])
def test_missing_lines_are_counted_and_the_next_throw_is_checked(
    request, check, name, kind
) -> None:
    twin = request.getfixturevalue(name)
    line = entries(twin, kind)[1]['line']
    result = check(edited(twin, lambda entry: None if entry['line'] == line else entry))
    assert (result.exit_code, result.results.missing) == (0, 1)
    assert 0 < result.results.same < len(entries(twin, 'result', 'checksum'))


def test_session_of_another_version_is_reported_as_not_compared(plain, check) -> None:
    result = check(edited(
        plain,
        lambda e: e | {'versions': {**e['versions'], 'numba': '0.1'}} if 'versions' in e else e
    ))
    assert result.exit_code == 2
    assert 'numba 0.1, and this is' in result.reason
    assert result.describe() == result.reason


@pytest.mark.parametrize(('values', 'words'), [
    ({'engine.motion': 'file', 'engine.motion_file': '/etc/passwd'}, '/etc/passwd'),
    ({'layer.library': '/etc/passwd', 'layer.stack': '0.01 silicone'}, 'silicone'),
])
@pytest.mark.parametrize('part', ['settings', 'pending', 'values'])
def test_file_that_a_journal_names_is_not_opened(
    plain, check, monkeypatch, values, words, part
) -> None:
    messages = edited(plain, lambda e: {**e, part: {**e[part], **values}} if part in e else e)
    opened: list[Any] = []
    monkeypatch.setattr(configuration.motions, 'read', opened.append)
    monkeypatch.setattr(configuration.twin, 'library', opened.append)
    result = check(messages)
    assert result.exit_code == 1
    assert any(words in difference for difference in result.differences)
    assert not opened


def test_bag_without_a_twin_is_refused_with_its_topics(plain, check) -> None:
    with pytest.raises(CheckError, match='/twin/joint_states'):
        check(plain.of(TWIN_TOPICS.joint_states))
