# SPDX-License-Identifier: Apache-2.0
"""
Messages of twins as time series to draw: from a bag, or as they come, batch by batch.

Which topic is which is known by the end of its name and by its type, whatever the namespace; the
name of the node before that end tells the twins apart. All times are those of stamps. A message
without a stamp (a phase, a line of the journal, a field) was published right after the state
message of its step, and gets its time from that one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import math
import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicHermiteSpline
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.configuration.interface import (
    find_topic,
    FORMER_TOPICS,
    JOINTS,
    Topic,
    TWIN_TOPICS,
)
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.cdr import decode, decode_array, decode_joint_states, MessageError
from soft_throw_ros.recording.message import Message
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.tick_schedule import TickSchedule

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

SECOND = 1_000_000_000  # [ns]

_LOG = 'rcl_interfaces/msg/Log'

_AUXILIARY = (
    TWIN_TOPICS.measured_joint_states,
    TWIN_TOPICS.predicted_joint_states,
    TWIN_TOPICS.residual,
)

_DECODING_ERRORS = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError,
)  # fmt: skip
"""What comes of reading damaged bytes, or what somebody else means by the same name."""

_KEPT_STATES = 100_000
"""State messages that are kept of a throw, for the times of its field, which comes after it."""

_FIELD_SPAN = 1.5
"""The field of a throw goes to so many ejection times."""

_LARGEST = 1e6
"""Largest number in SI units, and of points, that is believed; damaged bytes give others."""

_LAST_TIME = 2**62  # [ns]

_DEFAULT_TICK = 1_000_000
"""Time between state messages, before there are two of them. [ns]"""

_SAME_CLOCK = 3600 * SECOND
"""Times by the journal that are farther from a message than this are of another clock. [ns]"""


_STATE = np.dtype(
    [('stamps', np.int64), ('published', np.int64)]
    + [(name, np.float64, 2) for name in ('position', 'velocity', 'force')]
    + [(name, np.float64) for name in ('plate_work', 'projectile_energy')]
)


class RigStates(np.recarray[Any, Any]):  # of records, which numpy has no type for
    """Plate and projectile, a record for each stamp, in ascending order."""

    stamps: Stamps  # (n,) When they were so. [ns]
    published: Stamps  # (n,) When that was said. [ns]
    # (n, 2) Of plate and projectile; the force is that of the layer on each, up. [m], [m/s], [N]
    position: Floats
    velocity: Floats
    force: Floats
    # (n,) Of the plate since it was last at rest; NaN while the rig is put back. [J]
    plate_work: Floats
    # (n,) Kinetic and potential, relative to rest; NaN as before, or if the rig is not known. [J]
    projectile_energy: Floats

    @classmethod
    def read(cls, messages: Sequence[Message]) -> RigStates | None:
        """Read messages of the same joints, without energies; None if of another machine."""
        read = decode_joint_states([message.data for message in messages])
        if not set(JOINTS) <= set(read.names):
            return None
        states = np.zeros(len(messages), _STATE).view(cls)
        columns = [read.names.index(name) for name in JOINTS]
        for name, values in vars(read).items():
            if name in ('position', 'velocity', 'effort') and values.shape[1] == len(read.names):
                states['force' if name == 'effort' else name] = values[:, columns]
        _check_numbers(states.position, states.velocity, states.force)
        published = [each.publish_time or each.log_time for each in messages]
        if max(published) > _LAST_TIME:
            raise MessageError(f'a time of {max(published)} ns')
        states.stamps[:], states.published[:] = read.stamps, published
        return cls.join(states)

    @classmethod
    def join(cls, *parts: RigStates) -> RigStates:
        """Put parts together, in the order of their stamps, of which each is there once."""
        joined: NDArray[Any] = np.concatenate(parts)  # of records, as above
        _, order = np.unique(joined['stamps'], return_index=True)
        return joined[order].view(cls)

    def since(self, stamp: int) -> RigStates:
        """Return those from a time on, and the one before."""
        first = max(int(np.searchsorted(self.stamps, stamp)) - 1, 0)
        return self[first:].view(RigStates)

    def rows(self, stamps: Stamps) -> NDArray[np.intp]:
        """Return which ones are of some stamps, or next to them."""
        return np.searchsorted(self.stamps, stamps).clip(0, self.stamps.size - 1)

    def stamp_of(self, published: int) -> int:
        """Return the stamp of the step with which something was published. [ns]"""
        # the twin may follow another clock than messages are published by
        row = max(int(np.searchsorted(self.published, published, side='right')) - 1, 0)
        stamp = published + int(self.stamps[row] - self.published[row])
        nearest = int(self.stamps[np.abs(self.stamps - stamp).argmin()])
        return nearest if abs(nearest - stamp) <= self._tick // 2 else stamp

    @property
    def _tick(self) -> int:
        """Time from one to the next. [ns]"""
        recent = self.stamps[-100:]
        return int(np.median(np.diff(recent))) if recent.size > 1 else _DEFAULT_TICK

    def are_complete(self, begin: int, end: int) -> bool:
        """Tell whether they go from before a time to after another, and none is missing."""
        first, last = np.searchsorted(self.stamps, [begin + 1, end])
        if first == 0 or last == self.stamps.size:
            return False
        return bool(np.diff(self.stamps[first - 1 : last + 1]).max() < 1.5 * self._tick)


@dataclass(frozen=True, kw_only=True)
class Positions:
    """
    Positions besides those that a `RigStates` has.

    The topic says what they are: those of the states at times between them, measured (relative to
    rest before the throw), predicted (of the projectile), or residual (by the model less those
    measured). A joint that is not measured is NaN.
    """

    topic: Topic
    stamps: Stamps  # (n,) [ns]
    position: Floats  # (n, joints) [m]


@dataclass(frozen=True, kw_only=True)
class LayerStates:
    """The layer at some times."""

    stamps: Stamps  # (n,) [ns]
    height: Floats  # (n, points) Of points from plate to top, evenly spaced at rest. [m]
    thickness: float  # At rest. [m]
    # (n,) Elastic and kinetic, relative to rest; NaN while the rig is put back. [J]
    energy: Floats
    # (n,) With that of the projectile; without loss it is the work of the plate. [J]
    total_energy: Floats
    # Whether these are all times of a throw's field, close together, and of nothing else
    is_throw: bool = False

    @property
    def strain(self) -> Floats:
        """Derivative of the displacement, shape (n, points). [-]"""
        step = self.thickness / (self.height.shape[1] - 1)
        return np.asarray(np.gradient(self.height, step, axis=1) - 1.0)


@dataclass(frozen=True, kw_only=True)
class StrainField:
    """Strain of the layer over time and height, in one throw."""

    start: int  # When the throw began. [ns]
    time_scale: float  # Time of the rig over time of the stamps. [-]
    times: Floats  # (n,) Since the start, in time of the rig. [s]
    strain: Floats  # (n, points) A row for each time, from plate to top. [-]
    thickness: float  # Of the layer at rest. [m]
    ejection_time: float | None  # When the projectile left; None if it did not. [s]

    def stamps(self) -> Stamps:
        """Return the times by the clock of the stamps. [ns]"""
        passed = np.rint(self.times * (SECOND / self.time_scale)).astype(np.int64)
        return np.asarray(self.start + passed)


@dataclass(frozen=True, kw_only=True)
class PhaseChange:
    """A phase begins."""

    stamp: int
    phase: str


@dataclass(frozen=True, kw_only=True)
class ThrowStart:
    """A throw begins; `time_scale` is time of the rig over time of the stamps. [ns], [-]"""

    stamp: int
    number: int
    time_scale: float
    has_field: bool = False  # as far as is known


@dataclass(frozen=True, kw_only=True)
class ThrowSummary:
    """
    Named numbers and words about a throw.

    What is known up to the release has the time of the throw's start, as the field has, so that
    both can be seen with the throw itself.
    """

    stamp: int
    values: Mapping[str, float | str]


@dataclass(frozen=True, kw_only=True)
class RecommendationSummary:
    """
    Named numbers and words about the recommended layer.

    `rig` is the one it was asked for, with changes that wait for the next throw; None if unknown.
    """

    stamp: int
    message: str
    values: Mapping[str, float | str]
    rig: Rig | None
    settings: Settings


@dataclass(frozen=True, kw_only=True)
class RigChange:
    """The rig and all settings, from some time on; `time_scale` is as in `ThrowStart`."""

    stamp: int
    rig: Rig
    settings: Settings
    time_scale: float


@dataclass(frozen=True, kw_only=True)
class LogLine:
    """What a node says; the level is that of rcl_interfaces/Log."""

    stamp: int
    level: int
    node: str
    text: str


Item = (
    RigStates
    | Positions
    | LayerStates
    | StrainField
    | PhaseChange
    | ThrowStart
    | ThrowSummary
    | RecommendationSummary
    | RigChange
    | LogLine
)


class Decoder:
    """
    Decodes messages in the order in which they came.

    Attributes
    ----------
    damaged : int
        Messages that could not be read.
    damage : str
        Why the first of them could not.

    """

    def __init__(self) -> None:
        self.damaged = 0
        self.damage = ''
        self._twins: dict[str, _TwinDecoder] = {}

    def decode(self, messages: Iterable[Message]) -> Iterator[tuple[str, Item]]:
        """Yield what messages say, and the twin that says it, which is empty for a `LogLine`."""
        waiting: dict[str, dict[Topic, list[Message]]] = {}
        for message in messages:
            if message.channel.type == _LOG:
                yield from (('', line) for line in self._read(_log_lines, [message]))
                continue
            node, topic = _identify(message.channel.topic, message.channel.type)
            if topic is None:
                continue
            if topic == TWIN_TOPICS.journal:  # what came before it is of the rig as it was
                yield from self._flush(node, waiting.pop(node, {}))
            waiting.setdefault(node, {}).setdefault(topic, []).append(message)
        for node, groups in waiting.items():
            yield from self._flush(node, groups)

    def _flush(
        self, node: str, groups: Mapping[Topic, Sequence[Message]]
    ) -> Iterator[tuple[str, Item]]:
        """Decode messages of one twin, topic by topic, such that each has what it needs."""
        twin = self._twins.setdefault(node, _TwinDecoder())
        for topic, read in twin.readers.items():
            if topic in groups:
                yield from ((node, item) for item in self._read(read, groups[topic]))

    def _read(
        self, read: Callable[[Sequence[Message]], Iterable[Item]], messages: Sequence[Message]
    ) -> list[Item]:
        """Read messages at once, or one by one if one is damaged or unlike the others."""
        try:
            return list(read(messages))
        except _DECODING_ERRORS as error:
            if len(messages) > 1:
                return [item for message in messages for item in self._read(read, [message])]
            self.damaged += 1
            self.damage = self.damage or f'{messages[0].channel.topic}: {error}'
            return []


def find_throws(messages: Iterable[Message]) -> dict[str, list[ThrowStart]]:
    """Return the throws of each twin; of messages those with `tells_throws` are enough."""
    throws: dict[str, list[ThrowStart]] = {}
    decoder = Decoder()
    for message in messages:
        node, topic = _identify(message.channel.topic, message.channel.type)
        if topic == TWIN_TOPICS.throw_field and throws.get(node):
            throws[node][-1] = replace(throws[node][-1], has_field=True)
        elif topic == TWIN_TOPICS.journal:
            starts = [item for _, item in decoder.decode([message])]
            throws.setdefault(node, []).extend(
                item for item in starts if isinstance(item, ThrowStart)
            )
    return throws


def tells_throws(topic: str, type_name: str) -> bool:
    """Tell whether messages of such a topic tell when throws are, and whether they are whole."""
    return _identify(topic, type_name)[1] in (TWIN_TOPICS.journal, TWIN_TOPICS.throw_field)


def is_shown(topic: str, type_name: str) -> bool:
    """Tell whether such a topic of a twin is decoded."""
    return _identify(topic, type_name)[1] is not None


@functools.cache
def _identify(name: str, type_name: str) -> tuple[str, Topic | None]:
    """Find of which node a topic is, and which; None if it is not decoded."""
    found = find_topic(name, type_name)
    return found if found and found.topic in _TwinDecoder().readers else ('', None)


class _TwinDecoder:
    """
    Decodes the messages of one twin.

    Attributes
    ----------
    readers : dict of Topic to callable
        What reads messages of each topic, in the order in which one needs the others.

    """

    def __init__(self) -> None:
        self._rig: Rig | None = None  # of the throw under way
        self._settings: Settings = TWIN.defaults()
        self._wanted: Settings = {}  # with what waits for the next throw
        self._number = 0  # of the last throw
        self._start: int | None = None  # when it began
        self._schedule: TickSchedule | None = None
        self._ejection_time: float | None = None
        self._rest: tuple[float, float] | None = None  # heights measured before the throw
        self._states: RigStates | None = None  # since the throw began, and one before
        self._former_strain: dict[int, Floats] = {}  # whose velocity has not come
        self.readers: dict[Topic, Callable[[Sequence[Message]], Iterable[Item]]] = {
            TWIN_TOPICS.journal: self._journal,
            TWIN_TOPICS.joint_states: self._rig_states,
            **{topic: functools.partial(self._auxiliary, topic) for topic in _AUXILIARY},
            TWIN_TOPICS.layer_joint_states: self._layer_states,
            FORMER_TOPICS.strain: self._keep_former_strain,
            FORMER_TOPICS.velocity: self._former_layer_states,
            TWIN_TOPICS.phase: self._phases,
            TWIN_TOPICS.throw_result: self._throw_summaries,
            TWIN_TOPICS.recommendation: self._recommendations,
            TWIN_TOPICS.throw_field: self._strain_fields,
        }

    @property
    def _time_scale(self) -> float:
        """Time of the rig over that of the stamps. [-]"""
        is_measured = self._settings['engine.motion'] == 'measured'
        return 1.0 if is_measured else float(self._settings['time_scale'])

    def _stamp(self, message: Message) -> int:
        """Find the stamp of the step that a message without one was published with."""
        published = message.publish_time or message.log_time
        if published > _LAST_TIME:
            raise MessageError(f'a time of {published} ns')
        return published if self._states is None else self._states.stamp_of(published)

    # the journal

    def _journal(self, messages: Sequence[Message]) -> Iterator[Item]:
        for message in messages:
            entry = journal.decode(_text(message))
            match entry['kind']:
                case 'pace' | 'tick_schedule':  # the former is that of version 0.1
                    self._schedule = journal.decode_schedule(entry)
                case 'input' if entry.get('input') == 'parameters':
                    self._wanted = {**self._wanted, **_known(entry['values'])}
                case 'input' if entry.get('input') == 'reset' and self._wanted:
                    yield from self._set_rig(self._wanted, self._stamp(message))
                case 'start':
                    yield from self._set_rig(_complete(entry), self._stamp(message))
                case 'throw':
                    yield from self._start_throw(entry, self._stamp(message))

    def _set_rig(self, settings: Settings, stamp: int) -> Iterator[RigChange]:
        """Take over settings, with nothing that waits."""
        is_same = self._rig is not None and settings == self._settings
        self._rig, self._settings, self._wanted = rig_of(settings), settings, settings
        if not is_same:
            scale = self._time_scale
            yield RigChange(stamp=stamp, rig=self._rig, settings=settings, time_scale=scale)

    def _start_throw(self, entry: journal.Entry, stamp: int) -> Iterator[Item]:
        """Take over what is said at the start of a throw, and find out when that was."""
        settings, step = _complete(entry), operator.index(entry['step'])
        number = operator.index(entry.get('throw', 0))
        if entry.get('schedule'):
            self._schedule = journal.decode_schedule(entry['schedule'])
        due = stamp if self._schedule is None else self._schedule.deadline(step)
        onset = entry.get('onset', entry.get('departure'))  # the latter is that of version 0.1
        self._rest = None
        if onset is not None:
            due = operator.index(onset['onset_ns'])
            self._rest = onset['plate_rest'], onset['projectile_rest'] or math.nan
        stamp = due if abs(due - stamp) < _SAME_CLOCK else stamp
        if self._states is not None:
            self._states = self._states.since(stamp)
        self._number, self._start, self._ejection_time = number, stamp, None
        yield from self._set_rig(settings, stamp)
        self._wanted = {**settings, **_known(entry.get('pending', {}))}
        yield ThrowStart(stamp=stamp, number=number, time_scale=self._time_scale)

    # plate and projectile

    def _rig_states(self, messages: Sequence[Message]) -> Iterator[RigStates]:
        read = RigStates.read(messages)
        if read is None:
            return
        states = self._with_energies(read)
        before = () if self._states is None else (self._states,)
        self._states = RigStates.join(*before, states)[-_KEPT_STATES:].view(RigStates)
        yield states

    def _with_energies(self, states: RigStates) -> RigStates:
        """Integrate what the plate does, from where it was last at rest."""
        before = states if self._states is None else self._states
        height = np.concatenate([before.position[-1:, 0], states.position[:, 0]])
        force = np.concatenate([before.force[-1:, 0], states.force[:, 0]])
        work = cumulative_trapezoid(-force, height)
        work += -work[0] if before is states else np.nan_to_num(before.plate_work[-1])
        # a measured plate is never quite at rest; what moves with it has not been thrown
        is_carried = states.velocity[:, 0] == states.velocity[:, 1]
        is_still = is_carried | (states.velocity[:, 0] == 0.0)
        last_rest = np.maximum.accumulate(np.where(is_still, np.arange(work.size), -1))
        work -= np.where(last_rest < 0, 0.0, work[last_rest])
        energy = np.full(work.size, math.nan)
        if self._rig is not None:
            energy = _projectile_energy(self._rig, states.position[:, 1], states.velocity[:, 1])
            energy[is_carried] = 0.0  # at rest, with whatever layer
        # without any force the layer is left out, and nothing is thrown: the rig is put back
        is_put_back = (states.force == 0.0).all(axis=1)
        work[is_put_back] = energy[is_put_back] = math.nan
        states.plate_work[:], states.projectile_energy[:] = work, energy
        return states

    def _auxiliary(self, topic: Topic, messages: Sequence[Message]) -> Iterator[Positions]:
        read = decode_joint_states([message.data for message in messages])
        if topic.joints[0] not in read.names or read.position.shape[1] != len(read.names):
            return  # it is of another machine
        position = np.full((len(messages), len(topic.joints)), math.nan)
        for column, name in enumerate(topic.joints):
            if name in read.names:
                position[:, column] = read.position[:, read.names.index(name)]
        if topic == TWIN_TOPICS.measured_joint_states:
            if self._rest is None or self._rig is None:
                return
            position -= [self._rest[0], self._rest[1] - _rest_height(self._rig)]
        is_number = (np.abs(position) <= _LARGEST).any(axis=1)
        yield Positions(topic=topic, stamps=read.stamps[is_number], position=position[is_number])

    # the layer

    def _layer_states(self, messages: Sequence[Message]) -> Iterator[LayerStates]:
        read = decode_joint_states([message.data for message in messages])
        if len(read.names) < 2 or read.position.shape != read.velocity.shape:
            raise MessageError(f'a layer of {len(read.names)} joints')
        _check_numbers(read.position, read.velocity)
        yield from self._layer_at(read.stamps, read.position, read.velocity)

    def _keep_former_strain(self, messages: Sequence[Message]) -> Iterator[LayerStates]:
        """Keep strain until the velocity of its step comes, as bags of version 0.1 have it."""
        for message in messages:
            self._former_strain[self._stamp(message)] = _field(message, dimensions=1)
        return iter(())

    def _former_layer_states(self, messages: Sequence[Message]) -> Iterator[LayerStates]:
        if self._rig is None or self._states is None:
            return
        pairs: dict[int, list[tuple[int, Floats, Floats]]] = {}
        for message in messages:
            stamp, velocity = self._stamp(message), _field(message, dimensions=1)
            strain = self._former_strain.pop(stamp, None)
            if strain is not None and strain.size == velocity.size:
                pairs.setdefault(strain.size, []).append((stamp, strain, velocity))
        self._former_strain = dict(list(self._former_strain.items())[-1:])
        for group in pairs.values():
            stamps, strain, velocity = (np.array(column) for column in zip(*group, strict=True))
            plate = self._states.position[self._states.rows(stamps), 0]
            height = _heights(strain, plate, self._rig.layer.thickness)
            yield from self._layer_at(stamps, height, velocity)

    def _layer_at(self, stamps: Stamps, height: Floats, velocity: Floats) -> Iterator[LayerStates]:
        if self._rig is None or self._states is None:
            return
        projectile = self._states.projectile_energy[self._states.rows(stamps)]
        energy = _layer_energy(self._rig, height, velocity) + 0.0 * projectile  # NaN as there
        yield LayerStates(
            stamps=stamps,
            height=height,
            thickness=self._rig.layer.thickness,
            energy=energy,
            total_energy=energy + projectile,
        )

    def _strain_fields(self, messages: Sequence[Message]) -> Iterator[Item]:
        for message in messages:
            if self._rig is None:
                return
            strain, stamp = _field(message, dimensions=2), self._stamp(message)
            start = stamp if self._start is None else self._start
            span = max(stamp - start, 1) * self._time_scale / SECOND
            if self._ejection_time is not None:
                span = _FIELD_SPAN * self._ejection_time
            field = StrainField(
                start=start,
                time_scale=self._time_scale,
                times=np.linspace(0.0, span, strain.shape[0]),
                strain=strain,
                thickness=self._rig.layer.thickness,
                ejection_time=self._ejection_time,
            )
            yield field
            yield from self._throw_in_detail(self._rig, field)

    def _throw_in_detail(self, rig: Rig, field: StrainField) -> Iterator[Item]:
        """Show the throw at the times of its field, if the state messages are all there."""
        states, stamps = self._states, field.stamps()
        if states is None or not states.are_complete(int(stamps[0]), int(stamps[-1])):
            return
        seconds = (states.stamps - field.start) * (field.time_scale / SECOND)
        path = CubicHermiteSpline(seconds, states.position, states.velocity)
        position, speed = path(field.times), path(field.times, 1)
        yield Positions(topic=TWIN_TOPICS.joint_states, stamps=stamps, position=position)
        # the field has no velocity, but a strain that changes moves what is above it
        rate = np.gradient(field.strain, field.times, axis=0, edge_order=2)
        velocity = _integral(rate, field.thickness) + speed[:, :1]
        height = _heights(field.strain, position[:, 0], field.thickness)
        energy = _layer_energy(rig, height, velocity)
        yield LayerStates(
            stamps=stamps,
            height=height,
            thickness=field.thickness,
            energy=energy,
            total_energy=energy + _projectile_energy(rig, position[:, 1], speed[:, 1]),
            is_throw=True,
        )

    # words

    def _phases(self, messages: Sequence[Message]) -> Iterator[PhaseChange]:
        for message in messages:
            yield PhaseChange(stamp=self._stamp(message), phase=_text(message))

    def _throw_summaries(self, messages: Sequence[Message]) -> Iterator[ThrowSummary]:
        for message in messages:
            for stamp, _, values in _statuses(message):
                time = values.get('ejection_time')
                self._ejection_time = time if isinstance(time, float) and time > 0.0 else None
                is_early = values.get('stage') in ('predicted', 'release')
                if is_early and self._start is not None and values.get('throw') == self._number:
                    stamp = self._start  # noqa: PLW2901
                yield ThrowSummary(stamp=stamp, values=values)

    def _recommendations(self, messages: Sequence[Message]) -> Iterator[RecommendationSummary]:
        for message in messages:
            for stamp, text, values in _statuses(message):
                yield RecommendationSummary(
                    stamp=stamp,
                    message=text,
                    values=values,
                    rig=rig_of(self._wanted) if self._wanted else None,
                    settings=self._wanted or self._settings,
                )


# energies and heights


def _rest_height(rig: Rig) -> float:
    """Return where the projectile rests. [m]"""
    return rig.layer.thickness - rig.static_sag


def _projectile_energy(rig: Rig, height: Floats, speed: Floats) -> Floats:
    """Return kinetic and potential energy of the projectile relative to rest. [J]"""
    rise = height - _rest_height(rig)
    return np.asarray(rig.projectile.mass * (0.5 * speed**2 + rig.gravity * rise))


def _layer_energy(rig: Rig, height: Floats, velocity: Floats) -> Floats:
    """Return elastic and kinetic energy of the layer relative to rest, shape (n,). [J]"""
    layer = rig.layer
    step = layer.thickness / (height.shape[1] - 1)
    strain = np.diff(height, axis=1) / step - 1.0
    speed_squared = 0.5 * (velocity[:, 1:] ** 2 + velocity[:, :-1] ** 2)
    middles = (np.arange(strain.shape[1]) + 0.5) * step
    sheets = getattr(layer, 'sheets', (layer,))  # from plate to top, each uniform
    tops = np.cumsum([sheet.thickness for sheet in sheets])
    sheet_of_cell = np.searchsorted(tops, middles).clip(max=len(sheets) - 1)
    modulus = np.array([sheet.youngs_modulus for sheet in sheets])[sheet_of_cell]
    density = np.array([sheet.density for sheet in sheets])[sheet_of_cell]
    rest = rig.projectile.mass * rig.gravity / (modulus * layer.section)
    per_volume = 0.5 * (modulus * (strain**2 - rest**2) + density * speed_squared)
    return np.asarray(layer.section * step * per_volume.sum(axis=1))


def _heights(strain: Floats, plate_position: Floats, thickness: float) -> Floats:
    """Return where points of a strained layer are, shape (n, points). [m]"""
    return plate_position[:, None] + _integral(1.0 + strain, thickness)


def _integral(values: Floats, thickness: float) -> Floats:
    """Integrate over the layer, from the plate to each point."""
    step = thickness / (values.shape[1] - 1)
    return np.asarray(cumulative_trapezoid(values, dx=step, axis=1, initial=0.0))


# single messages


def _decode(message: Message) -> Any:
    """Decode any message, into fields as its definition names them."""
    return decode(message.channel.type, message.channel.schema, message.data)


def _text(message: Message) -> str:
    return str(_decode(message).data)


def _time(stamp: Any) -> int:
    """Return a time of builtin_interfaces. [ns]"""
    return int(stamp.sec * SECOND + stamp.nanosec)


def _log_lines(messages: Sequence[Message]) -> Iterator[LogLine]:
    for line in map(_decode, messages):
        yield LogLine(stamp=_time(line.stamp), level=line.level, node=line.name, text=line.msg)


def _statuses(message: Message) -> Iterator[tuple[int, str, dict[str, float | str]]]:
    """Yield stamp, message and named values of each status."""
    array = _decode(message)
    for status in array.status:
        values = {str(item.key): _number_or_text(item.value) for item in status.values}
        yield _time(array.header.stamp), str(status.message), values


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return str(text)


def _field(message: Message, *, dimensions: int) -> Floats:
    """Read an array with a point at either end of the layer at least."""
    _, values = decode_array(message.data)
    if values.ndim != dimensions or min(values.shape) < 2 or values.size > _LARGEST:
        raise MessageError(f'an array of {dimensions} dimensions, not {values.shape}')
    _check_numbers(values)
    return values


def _check_numbers(*arrays: Floats) -> None:
    """Refuse numbers that no twin has, nor NaN."""
    if not all((np.abs(values) <= _LARGEST).all() for values in arrays):
        raise MessageError(f'a number beyond {_LARGEST:g}')


def _complete(entry: journal.Entry) -> Settings:
    """Return the settings of an entry, and defaults for what it does not have."""
    return {**TWIN.defaults(), **_known(entry['settings'])}


def _known(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return those settings that this twin has; raise ValueError for values that it refuses."""
    return {
        name: TWIN.check_value(name, value)
        for name, value in settings.items()
        if name in TWIN.by_name
    }
