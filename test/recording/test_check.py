# SPDX-License-Identifier: Apache-2.0
"""Whether bags are what their journals give: bags of sessions, whole, damaged and foreign."""

from __future__ import annotations

from collections.abc import Callable, Iterable
import contextlib
from itertools import pairwise
import math
from pathlib import Path
import struct
from typing import Any

import hypothesis
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.cdr import ArrayEncoder, decode_joint_states, JointStateEncoder
from soft_throw_ros.recording.check import BagCheck, CheckError, Report
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.pace import Pace
from soft_throw_ros.twin.results import Outputs, State
from soft_throw_ros.twin.session import Refused, Session

SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND + 123_456_789

_TEXT = 'std_msgs/msg/String'
_ARRAY = 'std_msgs/msg/Float64MultiArray'
_SCHEMAS = {
    _TEXT: 'string data',
    _ARRAY: 'float64[] data',  # arrays are read without it
    'sensor_msgs/msg/JointState': """\
std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
""",
}
_TOPICS = {
    'joint_states': 'sensor_msgs/msg/JointState',
    'layer/strain': _ARRAY,
    'layer/velocity': _ARRAY,
    'throw_field': _ARRAY,
    'phase': _TEXT,
    'journal': _TEXT,
}


def text(line: str) -> bytes:
    data = line.encode() + b'\0'
    return b'\0\1\0\0' + struct.pack('<I', len(data)) + data


class Twin:
    """A twin whose clock shows what the test says, and all that a recorder would get of it."""

    def __init__(self, begin: int = BEGIN, node: str = '/twin', **request: Any) -> None:
        self.messages: list[Message] = []
        self.channels = {
            name: Channel(topic=f'{node}/{name}', type=kind, schema=_SCHEMAS[kind])
            for name, kind in _TOPICS.items()
        }
        self._state = JointStateEncoder('rig', ('plate', 'projectile')).encode
        self._field = ArrayEncoder({'y': 64}).encode
        self._throw_field = ArrayEncoder({'t': 200, 'y': 64}).encode
        self.now = begin
        self.restart(**request)

    def restart(self, **request: Any) -> None:
        named = {name.replace('__', '.'): value for name, value in request.items()}
        settings = {**TWIN.defaults(), **TWIN.change(TWIN.defaults(), named)}
        self.session = Session(settings, on_entry=self._on_entry)
        self.set_clock(self.now)

    def set_clock(self, now: int) -> None:
        """Have the next step be due at another time."""
        self.now = now
        self.pace = Pace(step=self.session.step, time_ns=now, rate=self.session.rate)
        self.session.keep_pace(self.pace)

    def stall(self, ticks: int) -> None:
        """Let so many ticks go without a step."""
        due = self.pace.deadline(self.session.step)
        late = round((ticks + 0.5) * SECOND / self.pace.rate)
        assert self.pace.skip(step=self.session.step, now=due + late, max_catch_up=0) == ticks
        self.session.keep_pace(self.pace)

    def go(self, steps: int) -> None:
        """Go so many steps on, as the ticker of the node does."""
        for _ in range(steps):
            self.now = self.pace.deadline(self.session.step)
            self._publish(self.session.advance())
            if self.session.rate != self.pace.rate:
                self.pace.change_rate(step=self.session.step - 1, rate=self.session.rate)
                self.session.keep_pace(self.pace)

    def change(self, **values: Any) -> None:
        self.session.change({name.replace('__', '.'): value for name, value in values.items()})

    def _publish(self, outputs: Outputs) -> None:
        self._send('joint_states', self._state(self.now, outputs.state))
        if outputs.field is not None:
            self._send('layer/strain', self._field(outputs.field.strain))
            self._send('layer/velocity', self._field(outputs.field.velocity))
        for phase in outputs.phases:
            self._send('phase', text(phase.value), late=1_500_000)
        if outputs.throw_field is not None:
            self._send(
                'throw_field', self._throw_field(outputs.throw_field.strain), late=1_500_000
            )

    def _on_entry(self, line: str) -> None:
        self._send('journal', text(line), late=2_500_000)

    def _send(self, name: str, data: bytes, late: int = 30_000) -> None:
        self.messages.append(
            Message(self.channels[name], data, self.now + late, self.now + late - 10_000)
        )


def write(path: Path, messages: Iterable[Message], **kwargs: Any) -> Path:
    with BagWriter(path, distribution='jazzy', **kwargs) as writer:
        for message in messages:
            writer.write(message)
    return path


def check(path: Path) -> Report:
    """Check a bag with one twin."""
    with BagReader(path) as reader:
        (report,) = BagCheck(reader).run()
        assert not reader.damage
    return report


def repeat(path: Path, to: Path) -> Report:
    """Check a bag, and write what comes when it is repeated."""
    with BagReader(path) as reader, BagWriter(to, distribution='jazzy') as writer:
        (report,) = BagCheck(reader).run(writer)
    return report


def by_topic(messages: Iterable[Message]) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = {}
    for message in messages:
        found.setdefault(message.channel.topic, []).append(message.data)
    return found


def is_of(message: Message, name: str) -> bool:
    return message.channel.topic == f'/twin/{name}'


def step_entry(message: Message) -> dict[str, Any]:
    """Return the entry of a message of a journal."""
    return journal.decode(message.data[8:-1].decode())


def is_entry(message: Message, **values: Any) -> bool:
    """Tell whether a message is a line of the journal with such values."""
    if not is_of(message, 'journal'):
        return False
    entry = step_entry(message)
    return all(entry.get(name) == value for name, value in values.items())


@pytest.fixture(scope='module')
def eventful() -> Twin:
    """A twin that all kinds of things happen to, in a few seconds."""
    twin = Twin(throw__max_events=4)
    twin.go(1234)
    twin.change(layer__thickness=0.0123, rate__state=800.0)
    twin.change(max_strain=0.3)
    twin.go(1111)
    twin.session.reset()
    twin.go(77)
    twin.stall(13)  # while things are being put back
    twin.go(300)
    twin.change(throw__period=0.6)
    twin.go(500)
    twin.stall(7)  # in mid-flight
    twin.go(1200)
    twin.change(throw__period=0.0, time_scale=0.1, rate__field=333.0)
    twin.go(1400)
    twin.session.ask_throw()
    twin.go(400)
    twin.stall(100)
    twin.go(1000)
    twin.now += SECOND
    twin.restart()  # with other settings than it had
    twin.go(1500)
    twin.set_clock(twin.now - SECOND // 3)  # somebody sets the clock back
    twin.go(1000)
    twin.set_clock(twin.now + 5 * SECOND)
    twin.go(1000)
    return twin


@pytest.fixture(scope='module')
def plain() -> Twin:
    """A twin that throws four times, and nothing else."""
    twin = Twin(throw__period=0.3)
    twin.go(1300)
    return twin


def states_of(twin: Twin) -> list[Message]:
    return [message for message in twin.messages if is_of(message, 'joint_states')]


# all the same


@pytest.mark.parametrize('name', ['plain', 'eventful'])
def test_bag_of_a_twin_is_what_its_journal_gives(request, tmp_path, name) -> None:
    twin = request.getfixturevalue(name)
    report = check(write(tmp_path / 'bag', twin.messages))
    counts = {topic: len(datas) for topic, datas in by_topic(twin.messages).items()}
    assert report.twin == '/twin'
    assert report.exit_code == 0
    assert vars(report.states) == {
        'same': counts['/twin/joint_states'], 'different': 0, 'unchecked': 0
    }  # fmt: skip
    assert (report.lost, report.before, report.gaps, report.misfits) == (0, 0, [], [])
    for side, tally in report.sides.items():
        # what comes in the seconds after the clock was set may be older
        assert tally.different == 0
        assert tally.same + tally.unchecked == counts[f'/twin/{side}']
        assert name == 'eventful' or tally.unchecked == 0
    assert next(report.lines()) == (
        f'{counts["/twin/joint_states"]} states are the same to the last bit, '
        '0 are different, 0 were lost by the recorder'
    )


def test_lost_messages_are_skipped_and_counted(eventful, tmp_path) -> None:
    states = states_of(eventful)
    random = np.random.default_rng(5)
    lost = {id(states[index]) for index in random.choice(len(states), 2000, replace=False)}
    lost |= {id(states[index]) for index in range(3600, 4700)}  # two throws at once
    lost -= {id(states[0]), id(states[-1])}
    for pair in pairwise(states):  # what is missing at the end of a session, nobody knows
        if pair[1].log_time - pair[0].log_time > SECOND // 2:
            lost -= set(map(id, pair))
    sides = [message for message in eventful.messages if is_of(message, 'layer/strain')]
    lost_sides = {id(message) for message in sides if random.random() < 0.3}
    kept = [message for message in eventful.messages if id(message) not in lost | lost_sides]
    report = check(write(tmp_path / 'bag', kept))
    assert report.exit_code == 0
    assert report.lost == len(lost)
    assert report.states.same == len(states) - len(lost)


@pytest.mark.parametrize('at', [0.4, 1.2, 2.04, 2.999])
def test_recorder_that_comes_late_checks_from_the_throw_under_way_on(tmp_path, at) -> None:
    twin = Twin()
    twin.go(4200)
    since = BEGIN + round(at * SECOND)
    before = [message for message in twin.messages if message.log_time < since]
    history = [message for message in before if is_of(message, 'journal')]
    history += [message for message in before if is_of(message, 'phase')][-10:]
    history += [message for message in before if is_of(message, 'throw_field')][-1:]
    messages = [message._replace(log_time=since) for message in history]
    messages += [message for message in twin.messages if message.log_time >= since]
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 0
    assert report.states.same == sum(is_of(message, 'joint_states') for message in messages)
    assert (report.lost, report.before, report.states.unchecked) == (0, 0, 0)
    for name, tally in report.sides.items():
        count = sum(is_of(message, name) for message in messages)
        assert tally.same + tally.unchecked == count
        assert tally.same >= 0.5 * (count - 100)


def test_states_before_the_first_start_that_is_known_are_not_checked(plain, tmp_path) -> None:
    since = BEGIN + 450_000_000  # and a recorder that gets no history
    messages = [message for message in plain.messages if message.log_time >= since]
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 0
    assert report.before == 150
    assert report.states.same == 1300 - 600
    assert '150 states are not checked: they are before the first start' in report.lines()


def test_two_twins_in_a_bag_are_both_checked(tmp_path) -> None:
    first, second = Twin(node='/left/twin'), Twin(node='/right/twin', layer__thickness=0.01)
    first.go(1500)
    second.go(2500)
    messages = sorted(first.messages + second.messages, key=lambda message: message.log_time)
    with BagReader(write(tmp_path / 'bag', messages)) as reader:
        reports = BagCheck(reader).run()
    assert [(report.twin, report.states.same, report.exit_code) for report in reports] == [
        ('/left/twin', 1500, 0),
        ('/right/twin', 2500, 0),
    ]


def test_another_journal_in_a_bag_is_told_and_does_not_keep_the_twin_from_being_checked(
    plain, tmp_path
) -> None:
    arm = Twin(node='/arm')
    arm.go(1)
    moved = [
        message._replace(data=text('moved'))
        if message.channel is arm.channels['journal']
        else message
        for message in arm.messages
    ]
    messages = plain.messages + moved
    with BagReader(write(tmp_path / 'bag', messages)) as reader:
        reports = {report.twin: report for report in BagCheck(reader).run()}
    assert reports['/twin'].exit_code == 0
    assert reports['/twin'].states.same == 1300
    assert reports['/arm'].exit_code == 2
    assert 'journal: there is no start of a throw' in reports['/arm'].lines()


def test_bag_in_several_files_is_checked_like_one(plain, tmp_path) -> None:
    path = write(tmp_path / 'bag', plain.messages, max_duration=0.3)
    assert len(list(path.glob('*.mcap'))) > 3
    assert check(path).states.same == 1300


# something different


def damaged(twin: Twin, message: Message, change: Callable[[bytearray], None]) -> list[Message]:
    """Return the messages of a twin, one of them changed."""
    data = bytearray(message.data)
    change(data)
    return [
        other._replace(data=bytes(data)) if other is message else other for other in twin.messages
    ]


def flip(at: int, bit: int) -> Callable[[bytearray], None]:
    def change(data: bytearray) -> None:
        data[at + bit // 8] ^= 1 << bit % 8

    return change


def doubles(data: bytes) -> list[int]:
    """Find where the doubles of a state, or of a field, are."""
    if len(data) != len(STATE):
        count = struct.unpack_from('<I', FIELD, FIELD.index(struct.pack('<d', 1.0)) - 8)[0]
        assert count == 64
        return list(range(len(data) - 8 * count, len(data), 8))
    return [STATE.index(struct.pack('<d', value)) for value in range(1, 7)]


STATE = JointStateEncoder('rig', ('plate', 'projectile')).encode(0, State(*range(1, 7)))
FIELD = ArrayEncoder({'y': 64}).encode(np.ones(64))


@pytest.mark.parametrize('bit', [0, 30, 63])
@pytest.mark.parametrize('index', range(6))
def test_one_bit_in_one_double_is_found_and_named(plain, tmp_path, index, bit) -> None:
    message = states_of(plain)[610]
    messages = damaged(plain, message, flip(doubles(message.data)[index], bit))
    (changed,) = [new for new, old in zip(messages, plain.messages, strict=True) if new != old]
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 1
    assert (report.states.same, report.states.different) == (1299, 1)
    values = [
        np.hstack([read.position, read.velocity, read.effort])[0][index].item()
        for read in (decode_joint_states([data]) for data in (changed.data, message.data))
    ]
    joint, quantity = ('plate', 'projectile')[index % 2], ('position', 'velocity', 'effort')
    assert report.differences == [
        'joint_states: throw 2, step 610, due at 1700000000.733456789 s: '
        f'{quantity[index // 2]} of {joint} is {values[0]!r} in the bag, '
        f'and {values[1]!r} when repeated'
    ]


def test_first_of_several_differences_is_named_and_all_are_counted(plain, tmp_path) -> None:
    states = states_of(plain)
    changed = {id(states[index]) for index in (500, 400, 1100)}
    messages = [
        message._replace(data=message.data[:-1] + bytes([message.data[-1] ^ 1]))
        if id(message) in changed
        else message
        for message in plain.messages
    ]
    report = check(write(tmp_path / 'bag', messages))
    assert report.states.different == 3
    assert 'throw 1, step 400' in report.differences[0]


@pytest.mark.parametrize('name', ['layer/strain', 'layer/velocity', 'throw_field'])
@pytest.mark.parametrize('index', [2, -1])
def test_one_bit_in_a_field_is_found(plain, tmp_path, name, index) -> None:
    message = [message for message in plain.messages if is_of(message, name)][index]
    value = struct.unpack_from('<d', message.data, len(message.data) - 80)[0]
    messages = damaged(plain, message, flip(len(message.data) - 80, 3))
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 1
    assert report.states.different == 0
    assert report.sides[name].different == 1
    assert report.differences[0].startswith(f'{name}: ')
    assert repr(value) in report.differences[0]


def test_phase_that_does_not_come_then_is_found(plain, tmp_path) -> None:
    message = [message for message in plain.messages if is_of(message, 'phase')][11]
    messages = damaged(plain, message, lambda data: data.__setitem__(8, ord('X')))
    report = check(write(tmp_path / 'bag', messages))
    assert report.sides['phase'].different == 1
    assert 'phase: a message after step' in report.differences[0]


def test_field_of_another_time_is_found(tmp_path) -> None:
    twin = Twin()
    twin.go(2200)
    fields = [message for message in twin.messages if is_of(message, 'layer/strain')]
    early, late = fields[55], fields[58]  # within one throw
    messages = damaged(twin, early, lambda data: data.__setitem__(slice(None), late.data))
    assert check(write(tmp_path / 'bag', messages)).sides['layer/strain'].different > 0


@pytest.mark.parametrize(
    ('index', 'bit'),
    # seconds later is no wrong stamp for the last one: others may have been lost
    [(index, bit) for index in (1, 700) for bit in (0, 25, 32, 36, 42, 61)]
    + [(1299, bit) for bit in (0, 25, 61)],
)
def test_wrong_stamp_is_one_difference_and_no_endless_search(plain, tmp_path, index, bit) -> None:
    message = states_of(plain)[index]
    messages = damaged(plain, message, flip(4 if bit >= 32 else 8, bit % 32))
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 1
    assert (report.states.same, report.states.different, report.lost) == (1299, 1, index < 1299)
    assert 'is due at' in report.differences[0]


def test_message_that_comes_twice_is_different(plain, tmp_path) -> None:
    state = states_of(plain)[900]
    report = check(write(tmp_path / 'bag', [*plain.messages, state]))
    assert (report.states.same, report.states.different) == (1300, 1)
    assert report.differences == [
        'joint_states: no step after step 900 is due at 1700000001.023456789 s'
    ]


@pytest.mark.parametrize('change', [lambda data: data.clear(), flip(0, 0), flip(28, 0)])
def test_state_that_cannot_be_read_is_different(plain, tmp_path, change) -> None:
    messages = damaged(plain, states_of(plain)[10], change)
    report = check(write(tmp_path / 'bag', messages))
    assert (report.states.same, report.states.different) == (1299, 1)
    assert 'not read as states of plate and projectile' in report.differences[0]


# lines of the journal that are missing


def without(twin: Twin, is_missing: Callable[[Message], bool]) -> list[Message]:
    return [message for message in twin.messages if not is_missing(message)]


def throws(twin: Twin) -> dict[int, int]:
    """Return the steps at which throws start, by their numbers."""
    entries = [step_entry(message) for message in twin.messages if is_of(message, 'journal')]
    return {entry['throw']: entry['step'] for entry in entries if entry['kind'] == 'throw'}


@pytest.mark.parametrize(
    ('missing', 'words', 'gap'),
    [
        ([2], 'throw 2 is missing', (1, 3)),
        ([2, 3], 'throw 3 is missing, and 1 before', (1, 4)),
    ],
)
def test_missing_throws_are_told_and_the_next_one_is_checked(
    plain, tmp_path, missing, words, gap
) -> None:
    lost = [throws(plain)[throw] for throw in missing]
    messages = without(
        plain, lambda message: is_of(message, 'journal') and step_entry(message)['step'] in lost
    )
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 0
    assert report.gaps == [words]
    unchecked = throws(plain)[gap[1]] - throws(plain)[gap[0]]
    assert (report.states.same, report.states.unchecked) == (1300 - unchecked, unchecked)
    assert f'{unchecked} states are not checked: lines of the journal are missing' in [
        *report.lines()
    ]
    assert f'journal: {words}' in report.lines()


@pytest.mark.parametrize(
    ('kind', 'words'),
    [
        ('parameters', 'a change of layer.thickness is missing before throw 2'),
        ('pace', 'a line about the pace is missing before throw 2'),
        ('repeated pace', 'a line about the pace is missing before throw 2'),
        ('unreadable', 'a line after throw 1 cannot be read'),
        ('step', 'step 1500 is before step 1400'),
    ],
)
def test_missing_line_is_noticed(tmp_path, kind, words) -> None:
    twin = Twin(throw__max_events=1)
    twin.go(1400)
    twin.change(layer__thickness=0.01)
    twin.go(100)
    twin.stall(5)
    twin.go(1700)
    (changed,) = [message for message in twin.messages if is_entry(message, kind='input')]
    (stalled,) = [m for m in twin.messages if is_entry(m, kind='pace', step=1500)]
    begins = throws(twin)
    (before,) = [m for m in twin.messages if is_entry(m, kind='pace', step=begins[2])]
    messages = {
        'parameters': lambda: without(twin, lambda message: message is changed),
        'pace': lambda: without(twin, lambda message: message is stalled),
        'repeated pace': lambda: without(twin, lambda message: message is before),
        'unreadable': lambda: damaged(twin, changed, lambda data: data.__setitem__(8, 0)),
        'step': lambda: [
            message if message is not changed else message._replace(log_time=stalled.log_time + 1)
            for message in twin.messages
        ],
    }[kind]()
    messages.sort(key=lambda message: message.log_time)
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 0
    assert report.gaps[0].startswith(words)
    unchecked = begins[3] - begins[1] if kind == 'repeated pace' else begins[2] - begins[1]
    assert (report.states.same, report.states.unchecked) == (3200 - unchecked, unchecked)
    assert report.states.different == 0


def test_gap_at_which_the_clock_was_set_back_ends(tmp_path) -> None:
    twin = Twin(throw__period=0.3)
    twin.go(500)
    twin.set_clock(twin.now - SECOND + 137)
    twin.go(1000)
    paces = [message for message in twin.messages if is_entry(message, kind='pace', step=500)]
    report = check(write(tmp_path / 'bag', without(twin, lambda message: message in paces)))
    assert report.gaps == ['a line about the pace is missing before throw 2']
    assert (report.states.unchecked, report.states.same) == (300, 1200)
    assert report.exit_code == 0


def test_missing_reset_makes_a_journal_that_does_not_fit(tmp_path) -> None:
    twin = Twin()
    twin.go(1300)
    twin.session.reset()
    twin.go(3000)
    messages = without(twin, lambda message: is_entry(message, input='reset'))
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 1
    assert 'throw 2 starts with step 2300 in the journal' in report.misfits[0]
    assert f'journal: {report.misfits[0]}' in report.lines()
    assert 'throw 1, step 1300' in report.differences[0]
    assert report.states.same >= 2000  # what follows throw 2 among them


def test_input_that_is_refused_when_repeated_is_told(tmp_path) -> None:
    twin = Twin(throw__period=0)
    twin.go(10)
    twin.session.ask_throw()
    twin.go(50)
    twin._on_entry(journal.encode(journal.input_entry(60, 'throw')))  # never taken, in flight
    twin.go(400)
    report = check(write(tmp_path / 'bag', twin.messages))
    assert report.exit_code == 1
    assert 'what follows throw 1 cannot be repeated: throw 1 is under way' in report.misfits[0]
    assert report.states.unchecked == 400


def test_missing_start_of_a_session_is_told(tmp_path) -> None:
    twin = Twin()
    twin.go(2500)
    twin.now += SECOND
    twin.restart()
    twin.go(3500)
    begin = [message for message in twin.messages if is_entry(message, kind='start')][1]
    messages = without(
        twin,
        lambda message: is_of(message, 'journal') and message.log_time == begin.log_time,
    )
    report = check(write(tmp_path / 'bag', messages))
    assert report.gaps == ['the start of a session is missing after throw 2']
    assert report.exit_code == 0
    assert report.states.same == 2000 + 2500


def test_rest_that_is_too_long_is_not_repeated(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr('soft_throw_ros.recording.resimulation.LONGEST', 1500)
    twin = Twin(throw__period=0)
    twin.go(4000)
    twin.session.ask_throw()
    twin.go(1000)
    since = BEGIN + 2 * SECOND
    messages = [
        message
        for message in twin.messages
        if message.log_time >= since or is_of(message, 'journal')
    ]
    report = check(write(tmp_path / 'bag', messages))
    assert (report.before, report.states.same, report.exit_code) == (2000, 1000, 0)


# other versions


def elsewhere(twin: Twin, **versions: str) -> list[Message]:
    """Return the messages of a twin, as if computed with other versions."""

    def rewritten(message: Message) -> Message:
        if not is_of(message, 'journal') or 'versions' not in step_entry(message):
            return message
        entry = step_entry(message)
        entry['versions'].update(versions)
        return message._replace(data=text(journal.encode(entry)))

    return [rewritten(message) for message in twin.messages]


def nudged(messages: list[Message], names: Iterable[str], relative: float) -> list[Message]:
    """Change numbers, all of a message together, by a relative amount."""

    def change(message: Message) -> Message:
        if not any(is_of(message, name) for name in names):
            return message
        data = bytearray(message.data)
        for at in doubles(message.data):
            (value,) = struct.unpack_from('<d', data, at)
            struct.pack_into('<d', data, at, value * (1.0 + relative))
        return message._replace(data=bytes(data))

    return [change(message) for message in messages]


FIELDS = ('layer/strain', 'layer/velocity')


@pytest.mark.parametrize('names', [['joint_states'], FIELDS])
@pytest.mark.parametrize(('relative', 'code'), [(4e-16, 0), (1e-13, 0), (1e-11, 1)])
def test_what_another_version_computed_may_differ_a_little(
    plain, tmp_path, names, relative, code
) -> None:
    messages = nudged(elsewhere(plain, numpy='1.0', machine='z80'), names, relative)
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == code
    here = journal.VERSIONS
    assert report.versions == {
        'numpy': ('1.0', here['numpy']),
        'machine': ('z80', here['machine']),
    }
    lines = list(report.lines())
    assert f'recorded with numpy 1.0, repeated with {here["numpy"]}' in lines
    assert any('to 1e-12 of their scale' in line for line in lines)
    assert check(write(tmp_path / 'same', elsewhere(plain))).versions == {}


@pytest.mark.parametrize('names', [['joint_states'], FIELDS])
def test_same_version_may_not_differ_at_all(plain, tmp_path, names) -> None:
    report = check(write(tmp_path / 'bag', nudged(plain.messages, names, 4e-16)))
    assert report.exit_code == 1


def test_another_version_is_followed_until_the_projectile_lands(tmp_path) -> None:
    frequency = math.nextafter(63.2, 100.0)  # which makes the last bits other ones
    twin = Twin(engine__frequency=frequency)
    twin.go(3000)
    messages = [
        message._replace(data=message.data.replace(repr(frequency).encode(), b'63.2'.ljust(17)))
        for message in elsewhere(twin, machine='z80')
    ]
    report = check(write(tmp_path / 'bag', messages))
    assert report.exit_code == 0
    assert report.states.same + report.bouncing == 3000
    assert 0.5 * report.bouncing < report.states.same < 3.0 * report.bouncing
    assert f'{report.bouncing} states are not checked: they follow a landing' in report.lines()
    again = elsewhere(twin, machine=journal.VERSIONS['machine'])
    assert check(write(tmp_path / 'again', again)).bouncing == 0


def test_repetition_is_of_the_present_version(plain, tmp_path) -> None:
    report = repeat(write(tmp_path / 'bag', elsewhere(plain, numba='0.1')), tmp_path / 'other')
    assert set(report.versions) == {'numba'}
    assert check(tmp_path / 'other').versions == {}


# what is written


def read(path: Path) -> list[Message]:
    with BagReader(path) as reader:
        return list(reader.messages())


def test_repetition_is_what_the_twin_has_published(eventful, tmp_path) -> None:
    report = repeat(write(tmp_path / 'bag', eventful.messages), tmp_path / 'other')
    assert report.exit_code == 0
    with BagReader(tmp_path / 'bag') as bag, BagReader(tmp_path / 'other') as other:
        assert [vars(channel) for channel in sorted(other.channels, key=by_name)] == [
            vars(channel) for channel in sorted(bag.channels, key=by_name)
        ]
    # the clock was set back, so that messages are not in the order in which they were written
    ours = by_topic(sorted(read(tmp_path / 'other'), key=lambda message: message.data))
    theirs = by_topic(sorted(eventful.messages, key=lambda message: message.data))
    assert ours == theirs


def by_name(channel: Channel) -> str:
    return channel.topic


def test_repetition_can_be_checked_and_has_no_losses(eventful, tmp_path) -> None:
    states = states_of(eventful)
    lost = set(map(id, states[100:200] + states[4000:4777]))
    messages = without(eventful, lambda message: id(message) in lost)
    assert repeat(write(tmp_path / 'bag', messages), tmp_path / 'other').lost == len(lost)
    report = check(tmp_path / 'other')
    assert (report.exit_code, report.lost, report.states.same) == (0, 0, len(states))
    repeat(tmp_path / 'other', tmp_path / 'again')
    assert read_plainly(tmp_path / 'again') == read_plainly(tmp_path / 'other')


def read_plainly(path: Path) -> list[tuple[Any, ...]]:
    return [(message.channel.topic, *message[1:]) for message in read(path)]


def test_two_recordings_of_a_run_are_repeated_to_the_same_messages(plain, tmp_path) -> None:
    random = np.random.default_rng(8)
    begun = [BEGIN + 350_000_000, BEGIN + 500_000_000]  # in the same throw
    last = states_of(plain)[-1]
    for name, since in zip(('a', 'bc'), begun, strict=True):
        messages = [
            message._replace(log_time=max(since, message.log_time) + len(name))
            for message in plain.messages
            if is_of(message, 'journal')
            or (message.log_time >= since and random.random() < 0.8)
            or message is last
        ]
        messages.sort(key=lambda message: message.log_time)
        assert repeat(write(tmp_path / name, messages), tmp_path / f'{name}_again').lost > 100
    assert read_plainly(tmp_path / 'a_again') == read_plainly(tmp_path / 'bc_again')
    assert by_topic(read(tmp_path / 'a_again'))['/twin/joint_states'] == [
        message.data for message in states_of(plain)[300:]
    ]


def test_repetition_has_times_at_which_steps_are_due(plain, tmp_path) -> None:
    repeat(write(tmp_path / 'bag', plain.messages), tmp_path / 'other')
    states = [message for message in read(tmp_path / 'other') if is_of(message, 'joint_states')]
    due = [BEGIN + step * SECOND // 1000 for step in range(1300)]
    assert [message.log_time for message in states] == due
    assert [message.publish_time for message in states] == due
    assert [message.sequence for message in states] == list(range(1, 1301))


# what cannot be checked


def test_bag_without_a_twin_is_refused(plain, tmp_path) -> None:
    messages = without(plain, lambda message: is_of(message, 'journal'))
    words = 'journal and joint_states of a twin, and has /twin/'
    with (
        BagReader(write(tmp_path / 'bag', messages)) as reader,
        pytest.raises(CheckError, match=words),
    ):
        BagCheck(reader)


def test_journal_without_a_start_is_refused(plain, tmp_path) -> None:
    messages = without(
        plain,
        lambda message: is_entry(message, kind='start') or is_entry(message, kind='throw'),
    )
    words = '/twin/journal has no start of a throw'
    with (
        BagReader(write(tmp_path / 'bag', messages)) as reader,
        pytest.raises(CheckError, match=words),
    ):
        BagCheck(reader)


def test_bag_in_which_nothing_can_be_checked_is_not_good(plain, tmp_path) -> None:
    messages = [message for message in plain.messages if message.log_time < BEGIN + SECOND // 2]
    messages = [message for message in messages if not is_of(message, 'journal')]
    messages += [message for message in plain.messages if is_entry(message, step=600)]
    report = check(write(tmp_path / 'bag', messages))
    assert (report.before, report.exit_code) == (500, 2)


# any run


ACTIONS = st.one_of(
    st.tuples(st.just('go'), st.integers(1, 400)),
    st.tuples(st.just('stall'), st.integers(1, 300)),
    st.tuples(st.just('restart'), st.just(0)),
    st.tuples(st.just('reset'), st.just(0)),
    st.tuples(st.just('throw'), st.just(0)),
    st.tuples(
        st.just('change'),
        st.sampled_from(
            [
                {'layer__thickness': 0.01},
                {'rate__state': 500.0},
                {'time_scale': 0.3},
                {'gravity': 1.6},
                {'throw__period': 0.1},
                {'throw__period': 0.0},
                {'rate__field': 200.0},
            ]
        ),
    ),
)


@given(actions=st.lists(ACTIONS, min_size=1, max_size=10), data=st.data())
@hypothesis.settings(max_examples=25)
def test_any_run_with_any_losses_is_what_its_journal_gives(
    tmp_path_factory, actions, data
) -> None:
    twin = Twin(throw__period=0.15)
    twin.go(20)
    for name, value in actions:
        if name == 'change':
            twin.change(**value)
        elif name == 'reset':
            twin.session.reset()
        elif name == 'throw':
            with contextlib.suppress(Refused):
                twin.session.ask_throw()
        elif name == 'restart':
            twin.now += SECOND
            twin.restart(throw__period=0.15)
        else:
            getattr(twin, name)(value)
    twin.go(200)
    part = data.draw(st.sampled_from([0.0, 0.1, 0.9]))
    random = np.random.default_rng(data.draw(st.integers(0, 1000)))
    last = states_of(twin)[-1]
    messages = [
        message
        for message in twin.messages
        if is_of(message, 'journal') or random.random() >= part or message is last
    ]
    folder = tmp_path_factory.mktemp('run')
    report = repeat(write(folder / 'bag', messages), folder / 'other')
    assert report.exit_code == 0, list(report.lines())
    assert (report.before, report.states.unchecked) == (0, 0)
    count = sum(is_of(message, 'joint_states') for message in messages)
    assert report.states.same == count
    published = by_topic(twin.messages)['/twin/joint_states']
    repeated = by_topic(read(folder / 'other'))['/twin/joint_states']
    if 'restart' in dict(actions):  # the end of a session may be lost, and not be told
        assert set(repeated) <= set(published)
    else:
        assert repeated == published[published.index(repeated[0]) :]
