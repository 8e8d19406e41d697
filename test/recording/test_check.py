# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of bags with their journals: complete, damaged and foreign bags of sessions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
import json
import math
from pathlib import Path
import struct
from typing import Any

from bags import text, write
import pytest
from ros_nodes import DrivenTwin, MILLISECOND, Ros
from soft_throw_ros import configuration
from soft_throw_ros.configuration.interface import JOINTS, TWIN_TOPICS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.check import check_bag, CheckError, CheckResult
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


def check(folder: Path, messages: Iterable[Message]) -> CheckResult:
    """Check messages of one twin."""
    with BagReader(write(folder / 'bag', messages)) as reader:
        (result,) = check_bag(reader)
    return result


@pytest.fixture(scope='module')
def plain(module_ros: Ros) -> DrivenTwin:
    """Return a twin with five throws, whose gravity changes after the first one."""
    twin = module_ros.start_twin(throw__period=0.4).go(419)
    twin.change(gravity=9.0)
    twin.go(1780)
    twin.finish()
    return twin


@pytest.fixture(scope='module')
def measured(module_ros: Ros) -> DrivenTwin:
    """Return a twin of three measured throws with changes and stalls, which starts again."""
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
    again = module_ros.node(DrivenTwin, clock=twin.clock)  # with the default settings
    again.messages[:0] = twin.messages
    again.go(500)
    again.advance(125 * MILLISECOND)  # in mid-flight
    again.finish()
    return again


@pytest.mark.parametrize('name', ['plain', 'measured'])
def test_bag_agrees_with_its_journal(request, tmp_path, name) -> None:
    twin = request.getfixturevalue(name)
    result = check(tmp_path, twin.messages)
    assert (result.twin, result.differences) == ('/twin', [])
    assert result.exit_code == 0
    assert len(entries(twin, 'result')) >= 3
    assert result.results == Counter(same=len(entries(twin, 'checksum', 'result')))
    assert result.states == Counter(same=len(twin.of(TWIN_TOPICS.joint_states)))
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
def test_one_bit_of_a_recorded_state_is_found_and_named(plain, tmp_path, step, index, bit) -> None:
    message = plain.of(TWIN_TOPICS.joint_states)[step]
    blank = JointStateEncoder('rig', JOINTS).encode(0, State(*range(1, 7)))
    data = bytearray(message.data)
    data[blank.index(struct.pack('<d', index + 1)) + bit // 8] ^= 1 << bit % 8
    result = check(tmp_path, damaged(plain, message, bytes(data)))
    assert (result.exit_code, result.results['different']) == (1, 0)
    assert result.states == Counter(same=2199, different=1)
    (difference,) = result.differences
    assert f'step {step}:' in difference
    assert State._fields[index] in difference


@pytest.mark.parametrize('topic', [TWIN_TOPICS.joint_states, TWIN_TOPICS.journal])
def test_unreadable_message_is_a_difference(plain, tmp_path, topic) -> None:
    assert check(tmp_path, damaged(plain, plain.of(topic)[2], b'\0\1\0\0\0')).exit_code == 1


@pytest.mark.parametrize(('kind', 'name', 'count'), [
    ('checksum', 'states', 2), ('checksum', 'fields', 1), ('result', 'ejection_speed', 9),
])
def test_wrong_checksums_and_results_are_named(plain, tmp_path, kind, name, count) -> None:
    def edit(entry: dict[str, Any]) -> dict[str, Any]:
        values = entry.get('result', entry)
        if entry['kind'] == kind and name in values:
            value = values[name]
            values[name] = value ^ 1 if kind == 'checksum' else math.nextafter(value, math.inf)
        return entry

    result = check(tmp_path, edited(plain, edit))
    assert result.exit_code == 1
    assert result.results['different'] == len(result.differences) >= count
    assert all(name in line for line in result.differences)


@pytest.mark.parametrize('values', [
    {'input': 'sing'}, {'values': {'layer.thickness': 'thick'}}, {'values': None},
    {'values': {'gravity': 3.7}}, {'step': 2**61},
])
def test_inconsistent_journal_is_a_difference(plain, tmp_path, values) -> None:
    result = check(tmp_path, edited(plain, lambda e: e | values if e['kind'] == 'input' else e))
    assert result.exit_code == 1
    assert result.results['same'] >= 6  # the next throws are checked again


def test_result_that_the_repetition_does_not_give_is_a_difference(plain, tmp_path) -> None:
    *_, last = entries(plain)
    *_, entry = entries(plain, 'result')
    data = text(json.dumps({**entry, 'line': last['line'] + 1, 'step': last['step']}))
    messages = [*plain.messages, plain.of(TWIN_TOPICS.journal)[-1]._replace(data=data)]
    (difference,) = check(tmp_path, messages).differences
    assert 'result is not repeated' in difference


@pytest.mark.parametrize('lost', [range(700, 710), range(2090, 2200)])
def test_missing_states_are_counted_and_no_difference(plain, tmp_path, lost) -> None:
    states = {id(plain.of(TWIN_TOPICS.joint_states)[number]) for number in lost}
    result = check(tmp_path, [item for item in plain.messages if id(item) not in states])
    expected = Counter(same=2200 - len(lost), missing=len(lost))
    assert (result.exit_code, result.states) == (0, expected)


def test_bag_that_begins_late_is_checked_from_the_next_throw_on(plain, tmp_path) -> None:
    since = 450 * MILLISECOND + plain.messages[0].log_time
    result = check(tmp_path, [message for message in plain.messages if message.log_time >= since])
    step = entries(plain, 'throw')[1]['step']
    assert (result.exit_code, result.states) == (0, Counter(same=2200 - step))
    assert result.results['missing'] == sum(entry['step'] < 450 for entry in entries(plain))


def test_session_of_another_version_is_reported_as_not_compared(plain, tmp_path) -> None:
    other = {'versions': {**entries(plain)[0]['versions'], 'numba': '0.1'}}
    result = check(tmp_path, edited(plain, lambda e: e | other if 'versions' in e else e))
    assert result.exit_code == 2
    assert 'numba 0.1, and this is' in result.reason
    assert result.describe() == result.reason


@pytest.mark.parametrize(('values', 'words'), [
    ({'engine.motion': 'file', 'engine.motion_file': '/etc/passwd'}, '/etc/passwd'),
    ({'layer.library': '/etc/passwd', 'layer.stack': '0.01 silicone'}, 'silicone'),
])
@pytest.mark.parametrize('part', ['settings', 'pending', 'values'])
def test_file_that_a_journal_names_is_not_opened(
    plain, tmp_path, monkeypatch, values, words, part
) -> None:
    messages = edited(plain, lambda e: {**e, part: {**e[part], **values}} if part in e else e)
    opened: list[Any] = []
    monkeypatch.setattr(configuration.motions, 'read', opened.append)
    monkeypatch.setattr(configuration.twin, 'library', opened.append)
    result = check(tmp_path, messages)
    assert result.exit_code == 1
    assert any(words in difference for difference in result.differences)
    assert not opened


def test_bag_without_a_twin_is_refused_with_its_topics(plain, tmp_path) -> None:
    with pytest.raises(CheckError, match='/twin/joint_states'):
        check(tmp_path, plain.of(TWIN_TOPICS.joint_states))
