# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The journal of a run as lines of JSON: its inputs, so that it can be repeated, and its results.

An entry is a mapping with `kind`, `line` (its number in the session) and `step`, the step before
which it happened:

============= ================================================================================
kind          further keys
============= ================================================================================
start         `settings`, `versions`, `motions` (of files, by their paths); it begins, at rest
throw         the same, `throw` (its number), `pending` (changes that wait) and `schedule`, the
              fields of a `TickSchedule`, by which steps are due; a throw starts, and if the plate
              is measured, `onset`: how that was seen
samples       those taken before this step, or others, see `encode_samples`
input         `input`: 'throw', 'reset', or 'parameters' with their `values` and `motions`
tick_schedule `schedule`: from `step` on, steps are due by this
result        `result`: the values of a `ThrowResult`, where None is infinite
checksum      `first`, `states`, `fields`: CRC-32 of the output of the steps from `first` to before
              `step`, for at most 0.1 s, and from the start of a throw on
============= ================================================================================

All but the last two repeat a run; the last two show whether it is the same. Numbers have all
their digits. Bags have checksums; decoding an entry of another program may raise any error.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
import json
import math
import platform
import struct
from typing import Any
import zlib
from zlib import crc32

import numba
import numpy as np
from soft_throw_ros import __version__
from soft_throw_ros.configuration import motions, Settings, TWIN
from soft_throw_ros.configuration.table import quote
from soft_throw_ros.twin.results import Outputs, State, ThrowResult
from soft_throw_ros.twin.sample_buffer import Onset, RestBaseline, Samples

Entry = Mapping[str, Any]  # of JSON, whose values are of many types

VERSIONS: Mapping[str, str] = {
    'soft_throw_ros': __version__,
    'python': platform.python_version(),
    'numpy': np.__version__,
    'numba': numba.__version__,
    'machine': platform.machine(),
    'libc': ' '.join(platform.libc_ver()),
}
"""Versions of the software that determine the last digits of a run."""

BATCH_TIME = 0.1
"""Time of the clock from one checksum and entry of samples to the next. [s]"""

STATE = struct.Struct(f'<{len(State._fields)}d')
"""Binary form of a state for checksums: its numbers in order, 8 bytes each, little endian."""

_encode = json.JSONEncoder(separators=(',', ':'), allow_nan=False).encode

_TYPES = {'kind': str, 'line': int, 'step': int, 'throw': int, 'versions': dict, 'result': dict}


class JournalError(ValueError):
    """An invalid line of a journal, or an entry that does not fit the session."""


def decode(line: str) -> Entry:
    """Parse one line; JournalError, which quotes the line, if it is no entry."""
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise JournalError(f'no line of a journal can be read, {error}: {quote(line)}') from error
    if not isinstance(entry, dict) or not {'kind', 'step'} <= entry.keys() or any(
        type(entry.get(name, kind())) is not kind for name, kind in _TYPES.items()
    ):
        raise JournalError(f'an entry of a journal has kind and step, got {quote(line)}')
    return entry


def checked(values: Settings) -> Settings:
    """Return settings of an entry, or raise ParameterError if one is refused."""
    return {name: TWIN.check_value(name, value) for name, value in values.items()}


def motion_source(entry: Entry) -> motions.MotionSource:
    """Return a source of the motions in an entry, KeyError for others; it opens no file."""
    return lambda path: motions.decode(entry.get('motions', {})[path])


def encode_samples(
    steps: Sequence[int], stamps: bytes | bytearray, heights: bytes | bytearray
) -> Entry:
    """
    Encode samples for an entry: the step that followed each, and the bytes of both arrays.

    Both texts are in base 64, of numbers of 8 bytes, little endian: `times` has the steps of all
    samples and then their stamps, as differences from the last one, compressed by zlib; `heights`
    has those of plate and projectile, whose noise cannot be compressed.
    """
    times = np.array((steps, np.frombuffer(stamps, '<i8')), '<i8')
    times[:, 1:] -= times[:, :-1]
    return {
        'count': len(steps),
        'times': base64.b64encode(zlib.compress(times.tobytes(), 1)).decode(),
        'heights': base64.b64encode(heights).decode(),
    }


def decode_samples(entry: Entry) -> list[tuple[int, Samples]]:
    """Decode the samples of an entry, in batches with the step that followed each."""
    times = np.frombuffer(zlib.decompress(base64.b64decode(entry['times'])), '<i8')
    steps, stamps = times.reshape(2, entry['count']).cumsum(axis=1)
    heights = np.frombuffer(base64.b64decode(entry['heights']), '<f8').reshape(-1, 2)
    return [
        (int(steps[batch[0]]), Samples(stamps[batch], heights[batch]))
        for batch in np.split(np.arange(steps.size), np.flatnonzero(np.diff(steps)) + 1)
        if batch.size
    ]


def encode_onset(onset: Onset) -> Entry:
    """Encode an onset for an entry."""
    samples = onset.samples
    return {
        'onset_ns': onset.onset_ns,
        'rest': [None if math.isnan(value) else value for value in onset.rest],
        'clock_offset_ns': onset.clock_offset_ns,
        **encode_samples([0] * len(samples), samples.stamps.tobytes(), samples.heights.tobytes()),
    }


def decode_onset(values: Entry) -> Onset:
    """Decode an onset."""
    rest = [math.nan if value is None else value for value in values['rest']]
    return Onset(
        onset_ns=values['onset_ns'],
        rest=RestBaseline(*rest),
        samples=decode_samples(values)[0][1],
        clock_offset_ns=values['clock_offset_ns'],
    )


class JournalWriter:
    """
    A writer of the journal of a session: numbered entries, batches of samples, and checksums.

    A checksum begins with every throw, so that a journal can be checked from any throw on. The
    writer calls `on_line` with every line, in order, which must not call the writer.
    """

    def __init__(self, on_line: Callable[[str], None], *, step: int) -> None:
        self._on_line = on_line
        self._line = 0
        # of stored samples, in rows because hundreds of small arrays are slow to encode
        self._steps, self._stamps, self._heights = list[int](), bytearray(), bytearray()
        self._conditions: Entry = {}  # of the last throw
        self._encoded = ''
        self._begin_checksum(step)

    def write(self, kind: str, step: int, encoded: str = '', /, **values: object) -> None:
        """Write an entry, whose last values may be `encoded` already."""
        if self._steps:
            self._flush(step)
        line = _encode({'kind': kind, 'line': self._line, 'step': step, **values})
        self._on_line(f'{line[:-1]}{encoded}}}')
        self._line += 1

    def begin(
        self, kind: str, step: int, settings: Settings, motions: Mapping[str, str], **values: Any
    ) -> None:
        """Write the start of a session or a throw, and begin a checksum."""
        self._write_checksum(step)
        conditions = {'settings': dict(settings), 'motions': motions, 'versions': VERSIONS}
        if conditions != self._conditions:
            self._conditions, self._encoded = conditions, f',{_encode(conditions)[1:-1]}'
        self.write(kind, step, self._encoded, **values)

    def keep_samples(self, step: int, samples: Samples) -> None:
        """Store accepted samples for a later entry."""
        self._steps += [step] * len(samples)
        self._stamps += samples.stamps.tobytes()
        self._heights += samples.heights.tobytes()

    def write_result(self, step: int, result: ThrowResult) -> None:
        """Write the result of a throw."""
        values = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in result.values().items()
        }
        self.write('result', step, result=values)

    def end_step(self, outputs: Outputs, *, rate: float, is_measured: bool) -> None:
        """Add the outputs of a step to the checksum, and write the entries that are due."""
        checksum = self._checksum
        checksum['states'] = crc32(STATE.pack(*outputs.state), checksum['states'])
        for array in outputs.layer or ():
            checksum['fields'] = crc32(array.data, checksum['fields'])
        following = outputs.step + 1
        if following - checksum['first'] >= BATCH_TIME * rate:
            if is_measured:
                self._flush(following)  # also without samples, as a sign of life
            self._write_checksum(following)

    def close(self, step: int) -> None:
        """Write the remaining entries after the last step."""
        if self._steps:
            self._flush(step)
        self._write_checksum(step)

    def _write_checksum(self, step: int) -> None:
        """Write the checksum of the steps before `step`, if any, and begin the next."""
        if step > self._checksum['first']:
            self.write('checksum', step, **self._checksum)
        self._begin_checksum(step)

    def _begin_checksum(self, step: int) -> None:
        """Begin the checksum of states and fields from a step on."""
        self._checksum = {'first': step, 'states': 0, 'fields': 0}

    def _flush(self, step: int) -> None:
        """Write the stored samples."""
        entry = encode_samples(self._steps, self._stamps, self._heights)
        self._steps, self._stamps, self._heights = [], bytearray(), bytearray()
        self.write('samples', step, **entry)
