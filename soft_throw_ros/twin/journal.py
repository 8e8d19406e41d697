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
What must be known to repeat a run, and what it gave, as lines of JSON.

An entry is a mapping with `kind`, `line` (its number in the session) and `step`, the step before
which it happened:

============= ================================================================================
kind          further keys
============= ================================================================================
start         `settings`, `versions`, `motions` (of files, by their paths); it begins, at rest
throw         the same, `throw` (its number), `pending` (changes that wait) and `schedule`;
              a throw starts, and if the plate is measured, `onset`: how that was seen
samples       `count` and `data`, see `encode_samples`: taken before this step, or others
input         `input`: 'throw', 'reset', or 'parameters' with their `values` and `motions`
tick_schedule `anchor_step`, `anchor_time_ns`, `rate`: from `step` on, steps are due by this
result        `result`: the values of a `ThrowResult`, where None is infinite; and in the end of
              a throw `states` and `fields` as below, of the steps before from its start on
checksum      `first`, `states`, `fields`: CRC-32 of what the steps from `first` to before `step`
              gave, about a second of them
============= ================================================================================

All but the last two repeat a run; those tell if it is the same. Numbers are written with all their
digits, so that the same line gives the same floats.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
import json
import math
from operator import index
import platform
import struct
from typing import Any
import zlib
from zlib import crc32

import numba
import numpy as np
from soft_throw_ros import __version__
from soft_throw_ros.configuration import motions, ParameterError, Settings, TWIN
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

BATCH_TIME = 0.1  # for which samples are put together in an entry, by the clock [s]
CHECKSUM_TIME = 1.0  # from one checksum to the next, by the clock [s]
STATE = struct.Struct(f'<{len(State._fields)}d')
"""A state as the checksums take it: its numbers in order, 8 bytes each, little endian."""

_TYPES = {'step': int, 'line': int, 'throw': int, 'versions': dict, 'result': dict}
_LONGEST_DATA = 1 << 28  # of an entry, unpacked [byte]
_FARTHEST = 2**62  # of a step, or of a time [ns]
_MOST_AT_ONCE = 4096  # of states that are added to a checksum [byte]
_SAMPLE = np.dtype(
    [('step', '<i8'), ('stamp_ns', '<i8'), *((name, '<f8') for name in Sample._fields[1:])]
)


class JournalError(ValueError):
    """A line is no entry of a journal, or an entry does not fit the session."""


def encode(entry: Entry) -> str:
    """Write an entry as one line."""
    return json.dumps(entry, separators=(',', ':'), allow_nan=False)


def decode(line: str) -> Entry:
    """
    Read one line.

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
    for name, kind in _TYPES.items():
        if name in entry and type(entry[name]) is not kind:
            raise JournalError(f'{name} of an entry is of another type, got {entry[name]!r}')
    if abs(entry['step']) > _FARTHEST:
        raise JournalError(f'a step is at most {_FARTHEST}, got {entry["step"]!r}')
    try:
        motions.remember(entry.get('motions', {}))
    except (AttributeError, ValueError) as error:
        raise JournalError(f'an entry of a journal, {error}: {line!r}') from error
    for part in ('settings', 'pending', 'values'):
        if isinstance(entry.get(part), dict):  # JSON knows no tuples
            entry[part] = {
                name: tuple(value) if isinstance(value, list) else value
                for name, value in entry[part].items()
            }
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


def _motions(*settings: Settings) -> dict[str, dict[str, str]]:
    """Write down the motions of files that settings name; nothing if there are none."""
    found = {path: text for each in settings for path, text in motions.encode(each).items()}
    return {'motions': found} if found else {}


def decode_schedule(values: Entry) -> TickSchedule:
    """Read what `encode_schedule` wrote, alone or among others."""
    try:
        step, time_ns = index(values['anchor_step']), index(values['anchor_time_ns'])
        rate = values['rate']
        is_schedule = max(abs(step), abs(time_ns)) <= _FARTHEST and 1e-3 <= rate <= 1e9
    except (KeyError, TypeError) as error:
        raise JournalError(f'not a schedule of ticks, {error!r}: {values!r}') from error
    if not is_schedule:
        raise JournalError(f'a schedule has times and a rate, got {values!r}')
    return TickSchedule(step=step, time_ns=time_ns, rate=rate)


def encode_schedule(schedule: TickSchedule) -> dict[str, int | float]:
    """Write a schedule down for an entry."""
    return {
        'anchor_step': schedule.step,
        'anchor_time_ns': schedule.time_ns,
        'rate': schedule.rate,
    }


def encode_samples(batches: Sequence[tuple[int, Sequence[Sample]]]) -> Entry:
    """
    Write samples that were taken down for an entry, each batch before a step.

    `data` is, one sample after another, the step, the stamp and the rest of `Sample`, 8 bytes
    each, little endian; deflated, in base 64, which keeps every bit.

    Examples
    --------
    >>> batches = [(7, [Sample(100, 0.5)]), (8, [Sample(200, 0.25), Sample(300, 0.125)])]
    >>> entry = {'kind': 'samples', 'step': 8, **encode_samples(batches)}
    >>> [(step, len(samples)) for step, samples in decode_samples(entry)]
    [(7, 1), (8, 2)]

    """
    rows = np.array([(step, *sample) for step, samples in batches for sample in samples], _SAMPLE)
    data = base64.b64encode(zlib.compress(rows.tobytes(), 1)).decode()
    return {'count': len(rows), 'data': data}


def decode_samples(entry: Entry) -> list[tuple[int, list[Sample]]]:
    """Return the samples that an entry tells, in batches, each before a step."""
    try:
        data = base64.b64decode(entry['data'], validate=True)
        content = zlib.decompressobj().decompress(data, _LONGEST_DATA)
        rows = np.frombuffer(content, _SAMPLE, entry['count'])  # refuses what is too short
    except (KeyError, TypeError, ValueError, zlib.error) as error:
        raise JournalError(f'no samples can be read, {error}: {dict(entry)!r}') from error
    steps = [*rows['step'].tolist(), entry['step']]
    if any(later < earlier for earlier, later in pairwise(steps)):
        raise JournalError(f'samples are before {entry["step"]}, in order, got steps {steps}')
    return [
        (step, [Sample(*row[1:]) for row in group])
        for step, group in groupby(rows.tolist(), key=lambda row: row[0])
    ]


def encode_onset(onset: Onset) -> Entry:
    """Write an onset down for an entry."""
    rest = onset.rest
    return {
        'onset_ns': onset.onset_ns,
        'plate_rest': rest.plate,
        'projectile_rest': None if math.isnan(rest.projectile) else rest.projectile,
        'noise': rest.noise,
        'rest_error': rest.error,
        'trusts_engine': onset.trusts_engine,
        **encode_samples([(0, onset.samples)]),
    }


def decode_onset(values: Entry) -> Onset:
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
            samples=tuple(
                sample for _, batch in decode_samples({**values, 'step': 0}) for sample in batch
            ),
            trusts_engine=bool(values['trusts_engine']),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise JournalError(
            f'a throw of a measured plate has its onset, {error!r}: {values!r}'
        ) from error


@dataclass
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

    """

    def __init__(self, on_line: Callable[[str], None], *, step: int) -> None:
        self._on_line = on_line
        self._line = 0
        self._batches: list[tuple[int, list[Sample]]] = []
        self._last_flush_step = step
        self._states = bytearray()  # that the checksums lack: to add up many at once is quicker
        self._second = _Checksum(step)
        self._throw: _Checksum | None = None

    def write(self, kind: str, step: int, **values: object) -> None:
        """Write an entry."""
        if self._batches:
            self._flush(step)
        self._on_line(encode({'kind': kind, 'line': self._line, 'step': step, **values}))
        self._line += 1

    def begin(self, kind: str, step: int, settings: Settings, **values: Any) -> None:
        """Write that a session or a throw starts, and begin checksums anew."""
        self._write_checksum(step)
        if kind == 'throw':
            self._throw = _Checksum(step)
        wanted = {**settings, **values.get('pending', {})}
        self.write(
            kind, step, settings=dict(settings), versions=dict(VERSIONS), **values,
            **_motions(settings, wanted),
        )

    def write_change(self, step: int, values: Settings) -> None:
        """Write that parameters are changed."""
        self.write('input', step, input='parameters', values=dict(values), **_motions(values))

    def keep_samples(self, step: int, samples: list[Sample]) -> None:
        """Keep samples that were taken, for an entry to come."""
        self._batches.append((step, samples))

    def write_result(self, step: int, result: ThrowResult) -> None:
        """Write what a throw gave."""
        checksums: dict[str, int] = {}
        if result.stage == 'final' and self._throw is not None:
            self._add_states()
            checksums, self._throw = self._throw.values(), None
        values = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in result.values().items()
        }
        self.write('result', step, result=values, **checksums)

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
        if following - self._second.first >= CHECKSUM_TIME * rate:
            self._write_checksum(following)

    def close(self, step: int) -> None:
        """Write what has not been written yet, since there are no more steps."""
        if self._batches:
            self._flush(step)
        self._write_checksum(step)

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

    def _write_checksum(self, step: int) -> None:
        """Write the checksum of the steps before `step`, if there are any, and begin the next."""
        self._add_states()
        if step > self._second.first:
            self.write('checksum', step, first=self._second.first, **self._second.values())
        self._second = _Checksum(step)

    def _flush(self, step: int) -> None:
        """Write down what has been measured since the last time."""
        batches, self._batches = self._batches, []
        self._last_flush_step = step
        self.write('samples', step, **encode_samples(batches))
