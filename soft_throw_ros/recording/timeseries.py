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
What the messages of a twin say, as numbers over time: from a bag, or as they come.

All times are those of stamps. A message without a stamp (a phase, a line of the journal, a field)
was published right after the state message of its step, and gets its time from that one.
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
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.configuration.interface import find_topic, JOINTS, Topic, TWIN_TOPICS
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.cdr import decode, decode_joint_states, MessageError
from soft_throw_ros.recording.message import Message
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.tick_schedule import TickSchedule

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
Values = Mapping[str, float | str]

SECOND = 1_000_000_000  # [ns]

DECODING_ERRORS = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError,
)
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
    def join(cls, *parts: NDArray[np.void]) -> RigStates:
        """Put parts together, in the order of their stamps, of which each is there once."""
        joined = np.concatenate(parts)
        _, order = np.unique(joined['stamps'], return_index=True)
        return joined[order].view(cls)

    @property
    def tick(self) -> int:
        """Time from one to the next [ns]."""
        recent = self.stamps[-100:]
        return int(np.median(np.diff(recent))) if recent.size > 1 else _DEFAULT_TICK

    def stamp_of(self, published: int) -> int:
        """Return the stamp of the step with which something was published [ns]."""
        # the twin may follow another clock than messages are published by
        row = max(int(np.searchsorted(self.published, published, side='right')) - 1, 0)
        stamp = published + int(self.stamps[row] - self.published[row])
        nearest = int(self.stamps[np.abs(self.stamps - stamp).argmin()])
        return nearest if abs(nearest - stamp) <= self.tick // 2 else stamp

    def are_complete(self, begin: int, end: int) -> bool:
        """Tell whether they go from before a time to after another, and none is missing."""
        first, last = np.searchsorted(self.stamps, [begin + 1, end])
        if first == 0 or last == self.stamps.size:
            return False
        return bool(np.diff(self.stamps[first - 1:last + 1]).max() < 1.5 * self.tick)


class LayerStates(NamedTuple):
    """The layer at some times."""

    stamps: Stamps  # (n,) [ns]
    height: Floats  # (n, points) Of points from plate to top, evenly spaced at rest. [m]
    strain: Floats  # (n, points) There. [-]
    # (n,) Elastic and kinetic, relative to rest; NaN while the rig is put back. [J]
    energy: Floats
    # (n,) With that of the projectile; without loss it is the work of the plate. [J]
    total_energy: Floats


@dataclass(frozen=True, kw_only=True)
class StrainField:
    """Strain of the layer over time and height, in one throw."""

    times: Floats  # (n,) Since the start, in time of the rig. [s]
    stamps: Stamps  # (n,) The same by the clock of the stamps. [ns]
    strain: Floats  # (n, points) A row for each time, from plate to top. [-]
    thickness: float  # Of the layer at rest. [m]
    ejection_time: float | None  # When the projectile left; None if it did not. [s]


@dataclass(frozen=True, kw_only=True)
class ThrowStart:
    """A throw begins; `time_scale` is time of the rig over time of the stamps [ns], [-]."""

    stamp: int
    number: int
    time_scale: float
    has_field: bool = False  # as far as is known

    def seconds_to(self, stamps: Any) -> Any:  # of one, or of an array of them
        """Return the time of the rig from its start to some stamps [s]."""
        return (stamps - self.stamp) * (self.time_scale / SECOND)


def find_throws(messages: Iterable[Message]) -> dict[str, list[ThrowStart]]:
    """Return the throws of each twin; of messages those with `tells_throws` are enough."""
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
                continue  # it is counted when it is to be shown
            if reader.throw is not None and reader.throw is not before:
                throws.setdefault(node, []).append(reader.throw)
    return throws


def tells_throws(topic: str, type_name: str) -> bool:
    """Tell whether messages of such a topic tell when throws are, and whether they are whole."""
    return identify(topic, type_name)[1] in (TWIN_TOPICS.journal, TWIN_TOPICS.throw_field)


@functools.cache
def identify(name: str, type_name: str) -> tuple[str, Topic | None]:
    """Find of which node a topic is, and which; None if it is none of ours."""
    found = find_topic(name, type_name)
    return found or ('', None)


class TwinReader:
    """
    Reads the messages of one twin, each with what those before have said.

    Attributes
    ----------
    rig : Rig or None
        That of the throw under way; None while it is not known.
    settings, wanted : mapping of str to value
        Its settings, and those with what waits for the next throw.
    throw : ThrowStart or None
        The last throw; None before the first.
    ejection_time : float or None
        When the projectile leaves in it; None if that is not known. [s]
    states : RigStates or None
        Plate and projectile since it began, and one before.

    """

    def __init__(self) -> None:
        self.rig: Rig | None = None
        self.settings: Settings = TWIN.defaults()
        self.wanted: Settings = {}
        self.throw: ThrowStart | None = None
        self.ejection_time: float | None = None
        self.states: RigStates | None = None
        self._schedule: TickSchedule | None = None
        self._rest: tuple[float, float] | None = None  # heights measured before the throw

    @property
    def time_scale(self) -> float:
        """Time of the rig over that of the stamps [-]."""
        is_measured = self.settings['engine.motion'] == 'measured'
        return 1.0 if is_measured else float(self.settings['time_scale'])

    def wanted_rig(self) -> Rig | None:
        """Return the rig with what waits for the next throw; None if nothing is known of it."""
        return rig_of(self.wanted) if self.wanted else None

    def stamp_of(self, message: Message) -> int:
        """Find the stamp of the step that a message without one was published with [ns]."""
        published = _published(message)
        return published if self.states is None else self.states.stamp_of(published)

    # the journal

    def read_journal(self, message: Message) -> None:
        """Take over what a line says: a throw, a rig, or what is to come."""
        entry = journal.decode(read_text(message))
        match entry['kind']:
            case 'pace' | 'tick_schedule':  # the former is that of version 0.1
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
        """Keep when the projectile leaves in the throw under way."""
        time = values.get('ejection_time')
        if self.throw is None or values.get('throw') == self.throw.number:
            self.ejection_time = time if isinstance(time, float) and time > 0.0 else None

    def _set_rig(self, settings: Settings) -> None:
        """Take over settings, with nothing that waits."""
        if self.rig is None or settings != self.settings:
            self.rig = rig_of(settings)
        self.settings = self.wanted = settings

    def _start_throw(self, entry: journal.Entry, stamp: int) -> None:
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
        if self.states is not None:
            first = max(int(np.searchsorted(self.states.stamps, stamp)) - 1, 0)
            self.states = self.states[first:].view(RigStates)
        self._set_rig(settings)
        self.wanted = {**settings, **_known(entry.get('pending', {}))}
        self.throw = ThrowStart(stamp=stamp, number=number, time_scale=self.time_scale)
        self.ejection_time = None

    # plate and projectile

    def read_states(self, messages: Sequence[Message]) -> RigStates | None:
        """Read messages of plate and projectile; None if they are of another machine."""
        read = decode_joint_states([message.data for message in messages])
        if not set(JOINTS) <= set(read.names):
            return None
        records = np.zeros(len(messages), _STATE)
        columns = [read.names.index(name) for name in JOINTS]
        for name, values in vars(read).items():
            if name in ('position', 'velocity', 'effort') and values.shape[1] == len(read.names):
                records['force' if name == 'effort' else name] = values[:, columns]
        _check_numbers(records['position'], records['velocity'], records['force'])
        records['stamps'], records['published'] = read.stamps, list(map(_published, messages))
        states = self._with_energies(RigStates.join(records))
        before = () if self.states is None else (self.states,)
        self.states = RigStates.join(*before, states)[-_KEPT_STATES:].view(RigStates)
        return states

    def _with_energies(self, states: RigStates) -> RigStates:
        """Integrate what the plate does, from where it was last at rest."""
        before = states if self.states is None else self.states
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
        if self.rig is not None:
            energy = _projectile_energy(self.rig, states.position[:, 1], states.velocity[:, 1])
            energy[is_carried] = 0.0  # at rest, with whatever layer
        # without any force the layer is left out, and nothing is thrown: the rig is put back
        is_put_back = (states.force == 0.0).all(axis=1)
        work[is_put_back] = energy[is_put_back] = math.nan
        states.plate_work[:], states.projectile_energy[:] = work, energy
        return states

    def read_positions(
        self, topic: Topic, messages: Sequence[Message]
    ) -> tuple[Stamps, Floats] | None:
        """
        Read positions besides those of the states: measured, predicted, or what is left over.

        They are relative to rest if measured, and NaN for a joint that is not; None of another
        machine, or while rest is not known.
        """
        read = decode_joint_states([message.data for message in messages])
        if topic.joints[0] not in read.names or read.position.shape[1] != len(read.names):
            return None
        position = np.full((len(messages), len(topic.joints)), math.nan)
        for column, name in enumerate(topic.joints):
            if name in read.names:
                position[:, column] = read.position[:, read.names.index(name)]
        if topic == TWIN_TOPICS.measured_joint_states:
            if self._rest is None or self.rig is None:
                return None
            position -= [self._rest[0], self._rest[1] - _rest_height(self.rig)]
        is_number = (np.abs(position) <= _LARGEST).any(axis=1)
        return read.stamps[is_number], position[is_number]

    # the layer

    def read_layer(self, messages: Sequence[Message]) -> LayerStates | None:
        """Read messages of the layer; None while rig or plate are not known."""
        read = decode_joint_states([message.data for message in messages])
        if len(read.names) < 2 or read.position.shape != read.velocity.shape:
            raise MessageError(f'a layer of {len(read.names)} joints')
        _check_numbers(read.position, read.velocity)
        return self._layer_at(read.stamps, read.position, read.velocity)

    def read_former_strain(self, message: Message) -> LayerStates | None:
        """Read the strain of a layer, as bags of version 0.1 have it, whose speed is apart."""
        strain, stamps = _read_field(message, dimensions=1), np.array([self.stamp_of(message)])
        if self.rig is None or self.states is None:
            return None
        plate = self.states.position[self._rows(stamps), 0]
        height = _heights(strain[None], plate, self.rig.layer.thickness)
        return self._layer_at(stamps, height, np.full_like(height, math.nan))

    def _rows(self, stamps: Stamps) -> NDArray[np.intp]:
        """Return which states are of some stamps, or next to them."""
        assert self.states is not None
        return np.searchsorted(self.states.stamps, stamps).clip(0, self.states.size - 1)

    def _layer_at(self, stamps: Stamps, height: Floats, velocity: Floats) -> LayerStates | None:
        if self.rig is None or self.states is None:
            return None
        projectile = self.states.projectile_energy[self._rows(stamps)]
        energy = _layer_energy(self.rig, height, velocity) + 0.0 * projectile  # NaN as there
        step = self.rig.layer.thickness / (height.shape[1] - 1)
        strain = np.asarray(np.gradient(height, step, axis=1) - 1.0)
        return LayerStates(stamps, height, strain, energy, energy + projectile)

    def read_field(self, message: Message) -> StrainField | None:
        """Read the field of the throw under way; None while the rig is not known."""
        strain, stamp = _read_field(message, dimensions=2), self.stamp_of(message)
        if self.rig is None:
            return None
        throw = self.throw or ThrowStart(stamp=stamp, number=0, time_scale=self.time_scale)
        span = max(throw.seconds_to(stamp), throw.time_scale / SECOND)
        if self.ejection_time is not None:
            span = _FIELD_SPAN * self.ejection_time
        times = np.linspace(0.0, span, strain.shape[0])
        passed = np.rint(times * (SECOND / throw.time_scale)).astype(np.int64)
        return StrainField(
            times=times,
            stamps=throw.stamp + passed,
            strain=strain,
            thickness=self.rig.layer.thickness,
            ejection_time=self.ejection_time,
        )

    def see_throw(self, field: StrainField) -> tuple[Floats, LayerStates] | None:
        """
        Return positions, shape (n, 2) in [m], and layer at the times of a field.

        None if not all state messages of its throw are there.
        """
        states, rig, throw = self.states, self.rig, self.throw
        if states is None or rig is None or throw is None:
            return None
        if not states.are_complete(int(field.stamps[0]), int(field.stamps[-1])):
            return None
        path = CubicHermiteSpline(
            throw.seconds_to(states.stamps), states.position, states.velocity
        )
        position, speed = path(field.times), path(field.times, 1)
        # the field has no velocity, but a strain that changes moves what is above it
        rate = np.gradient(field.strain, field.times, axis=0, edge_order=2)
        velocity = _integral(rate, field.thickness) + speed[:, :1]
        height = _heights(field.strain, position[:, 0], field.thickness)
        energy = _layer_energy(rig, height, velocity)
        total = energy + _projectile_energy(rig, position[:, 1], speed[:, 1])
        return position, LayerStates(field.stamps, height, field.strain, energy, total)


# energies and heights


def _rest_height(rig: Rig) -> float:
    """Return where the projectile rests [m]."""
    return rig.layer.thickness - rig.static_sag


def _projectile_energy(rig: Rig, height: Floats, speed: Floats) -> Floats:
    """Return kinetic and potential energy of the projectile relative to rest [J]."""
    rise = height - _rest_height(rig)
    return np.asarray(rig.projectile.mass * (0.5 * speed**2 + rig.gravity * rise))


def _layer_energy(rig: Rig, height: Floats, velocity: Floats) -> Floats:
    """Return elastic and kinetic energy of the layer relative to rest, shape (n,) [J]."""
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
    """Return where points of a strained layer are, shape (n, points) [m]."""
    return plate_position[:, None] + _integral(1.0 + strain, thickness)


def _integral(values: Floats, thickness: float) -> Floats:
    """Integrate over the layer, from the plate to each point."""
    step = thickness / (values.shape[1] - 1)
    return np.asarray(cumulative_trapezoid(values, dx=step, axis=1, initial=0.0))


# single messages


def read_message(message: Message) -> Any:  # of any type
    """Decode a message, into fields as its definition names them."""
    return decode(message.channel.type, message.channel.schema, message.data)


def read_text(message: Message) -> str:
    """Read a String."""
    return str(read_message(message).data)


def to_ns(time: Any) -> int:  # a builtin_interfaces/Time
    """Return a time [ns]."""
    return int(time.sec * SECOND + time.nanosec)


def read_statuses(message: Message) -> Iterator[tuple[int, Any, dict[str, float | str]]]:
    """Yield stamp, status and its named values, for each status of a DiagnosticArray."""
    array = read_message(message)
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


def _read_field(message: Message, *, dimensions: int) -> Floats:
    """Read an array with a point at either end of the layer at least."""
    array = read_message(message)
    values = np.reshape(array.data, [each.size for each in array.layout.dim])
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


def _known(settings: Settings) -> Settings:
    """Return those settings that this twin has; raise ValueError for values that it refuses."""
    return {
        name: TWIN.check_value(name, value)
        for name, value in settings.items()
        if name in TWIN.by_name
    }
