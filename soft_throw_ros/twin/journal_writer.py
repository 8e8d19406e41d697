# SPDX-License-Identifier: Apache-2.0
"""Writes the journal of a session while it runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import dataclasses
import struct
from typing import Any
from zlib import crc32

from soft_throw_ros.configuration import Settings
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.onset import Onset
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.results import Outputs, State, ThrowResult
from soft_throw_ros.twin.tick_schedule import TickSchedule

BATCH_TIME = 0.1
"""For which samples are put together in an entry, by the clock. [s]"""

CHECKSUM_TIME = 1.0
"""From one checksum to the next, by the clock. [s]"""

STATE = struct.Struct(f'<{len(State._fields)}d')
"""A state as the checksums take it: its numbers in order, 8 bytes each, little endian."""


@dataclasses.dataclass
class Checksum:
    """CRC-32 of the states of consecutive steps, and of whatever they tell of the layer."""

    first: int
    states: int = 0
    fields: int = 0

    def values(self) -> dict[str, int]:
        """Return the two numbers."""
        return {'states': self.states, 'fields': self.fields}


class JournalWriter:
    """
    Numbers the entries, puts samples together, and adds up checksums.

    Parameters
    ----------
    on_line : callable
        Called with every line, in order. It must not call back.
    step : int
        The first step.
    rate : float
        Steps per second of the clock. [Hz]

    Notes
    -----
    A checksum takes a microsecond of every step: it goes on by the 48 bytes of the state, and by
    those of the layer if it is told. It begins anew with every throw, so that whoever has the
    journal from there on can check it.

    """

    def __init__(self, on_line: Callable[[str], None], *, step: int, rate: float) -> None:
        self._on_line = on_line
        self._line = 0
        self._batches: list[tuple[int, list[Sample]]] = []
        self._last_flush_step = step
        self._checksum = Checksum(step)
        self._end = step + _steps(CHECKSUM_TIME, rate)
        self._throw_checksum: Checksum | None = None

    def start(self, step: int, settings: Settings) -> None:
        """Write that the session starts."""
        self._write('start', step, settings=dict(settings), versions=dict(journal.VERSIONS))

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
        self._throw_checksum = Checksum(step)
        self._write(
            'throw',
            step,
            throw=throw,
            settings=dict(settings),
            pending=dict(pending),
            schedule=journal.encode_schedule(schedule),
            versions=dict(journal.VERSIONS),
            **({} if onset is None else {'onset': journal.encode_onset(onset)}),
        )

    def input(self, step: int, kind: str, values: Settings | None = None) -> None:
        """Write that an input was taken."""
        self._write(
            'input', step, input=kind, **({} if values is None else {'values': dict(values)})
        )

    def schedule(self, step: int, schedule: TickSchedule) -> None:
        """Write when steps are due from now on."""
        self._write('tick_schedule', step, **journal.encode_schedule(schedule))

    def samples(self, step: int, samples: list[Sample]) -> None:
        """Keep samples that were taken, for an entry to come."""
        self._batches.append((step, samples))

    def result(self, step: int, result: ThrowResult) -> None:
        """Write what a throw gave."""
        checksums = {}
        if result.stage == 'final' and self._throw_checksum is not None:
            checksums = self._throw_checksum.values()
            self._throw_checksum = None
        self._write('result', step, result=journal.encode_result(result), **checksums)

    def end_step(self, outputs: Outputs, *, rate: float, is_measured: bool) -> None:
        """Add what a step gave to the checksums, and write what is due after it."""
        content = STATE.pack(*outputs.state)
        self._checksum.states = crc32(content, self._checksum.states)
        if self._throw_checksum is not None:
            self._throw_checksum.states = crc32(content, self._throw_checksum.states)
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

    def _add_fields(self, parts: Sequence[memoryview | bytes]) -> None:
        """Go on by what was told of the layer."""
        for part in parts:
            self._checksum.fields = crc32(part, self._checksum.fields)
            if self._throw_checksum is not None:
                self._throw_checksum.fields = crc32(part, self._throw_checksum.fields)

    def _write_checksum(self, step: int, rate: float) -> None:
        """Write the checksum of the steps before `step`, if there are any, and begin the next."""
        checksum = self._checksum
        if step > checksum.first:
            self._write('checksum', step, first=checksum.first, **checksum.values())
        self._checksum = Checksum(step)
        self._end = step + _steps(CHECKSUM_TIME, rate)

    def _write(self, kind: str, step: int, **values: Any) -> None:
        """Write an entry, whose values are of many types."""
        if self._batches:
            self._flush(step)
        entry = {'kind': kind, 'line': self._line, 'step': step, **values}
        self._on_line(journal.encode(entry))
        self._line += 1

    def _flush(self, step: int) -> None:
        """Write down what has been measured since the last time."""
        batches, self._batches = self._batches, []
        self._last_flush_step = step
        self._write('samples', step, **journal.encode_samples(batches))


def _steps(seconds: float, rate: float) -> int:
    return max(1, round(seconds * rate))
