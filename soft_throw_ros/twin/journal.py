# SPDX-License-Identifier: Apache-2.0
"""
What must be known to repeat a run, as lines of JSON.

An entry is a mapping with `kind` and `step`, the step before which it happened:

========== =============================================================================
kind       further keys
========== =============================================================================
start      `settings`, `rig`, `versions`; a session begins, at rest
throw      the same, `throw` (its number) and `pending` (changes that wait); a throw starts
input      `input`: 'throw', 'reset', or 'parameters' with their `values`
pace       `anchor_step`, `anchor_time_ns`, `rate`: from `step` on, steps are due by this pace
========== =============================================================================

Numbers are written with all their digits, so that the same line gives the same floats.
"""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import json
import math
import platform
from typing import Any

import numba
import numpy as np
from soft_throw_ros import __version__
from soft_throw_ros.configuration import rig_of, Settings
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
    return entry


def start_entry(step: int, settings: Settings) -> dict[str, Any]:
    """Make the entry for the start of a session."""
    return {'kind': 'start', 'step': step, **_state(settings)}


def throw_entry(step: int, settings: Settings, *, throw: int, pending: Settings) -> dict[str, Any]:
    """Make the entry for the start of a throw."""
    return {
        'kind': 'throw',
        'step': step,
        'throw': throw,
        **_state(settings),
        'pending': dict(pending),
    }


def input_entry(step: int, kind: str, values: Settings | None = None) -> dict[str, Any]:
    """Make the entry for an input that was taken."""
    entry = {'kind': 'input', 'step': step, 'input': kind}
    return entry if values is None else {**entry, 'values': dict(values)}


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
