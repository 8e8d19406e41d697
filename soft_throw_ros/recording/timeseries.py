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
"""
Time series from the messages of a twin, recorded or live.

All times are stamps. A message without a stamp (a phase, a line of the journal, a field) was
published right after the state message of its step, and gets the stamp of this state message.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import math
import operator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicHermiteSpline
from soft_throw_ros.configuration import motions, rig_of, Settings, TWIN
from soft_throw_ros.configuration.interface import ENERGIES, find_topic, JOINTS, Topic, TWIN_TOPICS
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.storage.cdr import decode, JointStateReader, JointStates, MessageError
from soft_throw_ros.storage.message import Message
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.results import Floats, Phase
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule

Stamps = NDArray[np.int64]
Values = Mapping[str, float | str]

DECODING_ERRORS = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError,
)
"""Errors caused by damaged bytes, or by another program's messages on a topic of that name."""

_KEPT_STATES = 100_000
"""Number of state messages kept for the times of a throw's field, which comes after the throw."""

_FIELD_SPAN = 1.5
"""Time span of the field of a throw. [ejection times]"""

_LARGEST = 1e6
"""Largest plausible number in SI units, and of points; damaged bytes exceed it."""

_LAST_TIME = 2**62  # [ns]

_DEFAULT_TICK = 1_000_000
"""Assumed time between state messages before two have arrived. [ns]"""

_SAME_CLOCK = 3600 * SECOND
"""Time between journal and message beyond which the journal used another clock. [ns]"""

_PHASES = {float(number): phase.value for number, phase in enumerate(Phase)}
"""Names of phases by their numbers in `~/phase_change`."""


@dataclass(frozen=True, kw_only=True)
class RigStates:
    """States of plate and projectile."""

    stamps: Stamps  # (n,) [ns]
    published: Stamps  # (n,) Times of publishing. [ns]
    # (n, 2) Plate and projectile, with the upward force of the layer on them. [m], [m/s], [N]
    position: Floats
    velocity: Floats
    force: Floats

    def select(self, rows: slice | NDArray[np.intp]) -> RigStates:
        """Return some of the states."""
        return RigStates(**{name: values[rows] for name, values in vars(self).items()})

    @classmethod
    def join(cls, *batches: RigStates) -> RigStates:
        """Concatenate states in the order of their stamps, without repeated stamps."""
        joined = cls(**{
            name: np.concatenate([getattr(batch, name) for batch in batches])
            for name in vars(batches[0])
        })
        return joined.select(np.unique(joined.stamps, return_index=True)[1])

    @property
    def tick(self) -> int:
        """Time between two states [ns]."""
        recent = self.stamps[-100:]
        return int(np.median(np.diff(recent))) if recent.size > 1 else _DEFAULT_TICK

    def stamp_of(self, published: int) -> int:
        """Return the stamp of the step for a time of publishing [ns]."""
        # The clock of the stamps may differ from the clock of publishing
        row = max(int(np.searchsorted(self.published, published, side='right')) - 1, 0)
        stamp = published + int(self.stamps[row] - self.published[row])
        nearest = int(self.stamps[np.abs(self.stamps - stamp).argmin()])
        return nearest if abs(nearest - stamp) <= self.tick // 2 else stamp

    def are_complete(self, begin: int, end: int) -> bool:
        """Return whether the states cover a time span without a gap."""
        first, last = np.searchsorted(self.stamps, [begin + 1, end])
        if first == 0 or last == self.stamps.size:
            return False
        return bool(np.diff(self.stamps[first - 1:last + 1]).max() < 1.5 * self.tick)


class LayerStates(NamedTuple):
    """States of the layer over time."""

    stamps: Stamps  # (n,) [ns]
    height: Floats  # (n, points) Heights of points from plate to top, evenly spaced at rest. [m]
    strain: Floats  # (n, points) Strain at these points. [-]


@dataclass(frozen=True, kw_only=True)
class StrainField:
    """Strain of the layer over time and height, in one throw."""

    times: Floats  # (n,) Time of the rig since the start. [s]
    stamps: Stamps  # (n,) The same times as stamps. [ns]
    strain: Floats  # (n, points) Strain from plate to top. [-]
    thickness: float  # Thickness of the layer at rest. [m]
    ejection_time: float | None  # Time of the release, None without a release. [s]


@dataclass(frozen=True, kw_only=True)
class ThrowStart:
    """Start of a throw [ns]; `time_scale` is time of the rig over time of the stamps [-]."""

    stamp: int
    number: int
    time_scale: float
    has_field: bool = False  # as far as is known

    def seconds_to(self, stamps: Any) -> Any:
        """Return the time of the rig from the start to a stamp or an array of stamps [s]."""
        return (stamps - self.stamp) * (self.time_scale / SECOND)

    def stamps_at(self, seconds: Floats) -> Stamps:
        """Return the stamps for times of the rig since the start [ns]."""
        return self.stamp + np.rint(seconds * (SECOND / self.time_scale)).astype(np.int64)


def find_throws(messages: Iterable[Message]) -> dict[str, list[ThrowStart]]:
    """Return the throws of each twin; only messages with `has_throws` are needed."""
    throws: dict[str, list[ThrowStart]] = {}
    readers: dict[str, TwinReader] = {}
    for message in messages:
        node, topic = identify(message.channel.topic, message.channel.type)
        if topic == TWIN_TOPICS.throw_field and throws.get(node):
            throws[node][-1] = replace(throws[node][-1], has_field=True)
        elif topic == TWIN_TOPICS.journal:
            reader = readers.setdefault(node, TwinReader())
            before = reader.throw
            try:
                reader.read_journal(message)
            except DECODING_ERRORS:
                continue  # the view counts it as unreadable
            if reader.throw is not None and reader.throw is not before:
                throws.setdefault(node, []).append(reader.throw)
    return throws


def has_throws(topic: str, type_name: str) -> bool:
    """Return whether a topic contains the starts of throws, or shows that they are complete."""
    return identify(topic, type_name)[1] in (TWIN_TOPICS.journal, TWIN_TOPICS.throw_field)


@functools.cache
def identify(name: str, type_name: str) -> tuple[str, Topic | None]:
    """Return the node and the entry of a topic; the entry is None for topics of other packages."""
    result = find_topic(name, type_name)
    return result or ('', None)


class TwinReader:
    """A reader of the messages of one twin that remembers settings and states."""

    def __init__(self) -> None:
        self.rig: Rig | None = None  # of the present throw; None while unknown
        self.settings: Settings = TWIN.defaults()  # of the present throw
        self.wanted: Settings = {}  # of the next throw, with all pending changes
        self.throw: ThrowStart | None = None  # the last one
        self.ejection_time: float | None = None  # in this throw; None if unknown [s]
        self.states: RigStates | None = None  # from one state before this throw on
        self._schedule: TickSchedule | None = None
        self._motions: dict[str, str] = {}  # encoded motions by file
        self._rest_heights: tuple[float, float] | None = None  # heights measured before the throw

    @property
    def time_scale(self) -> float:
        """Time of the rig over time of the stamps [-]."""
        is_measured = self.settings['engine.motion'] == 'measured'
        return 1.0 if is_measured else float(self.settings['time_scale'])

    def wanted_rig(self) -> Rig | None:
        """Return the rig of the next throw, with all pending changes; None if unknown."""
        return rig_of(self.wanted, self._motion_of) if self.wanted else None

    def stamp_of(self, message: Message) -> int:
        """Return the stamp of the step of a message without a stamp [ns]."""
        published = _published(message)
        return published if self.states is None else self.states.stamp_of(published)

    # the journal

    def read_journal(self, message: Message) -> None:
        """Apply a line of the journal: a throw, a rig, or pending changes."""
        entry = journal.decode(str(decode(message).data))
        self._motions |= entry.get('motions', {})
        match entry['kind']:
            case 'tick_schedule':
                self._schedule = journal.decode_schedule(entry)
            case 'input' if entry.get('input') == 'parameters':
                self.wanted = {**self.wanted, **_known(entry['values'])}
            case 'input' if entry.get('input') == 'reset' and self.wanted:
                self._set_rig(self.wanted)
            case 'start':
                self._set_rig(_complete(entry))
            case 'throw':
                self._start_throw(entry, self.stamp_of(message))
            case 'result':
                self.note_result(entry['result'])

    def note_result(self, values: Mapping[str, object]) -> None:
        """Store the ejection time of the present throw."""
        time = values.get('ejection_time')
        if self.throw is None or values.get('throw') == self.throw.number:
            self.ejection_time = time if isinstance(time, float) and time > 0.0 else None

    def _set_rig(self, settings: Settings) -> None:
        """Apply settings, and clear pending changes."""
        if self.rig is None or settings != self.settings:
            self.rig = rig_of(settings, self._motion_of)
        self.settings = self.wanted = settings

    def _motion_of(self, path: str) -> SampledMotion:
        """Return the motion of a file from the journal; the file itself is not opened."""
        return _decode_motion(self._motions[path])

    def _start_throw(self, entry: journal.Entry, stamp: int) -> None:
        """Apply the line of the start of a throw, and determine the stamp of the start."""
        settings, step = _complete(entry), operator.index(entry['step'])
        number = operator.index(entry.get('throw', 0))
        if entry.get('schedule'):
            self._schedule = journal.decode_schedule(entry['schedule'])
        due = stamp if self._schedule is None else self._schedule.deadline(step)
        onset = entry.get('onset')
        self._rest_heights = None
        if onset is not None:
            due = operator.index(onset['onset_ns'])
            self._rest_heights = onset['plate_rest'], onset['projectile_rest'] or math.nan
        stamp = due if abs(due - stamp) < _SAME_CLOCK else stamp
        if self.states is not None:
            first = max(int(np.searchsorted(self.states.stamps, stamp)) - 1, 0)
            self.states = self.states.select(slice(first, None))
        self._set_rig(settings)
        self.wanted = {**settings, **_known(entry.get('pending', {}))}
        self.throw = ThrowStart(stamp=stamp, number=number, time_scale=self.time_scale)
        self.ejection_time = None

    # plate and projectile

    def read_states(self, messages: Sequence[Message]) -> RigStates | None:
        """Read messages of plate and projectile; return None for those of another machine."""
        joints = _read_joint_states(messages)
        if not set(JOINTS) <= set(joints.names):
            return None
        columns = [joints.names.index(name) for name in JOINTS]
        missing = np.zeros((len(messages), len(JOINTS)))
        position, velocity, force = (
            values[:, columns] if values.shape[1] == len(joints.names) else missing
            for values in (joints.position, joints.velocity, joints.effort)
        )
        _check_numbers(position, velocity, force)
        states = RigStates.join(RigStates(
            stamps=joints.stamps,
            published=np.array([_published(message) for message in messages]),
            position=position,
            velocity=velocity,
            force=force,
        ))
        before = () if self.states is None else (self.states,)
        self.states = RigStates.join(*before, states).select(slice(-_KEPT_STATES, None))
        return states

    def read_positions(
        self, topic: Topic, messages: Sequence[Message]
    ) -> tuple[Stamps, Floats] | None:
        """
        Read measured positions, predicted positions or residuals.

        Measured positions are relative to rest, and NaN for a joint without measurement. Return
        None for another machine, or while the rest is unknown.
        """
        joints = _read_joint_states(messages)
        if topic.joints[0] not in joints.names or joints.position.shape[1] != len(joints.names):
            return None
        position = np.full((len(messages), len(topic.joints)), math.nan)
        for column, name in enumerate(topic.joints):
            if name in joints.names:
                position[:, column] = joints.position[:, joints.names.index(name)]
        if topic == TWIN_TOPICS.measured_joint_states:
            if self._rest_heights is None or self.rig is None:
                return None
            position -= [self._rest_heights[0], self._rest_heights[1] - self.rig.rest_height]
        is_number = (np.abs(position) <= _LARGEST).any(axis=1)
        return joints.stamps[is_number], position[is_number]

    def read_phase_changes(self, messages: Sequence[Message]) -> list[tuple[int, str]]:
        """Read stamps [ns] and names of phases; those of another machine are left out."""
        joints = _read_joint_states(messages)
        if joints.names != TWIN_TOPICS.phase_change.joints or joints.position.shape[1] != 1:
            return []
        pairs = zip(joints.stamps.tolist(), joints.position[:, 0].tolist(), strict=True)
        return [(stamp, _PHASES[number]) for stamp, number in pairs if number in _PHASES]

    # the layer

    def read_layer(self, messages: Sequence[Message]) -> LayerStates | None:
        """Read messages of the layer; None while the rig is not known."""
        joints = _read_joint_states(messages)
        if len(joints.names) < 2 or joints.position.shape[1] != len(joints.names):
            raise MessageError(f'a layer of {len(joints.names)} joints')
        _check_numbers(joints.position)
        if self.rig is None:
            return None
        step = self.rig.layer.thickness / (len(joints.names) - 1)
        strain = np.asarray(np.gradient(joints.position, step, axis=1) - 1.0)
        return LayerStates(joints.stamps, joints.position, strain)

    def read_field(self, message: Message) -> StrainField | None:
        """Read the field of the throw under way; None while no throw is known."""
        strain, throw = _read_array(message), self.throw
        if self.rig is None or throw is None:
            return None
        span = max(throw.seconds_to(self.stamp_of(message)), throw.time_scale / SECOND)
        if self.ejection_time is not None:
            span = _FIELD_SPAN * self.ejection_time
        times = np.linspace(0.0, span, strain.shape[0])
        return StrainField(
            times=times,
            stamps=throw.stamps_at(times),
            strain=strain,
            thickness=self.rig.layer.thickness,
            ejection_time=self.ejection_time,
        )

    def read_energies(self, message: Message) -> tuple[Stamps, Floats] | None:
        """
        Read the energies of the throw under way, with the columns `ENERGIES` after the first.

        Return None while no throw is known.
        """
        array = _read_array(message)
        if array.shape[1] != len(ENERGIES):
            raise MessageError(f'energies of {len(ENERGIES)} columns, got {array.shape[1]}')
        return None if self.throw is None else (self.throw.stamps_at(array[:, 0]), array[:, 1:])

    def interpolate_throw(self, field: StrainField) -> tuple[Floats, LayerStates] | None:
        """
        Return positions of plate and projectile, shape (n, 2), and the layer at times of a field.

        Return None if not all state messages of the throw are there.
        """
        states, throw = self.states, self.throw
        if states is None or throw is None:
            return None
        if not states.are_complete(int(field.stamps[0]), int(field.stamps[-1])):
            return None
        path = CubicHermiteSpline(
            throw.seconds_to(states.stamps), states.position, states.velocity
        )
        position = path(field.times)
        step = field.thickness / (field.strain.shape[1] - 1)
        rise = cumulative_trapezoid(1.0 + field.strain, dx=step, axis=1, initial=0.0)
        return position, LayerStates(field.stamps, rise + position[:, :1], field.strain)


# messages


def _read_joint_states(messages: Sequence[Message]) -> JointStates:
    return JointStateReader().read_all([message.data for message in messages])


def to_ns(time: Any) -> int:  # a builtin_interfaces/Time
    """Return a time [ns]."""
    return int(time.sec * SECOND + time.nanosec)


def read_statuses(message: Message) -> Iterator[tuple[int, Any, dict[str, float | str]]]:
    """Yield stamp, status and its named values, for each status of a DiagnosticArray."""
    array = decode(message)
    for status in array.status:
        values = {str(item.key): _number_or_text(item.value) for item in status.values}
        yield to_ns(array.header.stamp), status, values


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return str(text)


def _published(message: Message) -> int:
    """Return when a message was published, or else received [ns]."""
    published = message.publish_time or message.log_time
    if published > _LAST_TIME:
        raise MessageError(f'a time of {published} ns')
    return published


def _read_array(message: Message) -> Floats:
    """Read an array of at least two rows and columns."""
    array = decode(message)
    values = np.reshape(array.data, [axis.size for axis in array.layout.dim])
    if values.ndim != 2 or min(values.shape) < 2 or values.size > _LARGEST:
        raise MessageError(f'an array of 2 dimensions, not {values.shape}')
    _check_numbers(values)
    return values


def _check_numbers(*arrays: Floats) -> None:
    """Refuse numbers that no twin has, nor NaN."""
    if not all((np.abs(values) <= _LARGEST).all() for values in arrays):
        raise MessageError(f'a number beyond {_LARGEST:g}')


def _complete(entry: journal.Entry) -> Settings:
    """Return the settings of an entry, with defaults for missing ones."""
    return {**TWIN.defaults(), **_known(entry['settings'])}


@functools.lru_cache(maxsize=4)
def _decode_motion(text: str) -> SampledMotion:
    """Decode a motion; the same text gives the same object, so that rigs are equal."""
    return motions.decode(text)


def _known(settings: Settings) -> Settings:
    """Return the known settings by their present names; raise ValueError for a bad value."""
    return {
        name: TWIN.check_value(name, value)
        for name, value in TWIN.without_deprecated(settings).items()
        if name in TWIN.by_name
    }
