# SPDX-License-Identifier: Apache-2.0
"""
Whether a bag is what its own journal gives when it is repeated.

States have a stamp, and the journal has the pace, so that each is compared with its own step,
whatever else was lost. Fields and phases have none: they are matched in their order with what
comes at that time, so that one which matches nothing is different, and one that is missing is
not noticed. What came so early that it may be older than what is repeated is not checked.

Other versions compute other last bits, which is allowed for until the projectile lands: from
bounce to bounce a difference grows, often tenfold, so that what comes later says nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice, pairwise
import math
import struct
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import rig_of
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.recording.bag_reader import BagReader
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.cdr import (
    ArrayEncoder,
    decode,
    decode_array,
    decode_joint_states,
    JointStateEncoder,
    MessageError,
)
from soft_throw_ros.recording.message import Channel, Message
from soft_throw_ros.recording.resimulation import (
    LONGEST,
    Place,
    read_stretches,
    Resimulation,
    Step,
    Stretch,
    Timeline,
)
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.plan import FIELD_POINTS, THROW_FIELD_ROWS
from soft_throw_ros.twin.results import Floats, Outputs, Phase, Prediction, Residual, State

TOLERANCE = 1e-12
"""Relative to the scale of a quantity: what another machine may have otherwise. [-]"""

JOINTS = ('plate', 'projectile')

_JOURNAL, _STATES = 'journal', 'joint_states'
_TEXT, _JOINT_STATE, _ARRAY = (
    'std_msgs/msg/String',
    'sensor_msgs/msg/JointState',
    'std_msgs/msg/Float64MultiArray',
)
_BATCH = 1000  # messages that are decoded at once
_SHOWN = 5  # of what may be many
_SECOND = 1_000_000_000
_STATE = struct.Struct('<6d')

_AROUND = 0.5  # how far messages without a stamp may be from the states they come with [s]

Payload = str | Floats
Item = TypeVar('Item')


class CheckError(ValueError):
    """There is nothing in a bag that could be checked."""


class _Side(NamedTuple):
    """
    A topic beside the states, without stamps.

    Parameters
    ----------
    name : str
        Below that of the node.
    type : str
        Of its messages.
    dimensions : dict of str to int
        Of arrays; empty for others.
    history : int
        How many messages a late subscriber gets.
    of : callable
        Returns what a step gives for it; of states seconds and nanoseconds of the stamp, and then
        the values, one series after another.
    joints : tuple of str
        Of states; empty for others.
    series : int
        How many of position, velocity and effort they have.

    """

    name: str
    type: str
    dimensions: dict[str, int]
    history: int
    of: Callable[[Outputs], Sequence[Payload]]
    joints: tuple[str, ...] = ()
    series: int = 0

    def read(self, message: Message) -> Payload | None:
        """Read a message, None if it is none of this topic."""
        if self.type == _TEXT:
            return _text(message)
        try:
            if self.joints:
                return self._read_joints(message.data)
            labels, values = decode_array(message.data)
        except MessageError:
            return None
        shape = dict(zip(labels, values.shape, strict=True))
        return values if shape == self.dimensions else None

    def _read_joints(self, data: bytes) -> Payload | None:
        states = decode_joint_states([data])
        series = (states.position, states.velocity, states.effort)
        count = len(self.joints)
        sizes = [count] * self.series + [0] * (len(series) - self.series)
        if states.names != self.joints or [values.shape[1] for values in series] != sizes:
            return None
        return np.concatenate(
            [divmod(int(states.stamps[0]), _SECOND), *(row[0] for row in series)]
        )

    def encoder(self, frame: str) -> Callable[[Any], bytes]:
        """Make what writes its messages."""
        if self.type == _TEXT:
            return _encode_text
        if not self.joints:
            return ArrayEncoder(self.dimensions).encode
        encode = JointStateEncoder(frame, self.joints, series=self.series).encode

        def encode_joints(payload: Floats) -> bytes:
            seconds, nanoseconds, *values = payload.tolist()
            return encode(int(seconds) * _SECOND + int(nanoseconds), values)

        return encode_joints


_SIDES = (
    _Side(
        'layer/strain',
        _ARRAY,
        {'y': FIELD_POINTS},
        0,
        lambda outputs: () if outputs.field is None else (outputs.field.strain,),
    ),
    _Side(
        'layer/velocity',
        _ARRAY,
        {'y': FIELD_POINTS},
        0,
        lambda outputs: () if outputs.field is None else (outputs.field.velocity,),
    ),
    _Side(
        'throw_field',
        _ARRAY,
        {'t': THROW_FIELD_ROWS, 'y': FIELD_POINTS},
        1,
        lambda outputs: () if outputs.throw_field is None else (outputs.throw_field.strain,),
    ),
    _Side('phase', _TEXT, {}, 10, lambda outputs: [phase.value for phase in outputs.phases]),
    _Side(
        'predicted_joint_states',
        _JOINT_STATE,
        {},
        0,
        lambda outputs: [_stamped(outputs.prediction, 3)] if outputs.prediction else (),
        ('projectile',),
        3,
    ),
    _Side(
        'residual',
        _JOINT_STATE,
        {},
        0,
        lambda outputs: [_stamped(outputs.residual, 2)] if outputs.residual else (),
        JOINTS,
        1,
    ),
)


def _stamped(values: Prediction | Residual, count: int) -> Floats:
    """Return a stamp, split, and so many values after it."""
    return np.array([*divmod(values.stamp_ns, _SECOND), *values[1 : 1 + count]], np.float64)


@dataclass(kw_only=True)
class Tally:
    """How many messages of a topic were the same, different, and not checked."""

    same: int = 0
    different: int = 0
    unchecked: int = 0


@dataclass(kw_only=True)
class Report:
    """
    What was found out about a twin in a bag.

    Parameters
    ----------
    twin : str
        Name of the node.
    states : Tally
        Of the states.
    lost : int
        States that are missing between others.
    before : int
        States before the first start in the journal.
    bouncing : int
        States of other versions, after a landing.
    sides : dict of str to Tally
        Of the other topics.
    differences : list of str
        The first of each topic.
    misfits : list of str
        Where the journal does not fit what it gives.
    gaps : list of str
        What is missing in the journal.
    versions : dict of str to (str, str)
        What was another there, and here.

    """

    twin: str
    states: Tally = field(default_factory=Tally)
    lost: int = 0
    before: int = 0
    bouncing: int = 0
    sides: dict[str, Tally] = field(default_factory=dict)
    differences: list[str] = field(default_factory=list)
    misfits: list[str] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)
    versions: dict[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def exit_code(self) -> int:
        """0 if all is the same, 1 if something is not, 2 if nothing could be checked."""
        if self.differences or self.misfits:
            return 1
        return 0 if self.states.same else 2

    def lines(self) -> Iterator[str]:
        """Say it for people to read."""
        for name, (there, here) in self.versions.items():
            yield f'recorded with {name} {there}, repeated with {here}'
        measure = f'to {TOLERANCE:g} of their scale' if self.versions else 'to the last bit'
        states = self.states
        yield (
            f'{states.same} states are the same {measure}, {states.different} are different, '
            f'{self.lost} were lost by the recorder'
        )
        if self.before:
            yield f'{self.before} states are not checked: they are before the first start'
        if self.bouncing:
            yield f'{self.bouncing} states are not checked: they follow a landing'
        if states.unchecked:
            yield f'{states.unchecked} states are not checked: lines of the journal are missing'
        for name, tally in self.sides.items():
            yield (
                f'{name}: {tally.same} messages are the same, {tally.different} are different, '
                f'{tally.unchecked} are not checked'
            )
        for sentences in (self.gaps, self.misfits):
            yield from (f'{_JOURNAL}: {sentence}' for sentence in sentences[:_SHOWN])
            if len(sentences) > _SHOWN:
                yield f'{_JOURNAL}: and {len(sentences) - _SHOWN} more of this kind'
        yield from self.differences


class BagCheck:
    """
    Checks every twin in a bag, reading it once from beginning to end, and its journal twice.

    Parameters
    ----------
    reader : BagReader
        Of the bag.

    Raises
    ------
    CheckError
        If there is no twin in it, or no start of a throw in its journal.

    """

    def __init__(self, reader: BagReader) -> None:
        types = {channel.topic: channel.type for channel in reader.channels}
        nodes = [
            topic.removesuffix(f'/{_JOURNAL}')
            for topic, kind in types.items()
            if topic.endswith(f'/{_JOURNAL}') and kind == _TEXT
        ]
        nodes = [node for node in nodes if types.get(f'{node}/{_STATES}') == _JOINT_STATE]
        if not nodes:
            raise CheckError(
                f'{reader.path}: the bag needs the topics {_JOURNAL} and {_STATES} of a twin, '
                f'and has {", ".join(types) or "none"}'
            )
        self._twins = [_TwinCheck(reader, node) for node in nodes]
        if not any(twin.has_start for twin in self._twins):
            raise CheckError(f'{reader.path}: {nodes[0]}/{_JOURNAL} has no start of a throw')

    def run(self, writer: BagWriter | None = None) -> list[Report]:
        """
        Check, and write what comes when it is repeated.

        Raises
        ------
        BagError
            If the bag cannot be read or written.

        """
        return [twin.run(writer) for twin in self._twins]


class _TwinCheck:
    """Checks one twin."""

    def __init__(self, reader: BagReader, node: str) -> None:
        self._reader = reader
        self._node = node
        self._timeline = Timeline(read_stretches(self._lines()))
        self.has_start = bool(self._timeline.pieces)
        topics = {channel.topic for channel in reader.channels}
        self._followers = {
            f'{node}/{side.name}': _Follower(side)
            for side in _SIDES
            if f'{node}/{side.name}' in topics
        }
        self._report = Report(
            twin=node,
            gaps=self._timeline.gaps if self.has_start else ['there is no start of a throw'],
            sides={follower.side.name: follower.tally for follower in self._followers.values()},
        )
        self._resimulation = Resimulation(
            read_stretches(self._lines()), self._report.misfits.append
        )
        self._copy: _Copy | None = None
        self._place: Place | None = None  # of the last state
        self._last: Step | None = None  # that was repeated
        self._now: Step | None = None  # the step of the last state, if it could be repeated
        self._seen: Step | None = None  # the last one that could
        self._run = -1  # in which that was
        self._has_heard = False  # something else since the last state
        self._is_bouncing = False
        self._measure = _Measure()

    def run(self, writer: BagWriter | None) -> Report:
        """Check, and write what comes when it is repeated."""
        if writer is not None:
            self._copy = _Copy(self._reader, self._node, writer)
        for item, next_stamp in self._recorded():
            if isinstance(item, Message):
                self._followers[item.channel.topic].hear(item, self._now)
                self._has_heard = True
            else:
                self._take(item, next_stamp)
        self._run_out()
        for follower in self._followers.values():
            follower.settle(self._last)
            if follower.difference:
                self._report.differences.append(f'{follower.side.name}: {follower.difference}')
        return self._report

    def _lines(self) -> Iterator[str]:
        for message in _as_written(self._reader, {f'{self._node}/{_JOURNAL}'}):
            yield _text(message) or ''

    def _recorded(self) -> Iterator[tuple[_State | Message, int | None]]:
        """Yield states decoded, with the stamp of the one that follows, and all else."""
        states = f'{self._node}/{_STATES}'
        topics = {states, *self._followers}
        if self._timeline.is_set_back:  # and so may be the clock of the recorder
            messages = _as_written(self._reader, topics)
        else:
            messages = self._reader.messages(topics)
        batches = (_decoded(batch, states) for batch in _batches(messages, _BATCH))
        for batch, following in pairwise(chain(batches, [[]])):
            stamp = _first_stamp(following)
            stamps: list[int | None] = []
            for item in reversed(batch):
                stamps.append(stamp)
                if isinstance(item, _State):
                    stamp = item.stamp
            yield from zip(batch, reversed(stamps), strict=True)

    def _take(self, state: _State, next_stamp: int | None) -> None:
        """Compare a state with the step that its stamp tells."""
        report = self._report
        if state.stamp is None:
            self._differ(f'a message is not read as states of {" and ".join(JOINTS)}')
            return
        place = self._find(state.stamp, next_stamp)
        if place is None:
            self._take_without_place(state.stamp)
            return
        self._place, self._now = place, None
        piece = self._timeline.pieces[place.piece]
        is_first = piece.run != self._run
        if piece.pace is None:
            report.states.unchecked += 1
        elif self._repeat(piece.run, place.step, is_first=is_first):
            self._seen = self._last
            if self._measure.versions and self._is_bouncing:
                report.bouncing += 1
            else:
                self._now = self._last
                self._compare(state)
        elif is_first:
            report.before += 1
        else:
            report.states.unchecked += 1

    def _take_without_place(self, stamp: int) -> None:
        """Account for a state whose stamp tells no step."""
        if self._place is None and stamp < self._timeline.begin_ns:
            self._report.before += 1
        elif self._place is not None and self._place.step < 0:
            self._report.states.unchecked += 1  # in a gap, of which the pace is not known
        else:
            after = f' after step {self._last.number}' if self._last is not None else ''
            self._differ(f'no step{after} is due at {_seconds(stamp)}')

    def _find(self, stamp: int, next_stamp: int | None) -> Place | None:
        """Find the step of a stamp, unless the next stamp, or the distance, shows it is wrong."""
        timeline, before = self._timeline, self._place
        place = timeline.find(stamp, before)
        if place is None:
            return None
        if next_stamp is not None and next_stamp < stamp:
            fits_after = timeline.find(next_stamp, place) is not None
            if not fits_after and timeline.find(next_stamp, before) is not None:
                return None
        piece, last = timeline.pieces[place.piece], self._last
        is_far = (
            piece.run == self._run
            and last is not None
            and place.step - max(last.number, piece.begin) > LONGEST
        )
        return None if is_far else place

    def _repeat(self, run: int, number: int, *, is_first: bool) -> bool:
        """Repeat the steps up to one, and tell whether it could be."""
        if is_first:
            self._run_out()
        if self._has_heard:
            self._has_heard = False
            for follower in self._followers.values():
                follower.limit(number)
        count = 0
        for step in self._resimulation.until(run, number):
            count += 1
            self._pass(step, number)
            if self._copy is not None:
                self._copy.write(step)
        if not count or self._last is None or self._last.at != (run, number):
            return False
        self._run = run
        self._report.lost += 0 if is_first else count - 1
        return True

    def _run_out(self) -> None:
        """Repeat a little more of a session, since a message may come before its state."""
        if self._last is not None:
            run, number = self._last.at
            for step in self._resimulation.until(run, number + _around(self._last)):
                self._pass(step, number)

    def _pass(self, step: Step, goal: int) -> None:
        """Hand a step on to whom it may concern."""
        last = self._last
        if last is None or step.at != (last.run, last.number + 1):
            is_whole = not step.stretch.throw and goal - step.number <= _around(step)
            for follower in self._followers.values():
                follower.settle(last, until=self._seen)
                follower.begin(step, is_whole=is_whole)
        if last is None or step.stretch is not last.stretch:
            self._measure = _Measure.of(step.stretch)
            self._report.versions.update(self._measure.versions)
        self._last = step
        outputs = step.outputs
        self._is_bouncing = (
            self._is_bouncing or any(event.kind == 'landing' for event in outputs.events)
        ) and not {Phase.REST, Phase.CONTACT}.intersection(outputs.phases)
        others = (outputs.field, outputs.throw_field, outputs.prediction, outputs.residual)
        if outputs.phases or any(other is not None for other in others):
            for follower in self._followers.values():
                follower.expect(step, self._measure)

    def _compare(self, state: _State) -> None:
        assert self._last is not None
        step, repeated = self._last, self._last.outputs.state
        wrong = self._measure.first_wrong(state.values, repeated)
        if wrong is None:
            self._report.states.same += 1
            return
        quantity = ('position', 'velocity', 'effort')[wrong // 2]
        self._differ(
            f'throw {step.outputs.throw}, step {step.number}, due at {_seconds(step.due_ns)}: '
            f'{quantity} of {JOINTS[wrong % 2]} is {_STATE.unpack(state.values)[wrong]!r} '
            f'in the bag, and {repeated[wrong]!r} when repeated'
        )

    def _differ(self, sentence: str) -> None:
        if not self._report.states.different:
            self._report.differences.append(f'{_STATES}: {sentence}')
        self._report.states.different += 1


class _State(NamedTuple):
    """A state as it is in the bag; without a stamp if it cannot be read."""

    stamp: int | None
    values: bytes = b''


@dataclass(frozen=True, kw_only=True)
class _Measure:
    """What is taken for the same: by default, all bits."""

    versions: dict[str, tuple[str, str]] = field(default_factory=dict)
    state: tuple[float, ...] = (0.0,) * len(State._fields)
    sides: dict[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, stretch: Stretch) -> _Measure:
        """Find out whether a stretch was computed by the same programs, and how large it is."""
        there = stretch.first['versions']
        versions = {
            name: (str(there.get(name)), str(journal.VERSIONS.get(name)))
            for name in {**journal.VERSIONS, **there}
            if there.get(name) != journal.VERSIONS.get(name)
        }
        rig = rig_of(stretch.first['settings'])
        speed = Underdamped.of(rig.engine).peak_velocity
        force = rig.layer.impedance * speed
        return cls(
            versions=versions,
            state=(*[rig.layer.thickness] * 2, *[speed] * 2, *[force] * 2),
            sides={'layer/velocity': speed},
        )

    def first_wrong(self, values: bytes, repeated: State) -> int | None:
        """Return the index of the first number of a state that is not the same, if any."""
        if values == _STATE.pack(*repeated):
            return None
        recorded = np.frombuffer(values, '<f8')
        wrong = ~self._are_alike(recorded, np.array(repeated), np.array(self.state))
        return int(wrong.argmax()) if wrong.any() else None

    def is_same(self, side: _Side, recorded: Payload, repeated: Payload) -> bool:
        """Compare messages of a topic without stamps."""
        if isinstance(recorded, str) or isinstance(repeated, str):
            return recorded is repeated or recorded == repeated
        if recorded.tobytes() == repeated.tobytes():
            return True
        scale = np.float64(self.sides.get(side.name, 1.0))
        return bool(self._are_alike(recorded, repeated, scale).all())

    def _are_alike(self, recorded: Floats, repeated: Floats, scale: Floats) -> NDArray[np.bool_]:
        alike: NDArray[np.bool_]
        if not self.versions:
            alike = recorded.view(np.int64) == repeated.view(np.int64)
        else:
            limit = TOLERANCE * np.maximum(np.abs(repeated), scale)
            with np.errstate(invalid='ignore', over='ignore'):  # the bag may have any number
                alike = np.abs(recorded - repeated) <= limit
        return alike


@dataclass
class _Waiting:
    """A message that is in the bag after the state of a step, and before that of another."""

    now: Step
    payload: Payload
    until: float = math.inf

    @property
    def since(self) -> int:
        """How early the step that it belongs to may be."""
        return self.now.number - _around(self.now)


class _Follower:
    """
    Matches the messages of a topic without stamps, in their order, with what is repeated.

    Parameters
    ----------
    side : _Side
        The topic.

    Attributes
    ----------
    tally : Tally
        How that went.
    difference : str
        What was different first.

    """

    def __init__(self, side: _Side) -> None:
        self.side = side
        self.tally = Tally()
        self.difference = ''
        self._measure = _Measure()
        self._begin = 0.0
        self._skipped = side.history
        self._repeated: deque[tuple[int, Payload]] = deque()  # with the step of each
        self._waiting: deque[_Waiting] = deque()
        self._tried = 0  # so many of what is repeated are not the first of what waits

    def begin(self, step: Step, *, is_whole: bool) -> None:
        """Begin anew with a step; nothing is older than it if that `is_whole`."""
        self._repeated.clear()
        self._tried = 0
        self._begin = -math.inf
        if is_whole:
            self._skipped = 0
        else:
            self._begin = step.number + _around(step)

    def hear(self, message: Message, now: Step | None) -> None:
        """Take a message that is in the bag after the state of a step."""
        if self._skipped or now is None or now.number < self._begin:
            self._skipped = max(self._skipped - 1, 0)
            self.tally.unchecked += 1
            return
        recorded = self.side.read(message)
        if recorded is None:
            self._differ(f'a message after step {now.number} is not read as {self.side.type}')
            return
        self._waiting.append(_Waiting(now, recorded))
        self._match()

    def limit(self, number: int) -> None:
        """Take note that what waits is in the bag before the state of a step."""
        for item in reversed(self._waiting):
            if item.until < math.inf:
                break
            item.until = number + _around(item.now)

    def expect(self, step: Step, measure: _Measure) -> None:
        """Take note of what a step gives."""
        self._measure = measure
        for payload in self.side.of(step.outputs):
            self._repeated.append((step.number, payload))
            self._match()
            while self._waiting and self._waiting[0].until < step.number:
                self._give_up()
            since = self._waiting[0].since if self._waiting else step.number - _around(step)
            while self._repeated and self._repeated[0][0] < since:
                self._repeated.popleft()
                self._tried = max(self._tried - 1, 0)

    def settle(self, last: Step | None, *, until: Step | None = None) -> None:
        """Judge what waits, after the last step; what is no older than `until` may belong on."""
        while self._waiting:
            now = self._waiting[0].now
            is_old = until is None or now.number < until.number
            if is_old and last is not None and now.number + _around(now) <= last.number:
                self._give_up()
            else:
                self._drop_first()
                self.tally.unchecked += 1

    def _match(self) -> None:
        """Have what waits go together with what is repeated, in the order of both."""
        while self._waiting:
            item = self._waiting[0]
            for number, repeated in islice(self._repeated, self._tried, None):
                is_near = item.since <= number <= item.until
                if is_near and self._measure.is_same(self.side, item.payload, repeated):
                    break
                self._tried += 1
            else:
                return
            self._waiting.popleft()
            for _ in range(self._tried + 1):
                self._repeated.popleft()
            self._tried = 0
            self.tally.same += 1

    def _give_up(self) -> None:
        """Call the message that has waited longest different."""
        item = self._waiting[0]
        sentence = f'a message after step {item.now.number} is nothing that comes then'
        if not self.difference and not isinstance(item.payload, str):
            sentence += self._nearest(item.payload)
        self._differ(sentence)
        self._drop_first()

    def _drop_first(self) -> None:
        self._waiting.popleft()
        self._tried = 0
        self._match()

    def _nearest(self, recorded: Floats) -> str:
        """Say what distinguishes an array from that which it has most in common with."""
        arrays = [payload for _, payload in self._repeated if isinstance(payload, np.ndarray)]
        if not arrays:
            return ''
        common = [np.count_nonzero(recorded == array) for array in arrays]
        nearest = arrays[int(np.argmax(common))].reshape(-1)
        index = int(np.argmax(recorded.reshape(-1) != nearest))
        return (
            f': the nearest has {float(nearest[index])!r} at {index}, '
            f'in the bag it is {float(recorded.reshape(-1)[index])!r}'
        )

    def _differ(self, sentence: str) -> None:
        self.difference = self.difference or sentence
        self.tally.different += 1


class _Copy:
    """
    Writes what comes when a twin is repeated, as messages of its topics.

    Times are those at which steps are due, and publishers count from 1, so that the same run gives
    the same messages whoever has recorded it.
    """

    def __init__(self, reader: BagReader, node: str, writer: BagWriter) -> None:
        self._writer = writer
        channels: dict[str, Channel] = {}
        for channel in reader.channels:
            channels.setdefault(channel.topic, channel)
        self._journal = channels[f'{node}/{_JOURNAL}']
        self._states = channels[f'{node}/{_STATES}']
        frame = _frame(reader, self._states)
        self._sides = [
            (side, channels[f'{node}/{side.name}'], side.encoder(frame))
            for side in _SIDES
            if f'{node}/{side.name}' in channels
        ]
        self._counts: dict[Channel, int] = {}
        self._encode_state = JointStateEncoder(frame, JOINTS).encode

    def write(self, step: Step) -> None:
        """Write what a step gives, and what stands in the journal before it."""
        for line in step.lines:
            self._write(step, self._journal, _encode_text(_present(line)))
        self._write(step, self._states, self._encode_state(step.due_ns, step.outputs.state))
        for side, channel, encode in self._sides:
            for payload in side.of(step.outputs):
                self._write(step, channel, encode(payload))

    def _write(self, step: Step, channel: Channel, data: bytes) -> None:
        count = self._counts[channel] = self._counts.get(channel, 0) + 1
        self._writer.write(Message(channel, data, step.due_ns, step.due_ns, count))


def _present(line: str) -> str:
    """Write in a start what repeats it now."""
    try:
        entry = journal.decode(line)
    except ValueError:
        return line
    if entry.get('versions', journal.VERSIONS) == journal.VERSIONS:
        return line
    return journal.encode({**entry, 'versions': dict(journal.VERSIONS)})


def _frame(reader: BagReader, channel: Channel) -> str:
    """Find the frame of states."""
    message = next(reader.messages(channel.topic), None)
    if message is None:
        return ''
    try:
        return str(decode(channel.type, channel.schema, message.data).header.frame_id)
    except (MessageError, AttributeError) as error:
        raise CheckError(f'{reader.path}: {channel.topic} cannot be read, {error}') from error


def _as_written(reader: BagReader, topics: set[str]) -> Iterator[Message]:
    """Yield messages in the order in which they stand in the bag."""
    return reader.messages(topics, by_log_time=False)


def _decoded(batch: Sequence[Message], states: str) -> list[_State | Message]:
    """Decode the states in a batch."""
    decoded = iter(_decode([item.data for item in batch if item.channel.topic == states]))
    return [next(decoded) if item.channel.topic == states else item for item in batch]


def _decode(datas: Sequence[bytes]) -> list[_State]:
    if not datas:
        return []
    unreadable = [_State(None)] * len(datas)
    try:
        states = decode_joint_states(datas)
    except MessageError:
        return unreadable if len(datas) == 1 else [_decode([data])[0] for data in datas]
    series = (states.position, states.velocity, states.effort)
    if states.names != JOINTS or any(values.shape[1] != len(JOINTS) for values in series):
        return unreadable
    rows = np.hstack(series).astype('<f8').tobytes()
    size = _STATE.size
    return [
        _State(stamp, rows[index * size : (index + 1) * size])
        for index, stamp in enumerate(states.stamps.tolist())
    ]


def _first_stamp(items: Iterable[_State | Message]) -> int | None:
    return next((item.stamp for item in items if isinstance(item, _State)), None)


def _text(message: Message) -> str | None:
    """Read a text, None if it is none."""
    try:
        text = decode(message.channel.type, message.channel.schema, message.data).data
    except (MessageError, AttributeError):
        return None
    return text if isinstance(text, str) else None


def _encode_text(text: str) -> bytes:
    """Write std_msgs/String."""
    data = text.encode() + b'\x00'
    return b'\x00\x01\x00\x00' + struct.pack('<I', len(data)) + data


def _batches(items: Iterable[Item], size: int) -> Iterator[list[Item]]:
    """Take so many at a time."""
    iterator = iter(items)
    while batch := list(islice(iterator, size)):
        yield batch


def _around(step: Step) -> int:
    """Return how many steps away, at the pace of a step, is too far."""
    return math.ceil(_AROUND * step.pace.rate)


def _seconds(time_ns: int) -> str:
    return f'{time_ns // _SECOND}.{time_ns % _SECOND:09d} s'
