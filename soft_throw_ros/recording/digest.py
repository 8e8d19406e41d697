# SPDX-License-Identifier: Apache-2.0
"""
What the messages of twins say, as arrays to draw: from a bag or as they come, batch by batch.

Which topic is which is known by the end of its name and by its type, whatever the namespace, and
what comes before that end names the twin. All times are those of the state messages' stamps. What
has no stamp (the layer, the phase, the journal) was published right after the state message of its
step, and gets its time from that.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
import itertools
import math
import operator
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.recording.cdr import decode, decode_array, decode_joint_states, MessageError
from soft_throw_ros.recording.message import Message
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]

T = TypeVar('T')

JOINTS = ('plate', 'projectile')

STATES = 'joint_states'
STRAIN = 'layer/strain'
VELOCITY = 'layer/velocity'
THROW_FIELD = 'throw_field'
PHASE = 'phase'
THROW_RESULT = 'throw_result'
RECOMMENDATION = 'recommendation'
JOURNAL = 'journal'
MEASURED = 'measured_joint_states'
PREDICTED = 'predicted_joint_states'
RESIDUAL = 'residual'

_JOINT_STATE = 'sensor_msgs/msg/JointState'
_ARRAY = 'std_msgs/msg/Float64MultiArray'
_TEXT = 'std_msgs/msg/String'
_DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'

_TYPES = {
    STATES: _JOINT_STATE,
    STRAIN: _ARRAY,
    VELOCITY: _ARRAY,
    THROW_FIELD: _ARRAY,
    PHASE: _TEXT,
    THROW_RESULT: _DIAGNOSTICS,
    RECOMMENDATION: _DIAGNOSTICS,
    JOURNAL: _TEXT,
    MEASURED: _JOINT_STATE,
    PREDICTED: _JOINT_STATE,
    RESIDUAL: _JOINT_STATE,
}

_BESIDE = {MEASURED: JOINTS, PREDICTED: JOINTS[1:], RESIDUAL: JOINTS}
"""What is said of which joints, beside the states."""

_LOG = 'rcl_interfaces/msg/Log'

_BAD = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError)
"""What comes of reading damaged bytes, or what somebody else means by the same name."""

_KEPT = 200_000
"""State messages of a throw that are kept until its field comes."""

_FIELD_SPAN = 1.5
"""A throw's field goes to so many ejection times."""

_LARGEST = 1e6
"""No twin has a larger number, in SI units, nor a layer of more points."""

_LAST_TIME = 2**62  # [ns]

_TICK = 1_000_000
"""Between state messages, before there are two of them. [ns]"""

_NEAR = 3600 * SECOND
"""Two clocks that are farther apart have nothing to do with each other."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """
    Plate and projectile.

    Parameters
    ----------
    stamps : ndarray, shape (n,)
        [ns]
    position, velocity, force : ndarray, shape (n, 2)
        Of plate and projectile; the force is that of the layer on each, up. [m], [m/s], [N]
    plate_work : ndarray, shape (n,)
        Of the plate since it was last at rest; NaN while things are put back. [J]
    projectile_energy : ndarray, shape (n,)
        Kinetic and potential, against rest; NaN as before, or while the rig is not known. [J]

    """

    stamps: Stamps
    position: Floats
    velocity: Floats
    force: Floats
    plate_work: Floats
    projectile_energy: Floats


@dataclass(frozen=True, kw_only=True)
class Places:
    """Where plate and projectile are between state messages: shape (n,), and (n, 2). [ns], [m]"""

    stamps: Stamps
    position: Floats


@dataclass(frozen=True, kw_only=True)
class Beside:
    """
    Positions besides those of the states.

    Parameters
    ----------
    kind : str
        `MEASURED`, of plate and projectile, above where they rest before the throw; `PREDICTED`,
        of the projectile; or `RESIDUAL`, of both, by the model less those measured.
    stamps : ndarray, shape (n,)
        [ns]
    position : ndarray, shape (n, joints)
        NaN for a joint that is not measured. [m]

    """

    kind: str
    stamps: Stamps
    position: Floats


@dataclass(frozen=True, kw_only=True)
class LayerStrain:
    """
    The layer at some times.

    Parameters
    ----------
    stamps : ndarray, shape (n,)
        [ns]
    plate_position : ndarray, shape (n,)
        Where the layer begins. [m]
    strain : ndarray, shape (n, points)
        From plate to top, evenly spaced at rest. [-]
    thickness : float
        At rest. [m]

    """

    stamps: Stamps
    plate_position: Floats
    strain: Floats
    thickness: float

    def heights(self) -> Floats:
        """Return where the points of the layer are, shape (n, points). [m]"""
        points = self.strain.shape[1]
        step = self.thickness / (points - 1)
        stretched = step * (1.0 + 0.5 * (self.strain[:, 1:] + self.strain[:, :-1]))
        heights = np.empty(self.strain.shape)
        heights[:, 0] = self.plate_position
        heights[:, 1:] = self.plate_position[:, None] + np.cumsum(stretched, axis=1)
        return heights


@dataclass(frozen=True, kw_only=True)
class LayerEnergy:
    """
    Elastic and kinetic energy of the layer, against rest.

    Parameters
    ----------
    stamps : ndarray, shape (n,)
        [ns]
    layer : ndarray, shape (n,)
        NaN while things are put back. [J]
    total : ndarray, shape (n,)
        With that of the projectile, which is the work of the plate. [J]

    """

    stamps: Stamps
    layer: Floats
    total: Floats


@dataclass(frozen=True, kw_only=True)
class ThrowPicture:
    """
    Strain of the layer over time and height, in one throw.

    Parameters
    ----------
    start : int
        When the throw began. [ns]
    time_scale : float
        Time of the rig over that of the stamps. [-]
    times : ndarray, shape (n,)
        Since the start, in time of the rig. [s]
    strain : ndarray, shape (n, points)
        A row for each time, from plate to top. [-]
    thickness : float
        Of the layer at rest. [m]
    ejection_time : float or None
        When the projectile left; None if it did not. [s]

    """

    start: int
    time_scale: float
    times: Floats
    strain: Floats
    thickness: float
    ejection_time: float | None

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
class Report:
    """
    Named numbers and words about a throw (`THROW_RESULT`), or a `RECOMMENDATION`.

    What is known at a release stands at the beginning of the throw, as its field does, so that
    both can be seen with the throw itself.
    """

    stamp: int
    kind: str
    message: str
    values: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class RigChange:
    """The rig and all its settings, from some time on."""

    stamp: int
    rig: Rig
    settings: Settings


@dataclass(frozen=True, kw_only=True)
class LogLine:
    """What a node says; the level is that of rcl_interfaces/Log."""

    stamp: int
    level: int
    node: str
    text: str


Part = (
    Motion
    | Places
    | Beside
    | LayerStrain
    | LayerEnergy
    | ThrowPicture
    | PhaseChange
    | Report
    | RigChange
    | LogLine
)


class Digest:
    """
    What has come so far, as far as the next message needs it.

    Attributes
    ----------
    twins : dict of str to TwinDigest
        By what their topics begin with.
    damaged : int
        Messages that could not be read.
    damage : str
        Why the first of them could not.

    """

    def __init__(self) -> None:
        self.twins: dict[str, TwinDigest] = {}
        self.damaged = 0
        self.damage = ''

    def take(self, messages: Iterable[Message]) -> Iterator[tuple[str, Part]]:
        """
        Read messages, in the order in which they came.

        Yields
        ------
        tuple of str and Part
            What they say, and of which twin; of none for a `LogLine`.

        """
        waiting: dict[str, list[tuple[str, Message]]] = {}
        for message in messages:
            if message.channel.type == _LOG:
                yield from self._log_line(message)
                continue
            prefix, kind = _place(message.channel.topic, message.channel.type)
            if kind == JOURNAL:  # what came before it is of the rig as it was
                yield from self._flush(prefix, waiting.pop(prefix, []))
            if kind:
                waiting.setdefault(prefix, []).append((kind, message))
        for prefix, waits in waiting.items():
            yield from self._flush(prefix, waits)

    def _flush(
        self, prefix: str, messages: Sequence[tuple[str, Message]]
    ) -> Iterator[tuple[str, Part]]:
        if not messages:
            return
        if prefix not in self.twins:
            self.twins[prefix] = TwinDigest(self._note)
        for part in self.twins[prefix].take(messages):
            yield prefix, part

    def _log_line(self, message: Message) -> Iterator[tuple[str, Part]]:
        try:
            line = _decode(message)
            stamp = line.stamp.sec * SECOND + line.stamp.nanosec
            yield '', LogLine(stamp=stamp, level=line.level, node=line.name, text=line.msg)
        except (MessageError, AttributeError) as error:
            self._note(message, error)

    def _note(self, message: Message, error: Exception) -> None:
        self.damaged += 1
        self.damage = self.damage or f'{message.channel.topic}: {error}'


class TwinDigest:
    """
    The same for the messages of one twin.

    Parameters
    ----------
    on_damage : callable
        Called with a message that cannot be read, and why.

    Attributes
    ----------
    rig : Rig or None
        As the journal says last.
    settings : mapping of str to value
        Those of the twin.
    start : int or None
        When the last throw began. [ns]

    """

    def __init__(self, on_damage: Callable[[Message, Exception], None]) -> None:
        self.rig: Rig | None = None
        self.settings: Settings = TWIN.defaults()
        self.start: int | None = None
        self._on_damage = on_damage
        self._pace: TickSchedule | None = None
        self._ejection_time: float | None = None
        self._rest: tuple[float, float] | None = None  # where a rig was measured at rest
        self._states: list[_States] = []  # since the throw began
        self._recent: _States | None = None  # of this batch and the last
        self._strains: list[tuple[int, Floats]] = []  # whose velocities have not come

    @property
    def time_scale(self) -> float:
        """Time of the rig over that of the stamps. [-]"""
        if self.settings['engine.motion'] == 'measured':
            return 1.0
        return float(self.settings['time_scale'])

    def take(self, messages: Sequence[tuple[str, Message]]) -> Iterator[Part]:
        """Read messages, each with its kind; one of the journal can be the first only."""
        if messages[0][0] == JOURNAL:
            yield from self._read(self._entry, messages[0][1])
        states = [message for kind, message in messages if kind == STATES]
        if states:
            yield from self._motion(states)
        layers: dict[str, list[tuple[int, Floats]]] = {STRAIN: [], VELOCITY: []}
        for kind, message in messages:
            if kind in layers:
                layers[kind] += self._read(self._layer, message)
            elif kind == THROW_FIELD:
                yield from self._read(self._throw_field, message)
            elif kind == PHASE:
                yield from self._read(self._phase, message)
            elif kind in (THROW_RESULT, RECOMMENDATION):
                yield from self._read(self._reports, message, kind)
        for name in _BESIDE:
            beside = [message for kind, message in messages if kind == name]
            if beside:
                yield from self._beside(name, beside)
        yield from self._layer_strain(layers[STRAIN])
        yield from self._layer_energy(layers[STRAIN], layers[VELOCITY])

    def _read(self, read: Callable[..., Iterator[T]], message: Message, *rest: str) -> list[T]:
        """Return what a message says; nothing, if it is damaged."""
        try:
            return list(read(message, *rest))
        except _BAD as error:
            self._on_damage(message, error)
            return []

    # times

    def _stamp(self, message: Message) -> int:
        """Find when a message without a stamp was published, by the clock of the stamps."""
        published = message.publish_time or message.log_time
        if published > _LAST_TIME:
            raise MessageError(f'a time of {published} ns')
        states = self._recent
        if states is None:
            return published
        row = max(int(np.searchsorted(states.published, published, side='right')) - 1, 0)
        return published + int(states.stamps[row] - states.published[row])

    def _step_stamp(self, message: Message) -> int:
        """Return the stamp of the state message that was published with it."""
        stamp = self._stamp(message)
        if self._recent is None:
            return stamp
        stamps = self._recent.stamps
        nearest = int(stamps[np.abs(stamps - stamp).argmin()])
        return nearest if abs(nearest - stamp) <= self._recent.tick // 2 else stamp

    # plate and projectile

    def _motion(self, messages: Sequence[Message]) -> Iterator[Motion]:
        for states in self._read_states(messages):
            self._add_energies(states)
            self._recent = _States.join([*self._states[-1:], states])
            self._states.append(states)
            yield Motion(
                stamps=states.stamps,
                position=states.position,
                velocity=states.velocity,
                force=states.force,
                plate_work=np.where(states.is_put_back, math.nan, states.plate_work),
                projectile_energy=states.projectile_energy,
            )
        while len(self._states) > 1 and sum(each.stamps.size for each in self._states) > _KEPT:
            self._states.pop(0)

    def _read_states(self, messages: Sequence[Message]) -> Iterator[_States]:
        """Read state messages at once, or one by one if they are not all alike."""
        try:
            parts = [_States.read(messages)]
        except MessageError:
            parts = []
            for message in messages:
                try:
                    parts.append(_States.read([message]))
                except MessageError as error:
                    self._on_damage(message, error)
        yield from (part for part in parts if part is not None)

    def _beside(self, kind: str, messages: Sequence[Message]) -> Iterator[Beside]:
        """Read what is said of positions besides the states."""
        joints = _BESIDE[kind]
        try:
            read = decode_joint_states([message.data for message in messages])
        except MessageError as error:
            self._on_damage(messages[0], error)
            return
        if joints[0] not in read.names or read.position.shape[1] != len(read.names):
            return  # it is of another machine
        position = np.full((len(messages), len(joints)), math.nan)
        for column, name in enumerate(joints):
            if name in read.names:
                position[:, column] = read.position[:, read.names.index(name)]
        if kind == MEASURED:
            if self._rest is None or self.rig is None:
                return
            height = self.rig.layer.thickness - self.rig.static_sag
            position -= [self._rest[0], self._rest[1] - height]
        is_number = (np.abs(position) <= _LARGEST).any(axis=1)
        yield Beside(kind=kind, stamps=read.stamps[is_number], position=position[is_number])

    def _add_energies(self, states: _States) -> None:
        """Integrate what the plate does, from where it was last at rest."""
        before = self._states[-1] if self._states else states
        height = np.concatenate([before.position[-1:, 0], states.position[:, 0]])
        force = np.concatenate([before.force[-1:, 0], states.force[:, 0]])
        gained = -np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(height))
        work = gained - gained[0] if before is states else before.plate_work[-1] + gained
        # a measured plate is never quite at rest; what moves with it has not been thrown
        is_carried = states.velocity[:, 0] == states.velocity[:, 1]
        is_still = is_carried | (states.velocity[:, 0] == 0.0)
        rows = np.where(is_still, np.arange(work.size), -1)
        last_rest = np.maximum.accumulate(rows)
        states.plate_work = work - np.where(last_rest < 0, 0.0, work[last_rest])
        if self.rig is not None:
            energy = self._carried(states.position[:, 1], states.velocity[:, 1])
            energy[is_carried] = 0.0  # at rest, with whatever layer
            states.projectile_energy = np.where(states.is_put_back, math.nan, energy)

    # the layer

    def _layer(self, message: Message) -> Iterator[tuple[int, Floats]]:
        yield self._step_stamp(message), _field(message, dimensions=1)

    def _layer_strain(self, strains: Sequence[tuple[int, Floats]]) -> Iterator[LayerStrain]:
        if self.rig is None or self._recent is None:
            return
        for group in _alike(strains):
            stamps = np.array([stamp for stamp, _ in group])
            yield LayerStrain(
                stamps=stamps,
                plate_position=self._recent.at(stamps, 'position')[:, 0],
                strain=np.array([strain for _, strain in group]),
                thickness=self.rig.layer.thickness,
            )

    def _layer_energy(
        self, strains: Sequence[tuple[int, Floats]], velocities: Sequence[tuple[int, Floats]]
    ) -> Iterator[LayerEnergy]:
        """Put strain and velocity of the same step together."""
        if self.rig is None or self._recent is None:
            return
        strain_at = dict([*self._strains, *strains])
        pairs = []
        for stamp, velocity in velocities:
            strain = strain_at.pop(stamp, None)
            if strain is not None and strain.shape == velocity.shape:
                pairs.append((stamp, self._stored(strain, velocity)))
        self._strains = list(strain_at.items())[-1:]
        if not pairs:
            return
        stamps = np.array([stamp for stamp, _ in pairs])
        energy = np.array([energy for _, energy in pairs])
        projectile = self._recent.at(stamps, 'projectile_energy')
        energy[np.isnan(projectile)] = math.nan
        yield LayerEnergy(stamps=stamps, layer=energy, total=energy + projectile)

    def _carried(self, height: Floats, speed: Floats) -> Floats:
        """Return kinetic and potential energy of the projectile against rest. [J]"""
        assert self.rig is not None
        rise = height - self.rig.layer.thickness + self.rig.static_sag
        return self.rig.projectile.mass * (0.5 * speed**2 + self.rig.gravity * rise)

    def _stored(self, strain: Floats, velocity: Floats) -> float:
        """Return elastic and kinetic energy of the layer against rest. [J]"""
        assert self.rig is not None
        layer = self.rig.layer
        stiffness = layer.youngs_modulus * layer.section
        rest = self.rig.projectile.mass * self.rig.gravity / stiffness
        density = 0.5 * stiffness * (strain**2 - rest**2)
        density += 0.5 * layer.density * layer.section * velocity**2
        ends = 0.5 * (density[0] + density[-1])
        return float(layer.thickness / (strain.size - 1) * (density.sum() - ends))

    def _throw_field(self, message: Message) -> Iterator[Part]:
        if self.rig is None:
            return
        strain = _field(message, dimensions=2)
        stamp = self._stamp(message)
        start = stamp if self.start is None else self.start
        span = max(stamp - start, 1) * self.time_scale / SECOND
        if self._ejection_time is not None:
            span = _FIELD_SPAN * self._ejection_time
        picture = ThrowPicture(
            start=start,
            time_scale=self.time_scale,
            times=np.linspace(0.0, span, strain.shape[0]),
            strain=strain,
            thickness=self.rig.layer.thickness,
            ejection_time=self._ejection_time,
        )
        yield picture
        yield from self._places(picture)

    def _places(self, picture: ThrowPicture) -> Iterator[Part]:
        """Show the throw in the times of its field, if the state messages are all there."""
        if self.rig is None or not self._states:
            return
        states = _States.join(self._states)
        stamps = picture.stamps()
        if not (states.stamps[0] <= stamps[0] and stamps[-1] <= states.stamps[-1]):
            return
        seconds = (states.stamps - picture.start) * (picture.time_scale / SECOND)
        path = CubicHermiteSpline(seconds, states.position, states.velocity)
        position = path(picture.times)
        yield Places(stamps=stamps, position=position)
        yield LayerStrain(
            stamps=stamps,
            plate_position=position[:, 0],
            strain=picture.strain,
            thickness=picture.thickness,
        )
        # the field has no velocity, but a strain that changes moves what is above it
        step = picture.thickness / (picture.strain.shape[1] - 1)
        rate = np.gradient(picture.strain, picture.times, axis=0, edge_order=2)
        velocity = np.empty(rate.shape)
        velocity[:, 0] = path(picture.times, 1)[:, 0]
        velocity[:, 1:] = velocity[:, :1] + np.cumsum(0.5 * step * (rate[:, 1:] + rate[:, :-1]), 1)
        energy = np.array(list(map(self._stored, picture.strain, velocity)))
        height, speed = position[:, 1], path(picture.times, 1)[:, 1]
        yield LayerEnergy(stamps=stamps, layer=energy, total=energy + self._carried(height, speed))

    # words

    def _phase(self, message: Message) -> Iterator[PhaseChange]:
        yield PhaseChange(stamp=self._step_stamp(message), phase=_text(message))

    def _reports(self, message: Message, kind: str) -> Iterator[Report]:
        array = _decode(message)
        stamp = array.header.stamp.sec * SECOND + array.header.stamp.nanosec
        for status in array.status:
            values = {str(item.key): _value(item.value) for item in status.values}
            if kind == THROW_RESULT:
                time = values.get('ejection_time')
                self._ejection_time = time if isinstance(time, float) and time > 0.0 else None
                if values.get('stage') in ('predicted', 'release') and self.start is not None:
                    stamp = self.start
            yield Report(stamp=stamp, kind=kind, message=str(status.message), values=values)

    def _entry(self, message: Message) -> Iterator[RigChange]:
        entry = journal.decode(_text(message))
        stamp = self._stamp(message)
        self._pace = journal.entry_schedule(entry) or self._pace
        if entry['kind'] not in ('start', 'throw'):
            return
        step = operator.index(entry['step'])
        if entry['kind'] == 'throw':
            due = stamp if self._pace is None else self._pace.deadline(step)
            self._rest = None
            if 'onset' in entry:
                onset = journal.decode_onset(entry['onset'])
                due = onset.onset_ns
                self._rest = onset.plate_rest, onset.projectile_rest
            self.start = stamp = due if abs(due - stamp) < _NEAR else stamp
            self._ejection_time = None
            self._states = [
                states for states in self._states if states.stamps[-1] >= stamp
            ] or self._states[-1:]
        settings = {**TWIN.defaults(), **_known(entry['settings'])}
        if self.rig is None or settings != self.settings:
            self.rig, self.settings = rig_of(settings), settings
            yield RigChange(stamp=stamp, rig=self.rig, settings=settings)


@dataclass(kw_only=True)
class _States:
    """State messages, one after another."""

    stamps: Stamps
    published: Stamps
    position: Floats
    velocity: Floats
    force: Floats
    plate_work: Floats
    projectile_energy: Floats

    @classmethod
    def read(cls, messages: Sequence[Message]) -> _States | None:
        """Read messages of the same joints; None if they are of another machine."""
        read = decode_joint_states([message.data for message in messages])
        if not set(JOINTS) <= set(read.names):
            return None
        columns = [read.names.index(name) for name in JOINTS]
        count = len(messages)
        position, velocity, force = (
            values[:, columns] if values.shape[1] == len(read.names) else np.zeros((count, 2))
            for values in (read.position, read.velocity, read.effort)
        )
        is_number = (np.abs([position, velocity, force]) <= _LARGEST).all(axis=(0, 2))
        if not is_number.all():
            raise MessageError(f'a number beyond {_LARGEST:g}')
        published = [message.publish_time or message.log_time for message in messages]
        if max(published) > _LAST_TIME:
            raise MessageError(f'a time of {max(published)} ns')
        return cls(
            stamps=read.stamps,
            published=np.array(published, np.int64),
            position=position,
            velocity=velocity,
            force=force,
            plate_work=np.zeros(count),
            projectile_energy=np.full(count, math.nan),
        )

    @classmethod
    def join(cls, parts: Sequence[_States]) -> _States:
        """Put parts together, in the order of their stamps, of which each is there once."""
        names = [item.name for item in fields(cls)]
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        _, order = np.unique(joined['stamps'], return_index=True)
        return cls(**{name: values[order] for name, values in joined.items()})

    @property
    def is_put_back(self) -> NDArray[np.bool_]:
        """Where there are no forces at all: the layer is left out, and nothing is thrown."""
        return np.asarray((self.force == 0.0).all(axis=1))

    @cached_property
    def tick(self) -> int:
        """Time from one to the next. [ns]"""
        return int(np.median(np.diff(self.stamps))) if self.stamps.size > 1 else _TICK

    def at(self, stamps: Stamps, name: str) -> Floats:
        """Return a series at other times, between its first and its last."""
        rows = np.searchsorted(self.stamps, stamps).clip(0, self.stamps.size - 1)
        return np.asarray(getattr(self, name)[rows])


def is_shown(topic: str, type_name: str) -> bool:
    """Tell whether something is said by such a topic."""
    return bool(_place(topic, type_name)[1])


@cache
def _place(topic: str, type_name: str) -> tuple[str, str]:
    """Divide the name of a topic into what it is called of, and what it is; or say neither."""
    for kind, expected in _TYPES.items():
        if type_name == expected and topic.endswith(f'/{kind}'):
            return topic.removesuffix(f'/{kind}'), kind
    return '', ''


def _decode(message: Message) -> Any:
    return decode(message.channel.type, message.channel.schema, message.data)


def _text(message: Message) -> str:
    return str(_decode(message).data)


def _field(message: Message, *, dimensions: int) -> Floats:
    """Read an array with a point at either end of the layer at least."""
    _, values = decode_array(message.data)
    if values.ndim != dimensions or min(values.shape) < 2:
        raise MessageError(f'an array of {dimensions} dimensions, not {values.shape}')
    if values.size > _LARGEST or not (np.abs(values) <= _LARGEST).all():
        raise MessageError(f'a number beyond {_LARGEST:g}')
    return values


def _alike(layers: Sequence[tuple[int, Floats]]) -> Iterator[list[tuple[int, Floats]]]:
    """Group fields that have as many points."""
    for _, group in itertools.groupby(layers, key=lambda field: field[1].size):
        yield list(group)


def _value(text: str) -> float | str:
    """Read a number if it is one."""
    try:
        value = float(text)
    except ValueError:
        return str(text)
    return value


def _known(settings: Any) -> dict[str, Any]:
    """Return those settings that this twin has, or raise ValueError."""
    return {
        name: TWIN.check_value(name, value)
        for name, value in settings.items()
        if name in TWIN.by_name
    }
