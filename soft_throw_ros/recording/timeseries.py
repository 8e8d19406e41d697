# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Time series from the messages of a twin, recorded or live.

All times are stamps. A message without a stamp (a line of the journal or of the log) was published
right after the state message of its step, and gets the stamp of this state message.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import contextlib
from dataclasses import dataclass, replace
import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid
from scipy.interpolate import CubicHermiteSpline
from soft_throw_ros.configuration import motions, rig_of, Settings, TWIN
from soft_throw_ros.configuration.interface import (
    FIELD_POINTS,
    find_topic,
    JOINTS,
    Topic,
    TWIN_TOPICS,
)
from soft_throw_ros.core.plate import SampledMotion
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.storage.cdr import decode, JointStateReader, JointStates, MessageError
from soft_throw_ros.storage.message import Message
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.results import Floats, Phase
from soft_throw_ros.twin.tick_schedule import SECOND

Stamps = NDArray[np.int64]
Values = Mapping[str, float | str]

DECODING_ERRORS = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError,
)
"""Errors caused by damaged bytes, or by another program's messages on a topic of that name."""

_KEPT_STATES = 20_000
"""Number of state messages kept for the times of a throw's field, which comes after the throw."""

_LARGEST = 1e6
"""Largest plausible number in SI units, and of points; damaged bytes exceed it."""

_LAST_TIME = 2**62  # [ns]

_PHASES = {float(number): phase.value for number, phase in enumerate(Phase)}
"""Names of phases by their numbers in `~/phase_change`."""


class RigStates(NamedTuple):
    """States of plate and projectile over time."""

    stamps: Stamps  # (n,) [ns]
    published: Stamps  # (n,) Times of publishing, perhaps by another clock. [ns]
    # (n, 2) Plate and projectile, with the upward force of the layer on them. [m], [m/s], [N]
    position: Floats
    velocity: Floats
    force: Floats


_TIMES, _NUMBERS = np.empty(0, np.int64), np.empty((0, len(JOINTS)))
_NO_STATES = RigStates(_TIMES, _TIMES, _NUMBERS, _NUMBERS, _NUMBERS)


class LayerStates(NamedTuple):
    """States of the layer over time."""

    stamps: Stamps  # (n,) [ns]
    bottom: Floats  # (n,) Height of the lower end. [m]
    top: Floats  # (n,) Height of the upper end. [m]
    strain: Floats  # (n, points) Strain from plate to top, at points evenly spaced at rest. [-]


@dataclass(frozen=True, kw_only=True)
class ThrowStart:
    """Start of a throw [ns]; `time_scale` is time of the rig over time of the stamps [-]."""

    stamp: int
    number: int
    time_scale: float
    ejection_time: float | None = None  # from the start; None if there is none so far [s]
    is_over: bool = False  # whether its end has been reported

    def seconds_to(self, stamps: Any) -> Any:
        """Return the time of the rig from the start to a stamp or an array of stamps [s]."""
        return (stamps - self.stamp) * (self.time_scale / SECOND)

    def stamps_at(self, seconds: Floats) -> Stamps:
        """Return the stamps for times of the rig since the start [ns]."""
        return self.stamp + np.rint(seconds * (SECOND / self.time_scale)).astype(np.int64)


class StrainField(NamedTuple):
    """Strain of the layer over time and height, in one throw."""

    throw: ThrowStart
    times: Floats  # (n,) Time of the rig since the start. [s]
    stamps: Stamps  # (n,) The same times as stamps. [ns]
    strain: Floats  # (n, points) Strain from plate to top. [-]
    thickness: float  # Thickness of the layer at rest. [m]


def find_throws(messages: Iterable[Message]) -> dict[str, list[ThrowStart]]:
    """Return the throws of each twin in journals; of a repeated one, that which is complete."""
    throws: dict[str, dict[int, ThrowStart]] = {}  # by twin and stamp
    readers: dict[str, TwinReader] = {}
    for message in messages:
        node, _ = identify(message.channel.topic, message.channel.type)
        reader = readers.setdefault(node, TwinReader())
        with contextlib.suppress(*DECODING_ERRORS):  # the view counts the message as unreadable
            reader.read_journal(message)
        if (throw := reader.throw) is not None:
            known = throws.setdefault(node, {})
            if throw.is_over or not known.get(throw.stamp, throw).is_over:
                known[throw.stamp] = throw
    return {node: list(by_stamp.values()) for node, by_stamp in throws.items()}


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
        self._motions: dict[str, str] = {}  # encoded motions by file
        self._rest_heights: tuple[float, float] | None = None  # heights measured before the throw
        self._clock_offset_ns = 0  # of the stamps of measurements [ns]
        self.span = math.inf, -math.inf  # stamps of the first and the last state [ns]
        self._states = _NO_STATES  # the last ones

    @property
    def time_scale(self) -> float:
        """Time of the rig over time of the stamps [-]."""
        is_measured = self.settings['engine.motion'] == 'measured'
        return 1.0 if is_measured else float(self.settings['time_scale'])

    def _names(self, joints: Sequence[str]) -> tuple[str, ...]:
        """Return the names of joints by the settings."""
        return tuple(self.settings[f'joint_names.{joint}'] for joint in joints)

    def wanted_rig(self) -> Rig | None:
        """Return the rig of the next throw, with all pending changes; None if unknown."""
        return rig_of(self.wanted, self._motion_of) if self.wanted else None

    def forget_states(self) -> None:
        """Clear the last states, when stamps go back."""
        self._states = _NO_STATES

    def stamp_of(self, message: Message) -> int:
        """Return the stamp of the step of a message without a stamp [ns]."""
        published, states = _published(message), self._states
        if not states.stamps.size:
            return published
        row = int(np.searchsorted(states.published, published, side='right')) - 1
        return int(states.stamps[max(row, 0)])

    # the journal

    def read_journal(self, message: Message) -> tuple[int, Rig] | None:
        """
        Apply a line of the journal: a throw, a rig, or pending changes.

        Return a rig that takes effect, with the stamp of that time [ns]; None if none does.
        """
        entry = journal.decode(str(decode(message).data))
        self._motions |= entry.get('motions', {})
        rig, stamp = self.rig, self.stamp_of(message)
        match entry['kind']:
            case 'input' if entry.get('input') == 'parameters':
                self.wanted = {**self.wanted, **_known(entry['values'])}
            case 'input' if entry.get('input') == 'reset' and self.wanted:
                self._set_rig(self.wanted)
            case 'start':
                self._set_rig(_complete(entry))
            case 'throw':
                stamp = self._start_throw(entry)
            case 'result' if self.throw and entry['result'].get('throw') == self.throw.number:
                time = entry['result'].get('ejection_time')
                is_release = isinstance(time, float) and time > 0.0
                self.throw = replace(
                    self.throw,
                    ejection_time=time if is_release else None,
                    is_over=entry['result'].get('stage') == 'final',
                )
        return None if self.rig is None or self.rig is rig else (stamp, self.rig)

    def _set_rig(self, settings: Settings) -> None:
        """Apply settings, and clear pending changes."""
        if self.rig is None or settings != self.settings:
            self.rig = rig_of(settings, self._motion_of)
        self.settings = self.wanted = settings

    def _motion_of(self, path: str) -> SampledMotion:
        """Return the motion of a file from the journal; the file itself is not opened."""
        return _decode_motion(self._motions[path])

    def _start_throw(self, entry: journal.Entry) -> int:
        """Apply the line of the start of a throw, and return the stamp of the start."""
        settings = _complete(entry)
        wanted = {**settings, **_known(entry.get('pending', {}))}
        if 'onset' in entry:
            onset = journal.decode_onset(entry['onset'])
            stamp, rest_heights = onset.onset_ns, (onset.rest.plate, onset.rest.projectile)
            self._clock_offset_ns = onset.clock_offset_ns
        else:
            stamp = journal.decode_schedule(entry['schedule']).deadline(entry['step'])
            rest_heights = None
        self._set_rig(settings)
        self.wanted = wanted
        self._rest_heights = rest_heights
        self.throw = ThrowStart(
            stamp=stamp, number=entry['throw'], time_scale=self.time_scale
        )
        return stamp

    # plate and projectile

    def read_states(self, messages: Sequence[Message]) -> RigStates | None:
        """Read messages of plate and projectile; return None for those of another machine."""
        joints = _read_joint_states(messages)
        series = joints.position, joints.velocity, joints.effort
        is_ours = joints.names == self._names(JOINTS)
        if not is_ours or any(values.shape[1] != len(JOINTS) for values in series):
            return None
        published = np.array([_published(message) for message in messages])
        states = RigStates(joints.stamps, published, *series)
        first, last = self.span
        self.span = min(first, int(states.stamps.min())), max(last, int(states.stamps.max()))
        self._states = RigStates(*(
            np.concatenate(pair)[-_KEPT_STATES:] for pair in zip(self._states, states, strict=True)
        ))
        return states

    def read_positions(
        self, messages: Sequence[Message], topic: Topic
    ) -> tuple[Stamps, Floats] | None:
        """
        Read measured positions, predicted positions or residuals; NaN for a joint without them.

        Measured positions are relative to rest, at times by the clock of the twin. Return None for
        another machine, or while the rest is unknown.
        """
        joints = _read_joint_states(messages)
        names = self._names(topic.joints)
        if names[0] not in joints.names or joints.position.shape[1] != len(joints.names):
            return None
        position = np.full((len(messages), len(names)), math.nan)
        for column, name in enumerate(names):
            if name in joints.names:
                position[:, column] = joints.position[:, joints.names.index(name)]
        if topic == TWIN_TOPICS.measured_joint_states:
            if self._rest_heights is None or self.rig is None:
                return None
            position -= [self._rest_heights[0], self._rest_heights[1] - self.rig.rest_height]
            return joints.stamps + self._clock_offset_ns, position
        return joints.stamps, position

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
        if joints.position.shape[1] != FIELD_POINTS:
            raise MessageError(f'a layer of {FIELD_POINTS} joints, got {joints.position.shape[1]}')
        if self.rig is None:
            return None
        height, step = joints.position, self.rig.layer.thickness / (FIELD_POINTS - 1)
        strain = np.asarray(np.gradient(height, step, axis=1) - 1.0)
        return LayerStates(joints.stamps, height[:, 0], height[:, -1], strain)

    def read_field(self, message: Message) -> StrainField | None:
        """Read the field of the throw under way; None while no throw is known."""
        points, throw = _read_cloud(message, TWIN_TOPICS.throw_field), self.throw
        if throw is None:
            return None
        times, thickness = points[:, 0, 0], float(points[0, -1, 1])
        return StrainField(throw, times, throw.stamps_at(times), points[..., 2], thickness)

    def read_energies(self, message: Message) -> tuple[Stamps, Floats] | None:
        """Read `ENERGIES` of the throw under way; None while no throw is known."""
        (rows,) = _read_cloud(message, TWIN_TOPICS.throw_energies)
        return None if self.throw is None else (self.throw.stamps_at(rows[:, 0]), rows[:, 1:])

    def interpolate_throw(self, field: StrainField) -> tuple[Floats, LayerStates] | None:
        """Return positions (n, 2) and the layer at times of a field; None without its states."""
        stamps, rows = np.unique(self._states.stamps, return_index=True)
        if not stamps.size or field.stamps[0] < stamps[0]:
            return None
        states, seconds = self._states, field.throw.seconds_to(stamps)
        path = CubicHermiteSpline(seconds, states.position[rows], states.velocity[rows])
        position = path(field.times)
        stretch = trapezoid(field.strain, dx=1.0 / (FIELD_POINTS - 1), axis=1)
        bottom = position[:, 0]
        top = bottom + field.thickness * (1.0 + stretch)
        return position, LayerStates(field.stamps, bottom, top, field.strain)

    # results

    def read_results(self, message: Message) -> list[tuple[int, Values]]:
        """Read results of throws with their stamps; early ones have the stamp of the start."""
        results = []
        for stamp, _, values in read_statuses(message):
            is_early = values.get('stage') in ('predicted', 'release')
            if self.throw and is_early and values.get('throw') == self.throw.number:
                stamp = self.throw.stamp  # noqa: PLW2901
            results.append((stamp, values))
        return results

    def read_recommendations(self, message: Message) -> list[tuple[int, str, Values]]:
        """Read stamps, sentences and values of recommendations."""
        return [
            (stamp, str(status.message), values)
            for stamp, status, values in read_statuses(message)
        ]


# messages


def read_statuses(message: Message) -> list[tuple[int, Any, Values]]:
    """Return stamp, status and its named values, for each status of a DiagnosticArray."""
    array = decode(message)
    stamp = to_ns(array.header.stamp)
    return [
        (stamp, status, {str(item.key): _number_or_text(item.value) for item in status.values})
        for status in array.status
    ]


def to_ns(time: Any) -> int:  # a builtin_interfaces/Time
    """Return a time [ns]."""
    return int(time.sec * SECOND + time.nanosec)


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return str(text)


def _published(message: Message) -> int:
    """Return when a message was published, or else received [ns]."""
    if message.published > _LAST_TIME:
        raise MessageError(f'a time of {message.published} ns')
    return message.published


def _read_joint_states(messages: Sequence[Message]) -> JointStates:
    joints = JointStateReader().read_all([message.data for message in messages])
    numbers = np.hstack([joints.position, joints.velocity, joints.effort])
    if (np.abs(numbers) > _LARGEST).any():  # NaN is a missing measurement
        raise MessageError(f'a number beyond {_LARGEST:g}')
    return joints


def _read_cloud(message: Message, topic: Topic) -> Floats:
    """Read the points of a cloud with the fields of a topic, shape (rows, columns, fields)."""
    cloud, count = decode(message), len(topic.axes)
    names = tuple(field.name for field in cloud.fields)
    shape = cloud.height, cloud.width, count
    if names != topic.axes or len(cloud.data) != 8 * math.prod(shape) or min(shape) < 1:
        raise MessageError(f'a cloud of {", ".join(topic.axes)}, got {", ".join(names)}')
    return np.frombuffer(bytes(cloud.data), '<f8').reshape(shape)


def _complete(entry: journal.Entry) -> Settings:
    """Return the settings of an entry, with defaults for missing ones."""
    return {**TWIN.defaults(), **_known(entry['settings'])}


@functools.lru_cache(maxsize=4)
def _decode_motion(text: str) -> SampledMotion:
    """Decode a motion; the same text gives the same object, so that rigs are equal."""
    return motions.decode(text)


def _known(settings: Settings) -> Settings:
    """Return the known settings; raise ValueError for a bad value."""
    return {
        name: TWIN.check_value(name, value)
        for name, value in settings.items()
        if name in TWIN.by_name
    }


READERS: Mapping[Topic, Callable[[TwinReader, Any], Any]] = {
    TWIN_TOPICS.journal: TwinReader.read_journal,
    TWIN_TOPICS.joint_states: TwinReader.read_states,
    **{
        topic: functools.partial(TwinReader.read_positions, topic=topic)
        for topic in (
            TWIN_TOPICS.measured_joint_states,
            TWIN_TOPICS.predicted_joint_states,
            TWIN_TOPICS.residual,
        )
    },
    TWIN_TOPICS.layer_joint_states: TwinReader.read_layer,
    TWIN_TOPICS.phase_change: TwinReader.read_phase_changes,
    TWIN_TOPICS.throw_result: TwinReader.read_results,
    TWIN_TOPICS.recommendation: TwinReader.read_recommendations,
    TWIN_TOPICS.throw_field: TwinReader.read_field,
    TWIN_TOPICS.throw_energies: TwinReader.read_energies,
}
"""
Methods that read a message, or several ones of joints; None or an empty result shows nothing.

Later methods need the data of earlier ones.
"""
