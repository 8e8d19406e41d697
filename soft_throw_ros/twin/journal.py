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
from collections.abc import Mapping, Sequence
import dataclasses
from itertools import groupby, pairwise
import json
import math
from operator import itemgetter
import platform
from typing import Any
import zlib

import numba
import numpy as np
from soft_throw_ros import __version__
from soft_throw_ros.configuration import ParameterError, Settings, TWIN
from soft_throw_ros.twin.onset import Onset
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.results import ThrowResult
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


class JournalError(ValueError):
    """A line is no entry of a journal, or an entry does not fit the session."""


def encode(entry: Entry) -> str:
    """Write an entry as one line."""
    return json.dumps(entry, separators=(',', ':'), allow_nan=False)


def decode(line: str) -> dict[str, Any]:
    """
    Read one line; what had another name before 0.6 gets that of now.

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
    """
    Return the settings of an entry.

    Raises
    ------
    JournalError
        If they are missing, or the twin has no such values.

    """
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
    """
    Return when steps are due by an entry of a schedule or a throw; None if it does not tell.

    Raises
    ------
    JournalError
        If it tells something that is no schedule.

    """
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
    values = dataclasses.asdict(dataclasses.replace(result, models={}))
    for name, release in result.models.items():
        values[f'models.{name}'] = None if release is None else dataclasses.asdict(release)
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if name in ('rig', 'models'):
            continue
        if isinstance(value, dict):
            flat.update({f'{name}.{part}': number for part, number in value.items()})
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
    """
    Return the samples that an entry tells, in batches, each before a step.

    Raises
    ------
    JournalError
        If it tells none.

    """
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
    rest = onset.projectile_rest
    return {
        'onset_ns': onset.onset_ns,
        'plate_rest': onset.plate_rest,
        'projectile_rest': None if math.isnan(rest) else rest,
        'count': len(stamps),
        'data': _pack([stamps], onset.samples),
    }


def decode_onset(values: object) -> Onset:
    """
    Read what `encode_onset` wrote.

    Raises
    ------
    JournalError
        If it is no onset.

    """
    if not isinstance(values, Mapping):
        raise JournalError(f'a throw of a measured plate has its onset, got {values!r}')
    try:
        onset_ns, plate_rest = values['onset_ns'], values['plate_rest']
        projectile_rest = values['projectile_rest']
    except KeyError as error:
        raise JournalError(f'an onset lacks {error}: {dict(values)!r}') from error
    heights = [plate_rest] if projectile_rest is None else [plate_rest, projectile_rest]
    are_numbers = all(isinstance(height, (int, float)) for height in heights)
    if type(onset_ns) is not int or not are_numbers:
        raise JournalError(f'an onset has a time and heights, got {dict(values)!r}')
    _, samples = _unpack(values, 1)
    return Onset(
        onset_ns=onset_ns,
        plate_rest=float(plate_rest),
        projectile_rest=math.nan if projectile_rest is None else float(projectile_rest),
        samples=tuple(samples),
    )


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
