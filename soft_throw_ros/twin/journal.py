# SPDX-License-Identifier: Apache-2.0
"""
What must be known to repeat a run, as lines of JSON.

An entry is a mapping with `kind` and `step`, the step before which it happened:

========== =============================================================================
kind       further keys
========== =============================================================================
start      `settings`, `rig`, `versions`; a session begins, at rest
throw      the same, `throw` (its number) and `pending` (changes that wait); a throw starts,
           and if the plate is measured, `departure`: how that was seen
samples    `first`, `count` and `data`, see `samples_entry`: taken before this step, or others
input      `input`: 'throw', 'reset', or 'parameters' with their `values`
pace       `anchor_step`, `anchor_time_ns`, `rate`: from `step` on, steps are due by this pace
========== =============================================================================

Numbers are written with all their digits, so that the same line gives the same floats.
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
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.twin.measurement import Departure, Sample
from soft_throw_ros.twin.pace import Pace

Entry = Mapping[str, Any]

VERSIONS: Mapping[str, str] = {
    'soft_throw_ros': __version__,
    'python': platform.python_version(),
    'numpy': np.__version__,
    'numba': numba.__version__,
    'machine': platform.machine(),
    'libc': ' '.join(platform.libc_ver()),
}
"""What the digits of a run depend on."""


_SETTINGS = {'settings', 'pending', 'values'}  # parts of entries whose series were tuples
_LONGEST_DATA = 1 << 28  # of an entry, unpacked [byte]


class JournalError(ValueError):
    """A line is no entry of a journal, or an entry does not fit the session."""


def encode(entry: Entry) -> str:
    """Write an entry as one line."""
    return json.dumps(entry, separators=(',', ':'), allow_nan=False)


def decode(line: str) -> dict[str, Any]:
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
    except json.JSONDecodeError as error:
        raise JournalError(f'not a line of a journal, {error}: {line!r}') from error
    if not isinstance(entry, dict) or not {'kind', 'step'} <= entry.keys():
        raise JournalError(f'an entry of a journal has kind and step, got {line!r}')
    for part in _SETTINGS & entry.keys():
        if isinstance(entry[part], dict):
            entry[part] = {
                name: tuple(value) if isinstance(value, list) else value
                for name, value in entry[part].items()
            }
    return entry


def start_entry(step: int, settings: Settings) -> dict[str, Any]:
    """Make the entry for the start of a session."""
    return {'kind': 'start', 'step': step, **_state(settings)}


def throw_entry(
    step: int,
    settings: Settings,
    *,
    throw: int,
    pending: Settings,
    departure: Departure | None = None,
) -> dict[str, Any]:
    """Make the entry for the start of a throw."""
    return {
        'kind': 'throw',
        'step': step,
        'throw': throw,
        **_state(settings),
        'pending': dict(pending),
        **({} if departure is None else {'departure': departure_values(departure)}),
    }


def input_entry(step: int, kind: str, values: Settings | None = None) -> dict[str, Any]:
    """Make the entry for an input that was taken."""
    entry = {'kind': 'input', 'step': step, 'input': kind}
    return entry if values is None else {**entry, 'values': dict(values)}


def samples_entry(
    step: int, batches: Sequence[tuple[int, Sequence[Sample]]], *, first: int
) -> dict[str, Any]:
    """
    Make the entry for samples that were taken, each batch before a step.

    `first` is how many were taken before them, so that it shows if an entry is missing. `data` is
    the columns, one after another, as 8-byte numbers, little endian: step and stamp, each less
    the one before, then the rest of `Sample`; deflated, in base 64, which keeps every bit.

    Examples
    --------
    >>> batches = [(7, [Sample(100, 0.5)]), (8, [Sample(200, 0.25), Sample(300, 0.125)])]
    >>> entry = samples_entry(8, batches, first=0)
    >>> [(step, len(samples)) for step, samples in entry_samples(entry)]
    [(7, 1), (8, 2)]

    """
    steps = [before for before, samples in batches for _ in samples]
    samples = [sample for _, batch in batches for sample in batch]
    return {
        'kind': 'samples',
        'step': step,
        'first': first,
        'count': len(samples),
        'data': _pack([steps, [sample.stamp_ns for sample in samples]], samples),
    }


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


def departure_values(departure: Departure) -> dict[str, Any]:
    """Write a departure down for an entry."""
    stamps = [sample.stamp_ns for sample in departure.samples]
    rest = departure.projectile_rest
    return {
        'onset_ns': departure.onset_ns,
        'plate_rest': departure.plate_rest,
        'projectile_rest': None if math.isnan(rest) else rest,
        'count': len(stamps),
        'data': _pack([stamps], departure.samples),
    }


def values_departure(values: Any) -> Departure:
    """
    Read what `departure_values` wrote.

    Raises
    ------
    JournalError
        If it is no departure.

    """
    if not isinstance(values, Mapping):
        raise JournalError(f'a throw of a measured plate has its departure, got {values!r}')
    try:
        onset_ns, plate_rest = values['onset_ns'], values['plate_rest']
        projectile_rest = values['projectile_rest']
    except KeyError as error:
        raise JournalError(f'a departure lacks {error}: {dict(values)!r}') from error
    heights = [plate_rest] if projectile_rest is None else [plate_rest, projectile_rest]
    are_numbers = all(isinstance(height, (int, float)) for height in heights)
    if type(onset_ns) is not int or not are_numbers:
        raise JournalError(f'a departure has a time and heights, got {dict(values)!r}')
    _, samples = _unpack(values, 1)
    return Departure(
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


def pace_entry(step: int, pace: Pace) -> dict[str, Any]:
    """Make the entry for when steps are due from `step` on."""
    return {
        'kind': 'pace',
        'step': step,
        'anchor_step': pace.step,
        'anchor_time_ns': pace.time_ns,
        'rate': pace.rate,
    }


def entry_pace(entry: Entry) -> Pace:
    """
    Return the pace that an entry tells.

    Raises
    ------
    JournalError
        If it tells none.

    """
    try:
        step, time_ns, rate = entry['anchor_step'], entry['anchor_time_ns'], entry['rate']
    except KeyError as error:
        raise JournalError(f'an entry lacks {error}: {dict(entry)!r}') from error
    whole = isinstance(step, int) and isinstance(time_ns, int)
    if not (whole and isinstance(rate, (int, float)) and 0.0 < rate < math.inf):
        raise JournalError(f'a pace has whole numbers and a rate, got {dict(entry)!r}')
    return Pace(step=step, time_ns=time_ns, rate=rate)


def _state(settings: Settings) -> dict[str, Any]:
    rig = dataclasses.asdict(rig_of(settings))
    return {'settings': dict(settings), 'rig': rig, 'versions': dict(VERSIONS)}
