# SPDX-License-Identifier: Apache-2.0
"""
What must be known to repeat a run, and what it gave, as lines of JSON.

An entry is a mapping with `kind`, `line` (its number in the session) and `step`, the step before
which it happened:

============= ================================================================================
kind          further keys
============= ================================================================================
start         `settings`, `versions`; a session begins, at rest
throw         the same, `throw` (its number), `pending` (changes that wait) and `schedule`;
              a throw starts, and if the plate is measured, `onset`: how that was seen
samples       `count` and `data`, see `encode_samples`: taken before this step, or others
input         `input`: 'throw', 'reset', or 'parameters' with their `values`
tick_schedule `anchor_step`, `anchor_time_ns`, `rate`: from `step` on, steps are due by this
result        `result`, see `encode_result`, and in the end of a throw `states` and `fields` as
              below, of the steps before from its start on
checksum      `first`, `states`, `fields`: CRC-32 of what the steps from `first` to before `step`
              gave, about a second of them
============= ================================================================================

All but the last two repeat a run; those tell if it is the same. Numbers are written with all their
digits, so that the same line gives the same floats.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
import dataclasses
from itertools import groupby, pairwise
import json
import math
from operator import index, itemgetter
import platform
import struct
from typing import Any
import zlib
from zlib import crc32

import numba
import numpy as np
from soft_throw_ros import __version__
from soft_throw_ros.configuration import ParameterError, Settings, TWIN
from soft_throw_ros.twin.onset import Onset, Rest
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.results import Outputs, State, ThrowResult
from soft_throw_ros.twin.tick_schedule import TickSchedule

Entry = Mapping[str, Any]  # of JSON, whose values are of many types

VERSIONS: Mapping[str, str] = {
    'soft_throw_ros': __version__,
    'python': platform.python_version(),
    'numpy': np.__version__,
    'numba': numba.__version__,
    'machine': platform.machine(),
    'libc': ' '.join(platform.libc_ver()),
}
"""What the digits of a run depend on."""

_TYPES = {'line': int, 'throw': int, 'versions': dict, 'result': dict}
_SETTINGS = {'settings', 'pending', 'values'}  # parts of entries whose series were tuples
_LONGEST_DATA = 1 << 28  # of an entry, unpacked [byte]
_FARTHEST = 2**62  # of a step, or of a time [ns]
_MOST_AT_ONCE = 4096  # of states that are added to a checksum [byte]


BATCH_TIME = 0.1  # for which samples are put together in an entry, by the clock [s]
CHECKSUM_TIME = 1.0  # from one checksum to the next, by the clock [s]
STATE = struct.Struct(f'<{len(State._fields)}d')
"""A state as the checksums take it: its numbers in order, 8 bytes each, little endian."""


class JournalError(ValueError):
    """A line is no entry of a journal, or an entry does not fit the session."""


def encode(entry: Entry) -> str:
    """Write an entry as one line."""
    return json.dumps(entry, separators=(',', ':'), allow_nan=False)


def decode(line: str) -> dict[str, Any]:
    """
    Read one line; what had another name in 0.1 gets that of now.

    Raises
    ------
    JournalError
        Quoting the line, if it is no entry.

    Examples
    --------
    >>> decode('{"kind":"input","step":7,"input":"throw"}')['step']
    7

    """
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise JournalError(f'not a line of a journal, {error}: {line!r}') from error
    if not isinstance(entry, dict) or not {'kind', 'step'} <= entry.keys():
        raise JournalError(f'an entry of a journal has kind and step, got {line!r}')
    if type(entry['step']) is not int or abs(entry['step']) > _FARTHEST:
        raise JournalError(f'a step is a whole number, got {entry["step"]!r}')
    for name, kind in _TYPES.items():
        if name in entry and type(entry[name]) is not kind:
            raise JournalError(f'{name} of an entry is of another type, got {entry[name]!r}')
    for part in _SETTINGS & entry.keys():
        if isinstance(entry[part], dict):
            entry[part] = {
                name: tuple(value) if isinstance(value, list) else value
                for name, value in entry[part].items()
            }
    if entry['kind'] == 'pace':
        entry['kind'] = 'tick_schedule'
    if 'departure' in entry:
        entry['onset'] = entry.pop('departure')
    return entry


def checked_settings(entry: Entry, part: str) -> Settings:
    """Return settings of an entry; JournalError if they are missing, or no such values exist."""
    settings = entry.get(part)
    if not isinstance(settings, Mapping):
        raise JournalError(f'an entry lacks {part}: {dict(entry)!r}')
    try:
        for name, value in settings.items():
            TWIN.check_value(name, value)
    except ParameterError as error:
        raise JournalError(str(error)) from error
    return settings


def entry_schedule(entry: Entry) -> TickSchedule | None:
    """Return when steps are due by an entry of a schedule or a throw; None if it does not tell."""
    values = entry if entry['kind'] == 'tick_schedule' else entry.get('schedule')
    if values is None:
        return None
    try:
        step, time_ns, rate = (values[name] for name in ('anchor_step', 'anchor_time_ns', 'rate'))
    except (KeyError, TypeError) as error:
        raise JournalError(f'a schedule lacks {error}: {dict(entry)!r}') from error
    is_near = all(type(value) is int and abs(value) <= _FARTHEST for value in (step, time_ns))
    if not (is_near and isinstance(rate, (int, float)) and 1e-3 <= rate <= 1e9):
        raise JournalError(f'a schedule has whole numbers and a rate, got {values!r}')
    return TickSchedule(step=step, time_ns=time_ns, rate=rate)


def encode_schedule(schedule: TickSchedule) -> dict[str, int | float]:
    """Write a schedule down for an entry, where `entry_schedule` finds it."""
    return {
        'anchor_step': schedule.step,
        'anchor_time_ns': schedule.time_ns,
        'rate': schedule.rate,
    }


def encode_result(result: ThrowResult) -> dict[str, Any]:
    """
    Return the numbers of a result in full; the rig is in the journal, and None is infinite.

    Nested values have their path as name, as `first.time`.
    """
    values = {name: value for name, value in vars(result).items() if name not in ('rig', 'models')}
    values |= {f'models.{name}': release for name, release in result.models.items()}
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if dataclasses.is_dataclass(value):
            flat |= {f'{name}.{part}': number for part, number in vars(value).items()}
        else:
            flat[name] = value
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in flat.items()
    }


def encode_samples(batches: Sequence[tuple[int, Sequence[Sample]]]) -> dict[str, Any]:
    """
    Write samples that were taken down for an entry, each batch before a step.

    `data` is the columns, one after another, as 8-byte numbers, little endian: step and stamp,
    each less the one before, then the rest of `Sample`; deflated, in base 64, which keeps every
    bit.

    Examples
    --------
    >>> batches = [(7, [Sample(100, 0.5)]), (8, [Sample(200, 0.25), Sample(300, 0.125)])]
    >>> entry = {'kind': 'samples', 'step': 8, **encode_samples(batches)}
    >>> [(step, len(samples)) for step, samples in entry_samples(entry)]
    [(7, 1), (8, 2)]

    """
    steps = [before for before, samples in batches for _ in samples]
    samples = [sample for _, batch in batches for sample in batch]
    stamps = [sample.stamp_ns for sample in samples]
    return {'count': len(samples), 'data': _pack([steps, stamps], samples)}


def entry_samples(entry: Entry) -> list[tuple[int, list[Sample]]]:
    """Return the samples that an entry tells, in batches, each before a step."""
    steps, samples = _unpack(entry, 2)
    last = entry['step']
    if any(later < earlier for earlier, later in pairwise([*steps, last])):
        raise JournalError(f'samples are before {last}, in order, got steps {steps}')
    return [
        (step, [sample for _, sample in group])
        for step, group in groupby(zip(steps, samples, strict=True), key=itemgetter(0))
    ]


def encode_onset(onset: Onset) -> dict[str, Any]:
    """Write an onset down for an entry."""
    stamps = [sample.stamp_ns for sample in onset.samples]
    rest = onset.rest
    return {
        'onset_ns': onset.onset_ns,
        'plate_rest': rest.plate,
        'projectile_rest': None if math.isnan(rest.projectile) else rest.projectile,
        'noise': rest.noise,
        'rest_error': rest.error,
        'trusts_engine': onset.trusts_engine,
        'count': len(stamps),
        'data': _pack([stamps], onset.samples),
    }


def decode_onset(values: Any) -> Onset:  # of JSON
    """Read what `encode_onset` wrote."""
    try:
        projectile = values['projectile_rest']
        return Onset(
            onset_ns=index(values['onset_ns']),
            rest=Rest(
                plate=float(values['plate_rest']),
                projectile=math.nan if projectile is None else float(projectile),
                noise=float(values['noise']),
                error=float(values['rest_error']),
            ),
            samples=tuple(_unpack(values, 1)[1]),
            trusts_engine=bool(values['trusts_engine']),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise JournalError(
            f'a throw of a measured plate has its onset, {error!r}: {values!r}'
        ) from error


def _pack(whole: Sequence[Sequence[int]], samples: Sequence[Sample]) -> str:
    """Write columns of whole numbers, and what samples have besides their stamps."""
    columns = [np.diff(column, prepend=0).astype('<i8').tobytes() for column in whole]
    values = np.array([sample[1:] for sample in samples], '<f8').reshape(
        -1, len(Sample._fields) - 1
    )
    return base64.b64encode(zlib.compress(b''.join(columns) + values.T.tobytes(), 1)).decode()


def _unpack(entry: Entry, whole: int) -> tuple[list[int], list[Sample]]:
    """Read what `_pack` wrote: the first column, and the samples with the last one as stamps."""
    try:
        count, data = entry['count'], base64.b64decode(entry['data'], validate=True)
        content = zlib.decompressobj().decompress(data, _LONGEST_DATA)
        numbers = np.frombuffer(content, '<i8').reshape(whole + len(Sample._fields) - 1, count)
    except (KeyError, TypeError, ValueError, zlib.error) as error:
        raise JournalError(f'no samples can be read, {error}: {dict(entry)!r}') from error
    columns = np.cumsum(numbers[:whole], axis=1).tolist()
    values = numbers[whole:].view('<f8').T.tolist()
    samples = [Sample(stamp, *row) for stamp, row in zip(columns[-1], values, strict=True)]
    return columns[0], samples


@dataclasses.dataclass
class _Checksum:
    """CRC-32 of the states of steps from the `first` on, and of what they tell of the layer."""

    first: int
    states: int = 0
    fields: int = 0

    def values(self) -> dict[str, int]:
        return {'states': self.states, 'fields': self.fields}


class JournalWriter:
    """
    Writes the journal of a session: numbers entries, puts samples together, adds up checksums.

    Checksums begin anew with every throw, so that whoever has the journal from there on can check
    it.

    Parameters
    ----------
    on_line : callable
        Called with every line, in order. It must not call back.
    step : int
        The first step.
    rate : float
        Steps per second of the clock. [Hz]

    """

    def __init__(self, on_line: Callable[[str], None], *, step: int, rate: float) -> None:
        self._on_line = on_line
        self._line = 0
        self._batches: list[tuple[int, list[Sample]]] = []
        self._last_flush_step = step
        self._states = bytearray()  # that the checksums lack: to add up many at once is quicker
        self._second = _Checksum(step)
        self._throw: _Checksum | None = None
        self._end = step + _steps(CHECKSUM_TIME, rate)

    def start(self, step: int, settings: Settings) -> None:
        """Write that the session starts."""
        self._write('start', step, settings=dict(settings), versions=dict(VERSIONS))

    def begin_throw(
        self,
        step: int,
        settings: Settings,
        *,
        throw: int,
        pending: Settings,
        schedule: TickSchedule,
        onset: Onset | None,
    ) -> None:
        """Write that a throw starts, and begin checksums anew."""
        self._write_checksum(step, schedule.rate)
        self._throw = _Checksum(step)
        self._write(
            'throw',
            step,
            throw=throw,
            settings=dict(settings),
            pending=dict(pending),
            schedule=encode_schedule(schedule),
            versions=dict(VERSIONS),
            **({} if onset is None else {'onset': encode_onset(onset)}),
        )

    def input(self, step: int, kind: str, values: Settings | None = None) -> None:
        """Write that an input was taken."""
        self._write(
            'input', step, input=kind, **({} if values is None else {'values': dict(values)})
        )

    def schedule(self, step: int, schedule: TickSchedule) -> None:
        """Write when steps are due from now on."""
        self._write('tick_schedule', step, **encode_schedule(schedule))

    def samples(self, step: int, samples: list[Sample]) -> None:
        """Keep samples that were taken, for an entry to come."""
        self._batches.append((step, samples))

    def result(self, step: int, result: ThrowResult) -> None:
        """Write what a throw gave."""
        checksums: dict[str, int] = {}
        if result.stage == 'final' and self._throw is not None:
            self._add_states()
            checksums, self._throw = self._throw.values(), None
        self._write('result', step, result=encode_result(result), **checksums)

    def end_step(self, outputs: Outputs, *, rate: float, is_measured: bool) -> None:
        """Add what a step gave to the checksums, and write what is due after it."""
        self._states += STATE.pack(*outputs.state)
        if len(self._states) > _MOST_AT_ONCE:
            self._add_states()
        if outputs.layer is not None:
            self._add_fields([array.data for array in outputs.layer])
        if outputs.throw_field is not None:
            self._add_fields([outputs.throw_field.checksum.to_bytes(4, 'little')])
        following = outputs.step + 1
        if is_measured and following - self._last_flush_step > BATCH_TIME * rate:
            self._flush(following)  # even if there are none, which is worth knowing
        if following >= self._end:
            self._write_checksum(following, rate)

    def close(self, step: int, *, rate: float) -> None:
        """Write what has not been written yet, since there are no more steps."""
        if self._batches:
            self._flush(step)
        self._write_checksum(step, rate)

    def _add_states(self) -> None:
        """Go on by the states since the last time."""
        for checksum in filter(None, (self._second, self._throw)):
            checksum.states = crc32(self._states, checksum.states)
        self._states.clear()

    def _add_fields(self, parts: Sequence[memoryview | bytes]) -> None:
        """Go on by what was told of the layer."""
        for checksum in filter(None, (self._second, self._throw)):
            for part in parts:
                checksum.fields = crc32(part, checksum.fields)

    def _write_checksum(self, step: int, rate: float) -> None:
        """Write the checksum of the steps before `step`, if there are any, and begin the next."""
        self._add_states()
        if step > self._second.first:
            self._write('checksum', step, first=self._second.first, **self._second.values())
        self._second = _Checksum(step)
        self._end = step + _steps(CHECKSUM_TIME, rate)

    def _write(self, kind: str, step: int, **values: Any) -> None:
        """Write an entry, whose values are of many types."""
        if self._batches:
            self._flush(step)
        entry = {'kind': kind, 'line': self._line, 'step': step, **values}
        self._on_line(encode(entry))
        self._line += 1

    def _flush(self, step: int) -> None:
        """Write down what has been measured since the last time."""
        batches, self._batches = self._batches, []
        self._last_flush_step = step
        self._write('samples', step, **encode_samples(batches))


def _steps(seconds: float, rate: float) -> int:
    return max(1, round(seconds * rate))
