# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Comparison of bags with their journals: complete, damaged and foreign bags of sessions."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import json
import math
import struct
from typing import Any

from bags import BEGIN, text, write
import numpy as np
import pytest
from soft_throw_ros import configuration
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.configuration.interface import JOINTS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.check import check_bag, CheckError, CheckResult, Count
from soft_throw_ros.storage.bag_reader import BagReader
from soft_throw_ros.storage.cdr import JointStateEncoder
from soft_throw_ros.storage.message import Message
from soft_throw_ros.twin.results import State
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule
from twin_messages import TwinMessages
from twin_runs import measured_throw


class Twin(TwinMessages):
    """The recorded messages of a twin on a clock set by the test."""

    def restart(self) -> None:
        self.session = Session(TWIN.defaults(), on_entry=self.on_entry)
        self.set_clock(self.now)

    def set_clock(self, now: int) -> None:
        """Change the time at which the next step is due."""
        self.now = now
        self.schedule = TickSchedule(step=self.session.step, time_ns=now, rate=self.session.rate)
        self.session.set_tick_schedule(self.schedule)

    def stall(self, ticks: int) -> None:
        """Skip ticks without a step."""
        late = round((ticks + 0.5) * SECOND / self.schedule.rate)
        now = self.schedule.deadline(self.session.step) + late
        assert self.schedule.skip(step=self.session.step, now=now, max_catch_up=0) == ticks
        self.session.set_tick_schedule(self.schedule)

    def of(self, name: str) -> list[Message]:
        return [message for message in self.messages if message.channel is self.channels[name]]

    def edited(self, edit: Callable[[dict[str, Any]], dict[str, Any] | None]) -> list[Message]:
        """Return the messages with every line of the journal changed, or left out for None."""
        entries = map(edit, map(json.loads, self.journal))
        messages = [
            message._replace(data=text(json.dumps(next(entries))))
            if message.channel is self.channels['journal'] else message
            for message in self.messages
        ]
        return [message for message in messages if message.data != text('null')]

    def damaged(self, message: Message, data: bytes) -> list[Message]:
        return [item._replace(data=data) if item is message else item for item in self.messages]

    def count(self, *kinds: str) -> int:
        return sum(len(self.entries(kind)) for kind in kinds)


@pytest.fixture
def check(tmp_path) -> Callable[..., CheckResult]:
    """Return a function that checks messages of one twin."""

    def check_messages(messages: Iterable[Message]) -> CheckResult:
        with BagReader(write(tmp_path / 'bag', messages)) as reader:
            (result,) = check_bag(reader)
        return result

    return check_messages


@pytest.fixture(scope='module')
def plain() -> Twin:
    """Return a twin with five throws, whose gravity changes after the first one."""
    twin = Twin(throw__period=0.4)
    twin.go(420)
    twin.session.change({'gravity': 9.0})
    twin.go(1780)
    twin.session.close()
    return twin


@pytest.fixture(scope='module')
def eventful() -> Twin:
    """Return a twin with changes, a reset, stalls, a restart and clock jumps within seconds."""
    twin = Twin(throw__max_events=4)
    twin.go(1234)
    twin.session.change({'layer.thickness': 0.0123, 'rate.state': 800.0})
    twin.go(1111)
    twin.session.reset()
    twin.go(77)
    twin.stall(13)  # during a reset
    twin.session.change({'throw.period': 0.0, 'time_scale': 0.1, 'layer.loss_tangent': 0.01})
    twin.go(1500)
    twin.session.request_throw()
    twin.go(400)
    twin.stall(100)  # in mid-flight
    twin.go(1000)
    twin.session.close()
    twin.now += SECOND
    twin.restart()  # with the default settings
    for jump in (-SECOND // 3, 5 * SECOND):
        twin.go(1000)
        twin.set_clock(twin.now + jump)
    twin.go(1000)
    twin.session.close()
    return twin


@pytest.fixture(scope='module')
def measured() -> Twin:
    """Return a twin of three measured throws with changes and a stall in between."""
    twin = Twin(engine__motion='measured', measured__latency=2e-4)
    twin.go(20)
    for seed, duration in enumerate((0.2, 0.25, 0.3)):
        samples = measured_throw(
            Rig(), begin_ns=twin.schedule.deadline(twin.session.step), noise=5e-6, jitter=0.4,
            seed=seed, duration=duration,
        )
        delays = np.random.default_rng(seed).integers(0, 900_000, len(samples)).tolist()
        twin.send(samples, delays)
        twin.receive()
        twin.stall(13)
        twin.session.reset()
        twin.session.change({'layer.wave_speed': 8.1, 'measured.smoothing_window': 1.6e-3})
        twin.set_clock(twin.now + SECOND // 2)
    twin.session.close()
    return twin


# all the same


@pytest.mark.parametrize('name', ['plain', 'eventful', 'measured'])
def test_bag_agrees_with_its_journal(request, check, name) -> None:
    twin = request.getfixturevalue(name)
    result = check(twin.messages)
    assert (result.twin, result.differences) == ('/twin', [])
    assert result.exit_code == 0
    assert twin.count('result') >= 3
    assert result.results == Count(same=twin.count('checksum', 'result'))
    assert result.states == Count(same=len(twin.of('joint_states')))
    assert 'to the last bit' in result.describe()


def test_two_twins_in_a_bag_are_checked_and_a_foreign_journal_is_reported(tmp_path) -> None:
    first, second, arm = Twin('/left/twin'), Twin('/right/twin', layer__thickness=0.01), Twin('/x')
    first.go(1500)
    second.go(2500)
    arm.go(1)
    foreign = arm.edited(lambda _entry: {'moved': True})
    messages = sorted(first.messages + second.messages + foreign, key=lambda m: m.log_time)
    with BagReader(write(tmp_path / 'bag', messages)) as reader:
        results = {result.twin: result for result in check_bag(reader)}
    codes = {name: result.exit_code for name, result in results.items()}
    assert codes == {'/left/twin': 0, '/right/twin': 0, '/x': 2}
    assert results['/right/twin'].results.same >= 3
    assert results['/x'].reason


# something different


@pytest.mark.parametrize(('step', 'index', 'bit'), [(0, 0, 63), (610, 2, 30), (2199, 5, 0)])
def test_one_bit_of_a_recorded_state_is_found_and_named(plain, check, step, index, bit) -> None:
    message = plain.of('joint_states')[step]
    blank = JointStateEncoder('rig', JOINTS).encode(0, State(*range(1, 7)))
    data = bytearray(message.data)
    data[blank.index(struct.pack('<d', index + 1)) + bit // 8] ^= 1 << bit % 8
    result = check(plain.damaged(message, bytes(data)))
    assert (result.exit_code, result.results.different) == (1, 0)
    assert result.states == Count(same=2199, different=1)
    (difference,) = result.differences
    assert f'step {step}:' in difference
    assert State._fields[index] in difference


@pytest.mark.parametrize('topic', ['joint_states', 'journal'])
def test_unreadable_message_is_a_difference(plain, check, topic) -> None:
    assert check(plain.damaged(plain.of(topic)[2], b'\0\1\0\0\0')).exit_code == 1


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

    result = check(plain.edited(edit))
    assert result.exit_code == 1
    assert result.results.different == len(result.differences) >= count
    assert all(name in line for line in result.differences)


@pytest.mark.parametrize('values', [
    {'input': 'sing'}, {'values': {'layer.thickness': 'thick'}}, {'values': None},
    {'values': {'gravity': 3.7}}, {'step': 2**61},
])
def test_inconsistent_journal_is_a_difference(plain, check, values) -> None:
    result = check(plain.edited(lambda e: {**e, **values} if e['kind'] == 'input' else e))
    assert result.exit_code == 1
    assert result.results.same >= 6  # the next throws are checked again


# messages that are missing


@pytest.mark.parametrize('lost', [range(700, 710), range(2090, 2200)])
def test_missing_states_are_counted_and_no_difference(plain, check, lost) -> None:
    states = {id(plain.of('joint_states')[number]) for number in lost}
    result = check([item for item in plain.messages if id(item) not in states])
    assert result.exit_code == 0
    assert result.states == Count(same=2200 - len(lost), missing=len(lost))


def test_bag_that_begins_late_is_checked_from_the_next_throw_on(plain, check) -> None:
    since = BEGIN + 450_000_000
    result = check([message for message in plain.messages if message.log_time >= since])
    assert result.exit_code == 0
    assert result.states == Count(same=2200 - plain.starts()[1])
    assert result.results.missing == sum(json.loads(e)['step'] < 450 for e in plain.journal)


@pytest.mark.parametrize(('name', 'kind'), [('plain', 'throw'), ('measured', 'samples')])
def test_missing_lines_are_counted_and_the_next_throw_is_checked(
    request, check, name, kind
) -> None:
    twin = request.getfixturevalue(name)
    line = twin.entries(kind)[1]['line']
    result = check(twin.edited(lambda entry: None if entry['line'] == line else entry))
    assert (result.exit_code, result.results.missing) == (0, 1)
    assert 0 < result.results.same < twin.count('result', 'checksum')


# bags that are not compared


def test_session_of_another_version_is_reported_as_not_compared(plain, check) -> None:
    result = check(plain.edited(
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
    messages = plain.edited(lambda e: {**e, part: {**e[part], **values}} if part in e else e)
    opened: list[Any] = []
    monkeypatch.setattr(configuration.motions, 'read', opened.append)
    monkeypatch.setattr(configuration.twin, 'library', opened.append)
    result = check(messages)
    assert result.exit_code == 1
    assert any(words in difference for difference in result.differences)
    assert not opened


def test_bag_without_a_twin_is_refused_with_its_topics(plain, tmp_path) -> None:
    path = write(tmp_path / 'bag', plain.of('joint_states'))
    with BagReader(path) as reader, pytest.raises(CheckError, match='/twin/joint_states'):
        check_bag(reader)
