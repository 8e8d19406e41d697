# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Whether bags are what their journals give: bags of sessions, whole, damaged and foreign."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import json
import math
from pathlib import Path
import runpy
import struct
from typing import Any

from bags import BEGIN, text, write
import numpy as np
import pytest
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.cdr import JointStateEncoder
from soft_throw_ros.recording.check import check_bag, CheckError, CheckResult, JOINTS
from soft_throw_ros.recording.message import Message
from soft_throw_ros.twin.results import State
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule

HERE = Path(__file__).parent
rigs: Any = runpy.run_path(str(HERE.parent / 'twin' / 'rigs.py'))
twins: Any = runpy.run_path(str(HERE / 'twin_messages.py'))


class Twin(twins['TwinMessages']):
    """A twin whose clock shows what the test says, and what a recorder gets of it."""

    def restart(self) -> None:
        self.session = Session(TWIN.defaults(), on_entry=self._on_entry)
        self.set_clock(self.now)

    def set_clock(self, now: int) -> None:
        """Have the next step be due at another time."""
        self.now = now
        self.pace = TickSchedule(step=self.session.step, time_ns=now, rate=self.session.rate)
        self.session.set_tick_schedule(self.pace)

    def stall(self, ticks: int) -> None:
        """Let so many ticks go without a step."""
        late = round((ticks + 0.5) * SECOND / self.pace.rate)
        now = self.pace.deadline(self.session.step) + late
        assert self.pace.skip(step=self.session.step, now=now, max_catch_up=0) == ticks
        self.session.set_tick_schedule(self.pace)

    def throw(self, seed: int, **kwargs: Any) -> None:
        """Measure a throw, and what comes after it."""
        begin_ns = self.pace.deadline(self.session.step)
        samples = rigs['measured_throw'](
            Rig(), begin_ns=begin_ns, noise=5e-6, jitter=0.4, seed=seed, **kwargs
        )
        delays = np.random.default_rng(seed).integers(0, 900_000, len(samples)).tolist()
        arrivals = sorted(
            (sample.stamp_ns + delay, sample)
            for sample, delay in zip(samples, delays, strict=True)
        )
        while arrivals:
            now = self.pace.deadline(self.session.step)
            count = sum(arrival <= now for arrival, _ in arrivals)
            self.session.measure([sample for _, sample in arrivals[:count]])
            del arrivals[:count]
            self.go(1)

    def of(self, name: str) -> list[Message]:
        return [message for message in self.messages if message.channel is self.channels[name]]

    def entries(self) -> list[dict[str, Any]]:
        return [entry_of(message) for message in self.of('journal')]

    def edited(self, edit: Callable[[dict[str, Any]], dict[str, Any] | None]) -> list[Message]:
        """Return the messages with every line of the journal changed, or left out for None."""
        messages = []
        for message in self.messages:
            if message.channel is self.channels['journal']:
                entry = edit(entry_of(message))
                if entry is not None:
                    messages.append(message._replace(data=text(json.dumps(entry))))
            else:
                messages.append(message)
        return messages

    def damaged(self, message: Message, data: bytes) -> list[Message]:
        return [
            other._replace(data=data) if other is message else other for other in self.messages
        ]


def entry_of(message: Message) -> dict[str, Any]:
    length = int.from_bytes(message.data[4:8], 'little')
    entry = json.loads(message.data[8:7 + length])
    assert isinstance(entry, dict)
    return entry


@pytest.fixture
def check(tmp_path) -> Callable[[Iterable[Message]], CheckResult]:
    """Give what checks the messages of one twin."""

    def check_messages(messages: Iterable[Message]) -> CheckResult:
        with BagReader(write(tmp_path / 'bag', messages)) as reader:
            (result,) = check_bag(reader)
        return result

    return check_messages


@pytest.fixture(scope='module')
def plain() -> Twin:
    """Give a twin that throws five times, and nothing else."""
    twin = Twin(throw__period=0.4)
    twin.go(2100)
    twin.session.close()
    return twin


@pytest.fixture(scope='module')
def eventful() -> Twin:
    """Give a twin that all kinds of things happen to, in a few seconds."""
    twin = Twin(throw__max_events=4)
    twin.go(1234)
    twin.session.change({'layer.thickness': 0.0123, 'rate.state': 800.0})
    twin.session.change({'max_strain': 0.3})
    twin.go(1111)
    twin.session.reset()
    twin.go(77)
    twin.stall(13)  # while things are being put back
    twin.go(300)
    twin.session.change({'throw.period': 0.6, 'model': 'finite_difference'})
    twin.go(500)
    twin.stall(7)  # in mid-flight
    twin.go(1200)
    twin.session.change({'throw.period': 0.0, 'time_scale': 0.1, 'rate.field': 333.0})
    twin.go(1400)
    twin.session.request_throw()
    twin.go(400)
    twin.stall(100)
    twin.go(1000)
    twin.session.close()
    twin.now += SECOND
    twin.restart()  # with other settings than it had
    twin.go(1500)
    twin.set_clock(twin.now - SECOND // 3)  # somebody sets the clock back
    twin.go(1000)
    twin.set_clock(twin.now + 5 * SECOND)
    twin.go(1000)
    twin.session.close()
    return twin


@pytest.fixture(scope='module')
def measured() -> Twin:
    """Give a twin that follows three throws, and is changed and stalled meanwhile."""
    twin = Twin(engine__motion='measured', measured__wait=2e-4)
    twin.go(20)
    twin.throw(1, duration=0.2)
    twin.stall(13)
    twin.session.reset()
    twin.session.change({'layer.wave_speed': 8.1, 'measured.window': 1.6e-3})
    twin.throw(2)
    twin.session.reset()
    twin.set_clock(twin.now + SECOND // 2)
    twin.throw(3, duration=0.3)
    twin.go(5)
    twin.session.close()
    assert twin.session.throws == 3
    return twin


# all the same


@pytest.mark.parametrize('name', ['plain', 'eventful', 'measured'])
def test_bag_is_what_its_journal_gives(request, check, name) -> None:
    twin = request.getfixturevalue(name)
    result = check(twin.messages)
    assert result.exit_code == 0
    assert (result.twin, result.differences, result.gaps) == ('/twin', [], [])
    kinds = [entry['kind'] for entry in twin.entries()]
    assert kinds.count('result') >= 3
    for count, kind in ((result.checksums, 'checksum'), (result.results, 'result')):
        assert vars(count) == {'same': kinds.count(kind), 'different': 0, 'unchecked': 0}
    assert vars(result.states) == vars(result.checksums)
    assert 'to the last bit' in result.describe()


def test_messages_that_are_logged_two_seconds_late_make_no_difference(plain, check) -> None:
    random = np.random.default_rng(3)
    late = [
        message._replace(log_time=message.log_time + int(random.integers(0, 2 * SECOND)))
        for message in plain.of('joint_states')
    ]
    messages = sorted([*plain.of('journal'), *late], key=lambda message: message.log_time)
    result = check(messages)
    assert result.exit_code == 0
    assert result.states.same == result.checksums.same
    assert result.states.unchecked == 0


def test_lost_states_leave_seconds_incomplete_and_nothing_different(plain, check) -> None:
    lost, damaged = plain.of('joint_states')[700], plain.of('joint_states')[1500]
    result = check([
        item._replace(data=b'') if item is damaged else item
        for item in plain.messages if item is not lost
    ])
    assert result.exit_code == 0
    assert result.states.unchecked == 2
    assert result.states.same + 2 == result.checksums.same


def test_recorder_without_history_checks_from_the_next_throw_on(plain, check) -> None:
    since = BEGIN + 450_000_000
    result = check([message for message in plain.messages if message.log_time >= since])
    assert result.exit_code == 0
    assert result.gaps == []
    begins = [entry['step'] for entry in plain.entries() if entry['kind'] == 'throw']
    checked = [
        entry for entry in plain.entries()
        if entry['kind'] == 'checksum' and entry['first'] >= begins[1]
    ]
    assert vars(result.states) == {'same': len(checked), 'different': 0, 'unchecked': 0}


def test_two_twins_in_a_bag_are_both_checked_and_another_journal_is_told(tmp_path) -> None:
    first, second, arm = Twin('/left/twin'), Twin('/right/twin', layer__thickness=0.01), Twin('/x')
    first.go(1500)
    second.go(2500)
    arm.go(1)
    foreign = arm.edited(lambda _entry: {'moved': True})
    messages = sorted(
        first.messages + second.messages + foreign, key=lambda message: message.log_time
    )
    with BagReader(write(tmp_path / 'bag', messages)) as reader:
        results = {result.twin: result for result in check_bag(reader)}
    codes = {name: result.exit_code for name, result in results.items()}
    assert codes == {'/left/twin': 0, '/right/twin': 0, '/x': 2}
    assert results['/right/twin'].results.same == 3
    assert results['/x'].reason


# something different


@pytest.mark.parametrize(('index', 'bit'), [*enumerate([0, 30, 63, 0, 30, 63])])
def test_one_bit_of_a_recorded_state_is_found_and_named(plain, check, index, bit) -> None:
    blank = JointStateEncoder('rig', JOINTS).encode(0, State(*range(1, 7)))
    offset = blank.index(struct.pack('<d', index + 1)) + bit // 8
    message = plain.of('joint_states')[610]
    data = bytearray(message.data)
    data[offset] ^= 1 << bit % 8
    result = check(plain.damaged(message, bytes(data)))
    assert result.exit_code == 1
    assert (result.states.different, result.checksums.different) == (1, 0)
    (difference,) = result.differences
    assert 'step 610' in difference
    assert State._fields[index] in difference


@pytest.mark.parametrize(
    ('kind', 'name'), [('checksum', 'states'), ('checksum', 'fields'), ('result', 'states')]
)
def test_another_checksum_is_found(plain, check, kind, name) -> None:
    (line, *_) = [
        entry['line'] for entry in plain.entries() if entry['kind'] == kind and name in entry
    ]
    result = check(plain.edited(lambda e: {**e, name: e[name] ^ 1} if e['line'] == line else e))
    assert result.exit_code == 1
    assert result.checksums.different + result.results.different == 1


def test_other_numbers_of_results_are_found_and_named(plain, check) -> None:
    names = {2: 'ejection_speed', 3: 'recontacts'}

    def edit(entry: dict[str, Any]) -> dict[str, Any]:
        name = names.get(entry['result']['throw']) if entry['kind'] == 'result' else None
        if name is None:
            return entry
        value = entry['result'][name]
        other = math.nextafter(value, 1e9) if isinstance(value, float) else value + 1
        return {**entry, 'result': {**entry['result'], name: other}}

    result = check(plain.edited(edit))
    assert result.exit_code == 1
    assert result.results.different == len(result.differences) == 4
    for said in result.differences:
        assert any(f'throw {number}' in said and name in said for number, name in names.items())


# lines of the journal that are missing


def test_missing_lines_are_told_and_the_next_throw_is_checked(plain, check) -> None:
    lines = [e['line'] for e in plain.entries() if e['kind'] == 'throw' and e['throw'] == 3]
    result = check(plain.edited(lambda e: None if e['line'] in lines else e))
    whole = sum(entry['kind'] == 'result' for entry in plain.entries())
    assert result.exit_code == 0
    assert len(result.gaps) == 1
    assert 'throw 2' in result.gaps[0]
    assert result.results.same == whole - 2


def test_of_a_measured_throw_missing_samples_are_told_and_a_missing_end_is_none(
    measured, check, tmp_path
) -> None:
    entries = measured.entries()
    samples = [entry['line'] for entry in entries if entry['kind'] == 'samples'][1]
    last = max(entry['line'] for entry in entries if entry['kind'] == 'result')
    result = check(
        measured.edited(lambda e: None if e['line'] == samples or e['line'] > last else e)
    )
    assert (result.exit_code, len(result.gaps)) == (0, 1)
    assert result.results.same > 0


@pytest.mark.parametrize(
    'values',
    [
        {'input': 'sing'},
        {'values': {'layer.thickness': 'thick'}},
        {'values': None},
        {'values': {'gravity': 3.7}},
        {'step': 2**61},
    ],
)
def test_journal_that_does_not_fit_is_different(check, values) -> None:
    twin = Twin(throw__period=0.3)
    twin.go(350)
    twin.session.change({'gravity': 9.0})
    twin.go(1000)
    result = check(twin.edited(lambda e: {**e, **values} if e['kind'] == 'input' else e))
    assert result.exit_code == 1
    assert result.results.same >= 1  # the next throw is checked again


# other versions, and bags that cannot be checked


def foreign(entry: dict[str, Any]) -> dict[str, Any]:
    """Let an entry be of another version, with other last bits in its numbers."""
    if 'versions' in entry:
        return {**entry, 'versions': {**entry['versions'], 'numba': '0.1'}}
    if entry['kind'] == 'checksum':
        return {**entry, 'states': 0}
    if entry['kind'] == 'result':
        values = {
            name: value * (1.0 + 3e-13) if isinstance(value, float) else value
            for name, value in entry['result'].items()
        }
        return {**entry, 'result': values, **({'states': 0} if 'states' in entry else {})}
    return entry


@pytest.mark.parametrize(('step', 'factor', 'code'), [
    (810, 1.0 + 1e-13, 0),
    (810, 1.0 + 1e-9, 1),  # before the projectile lands
    (1100, 1.0 + 1e-6, 0),  # and after it
])
def test_other_versions_may_have_other_last_bits_until_the_landing(
    check, step, factor, code
) -> None:
    twin = Twin(throw__period=0.8)
    twin.go(1600)
    twin.session.close()
    twin.messages = twin.edited(foreign)
    message = twin.of('joint_states')[step]
    data = bytearray(message.data)
    (value,) = struct.unpack_from('<d', data, len(data) - 16)
    struct.pack_into('<d', data, len(data) - 16, value * factor if value else factor - 1.0)
    result = check(twin.damaged(message, bytes(data)))
    assert result.exit_code == code
    assert result.versions['numba'][0] == '0.1'
    assert '0.1' in result.describe()
    assert '1e-12' in result.describe()
    assert result.checksums.same == result.checksums.different == 0
    assert result.results.different == 0
    assert result.results.same >= 1


def test_bag_without_checksums_says_why_it_cannot_be_checked(plain, check) -> None:
    def old(entry: dict[str, Any]) -> dict[str, Any] | None:
        if entry['kind'] in ('checksum', 'result'):
            return None
        if 'versions' in entry:
            entry['versions']['soft_throw_ros'] = '0.5.0'
        del entry['line']
        return entry

    result = check(plain.edited(old))
    assert result.exit_code == 2
    assert 'checksums' in result.reason
    assert '0.5.0' in result.reason
    assert result.describe() == result.reason


def test_bag_without_a_twin_is_refused_with_what_it_has(plain, tmp_path) -> None:
    path = write(tmp_path / 'bag', plain.of('joint_states'))
    with BagReader(path) as reader, pytest.raises(CheckError, match='/twin/joint_states'):
        check_bag(reader)
