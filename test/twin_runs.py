# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sessions and measured plates to test the twin with."""

from collections.abc import Callable, Iterable, Sequence
import itertools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import Event, PLATE_POSITION, PROJECTILE_POSITION
from soft_throw_ros.core.throw import make_stepper
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.prepared_rig import prepare
from soft_throw_ros.twin.results import Outputs, Phase, PhaseChange, ThrowResult
from soft_throw_ros.twin.sample_buffer import Samples
from soft_throw_ros.twin.session import Session, TickSchedule

BEGIN = 1_700_000_000 * SECOND
TRANSPORT = 150_000  # of a sample [ns]


class Sample(NamedTuple):
    """Heights measured at one time, NaN if not measured [m]."""

    stamp_ns: int
    plate: float
    projectile: float = math.nan


def samples_of(samples: Sequence[Sample]) -> Samples:
    """Put samples into arrays."""
    stamps = np.array([sample.stamp_ns for sample in samples], np.int64)
    return Samples(stamps, np.array([sample[1:] for sample in samples], float).reshape(-1, 2))


class Run:
    """A session from step 0 at `begin_ns` with settings (`a__b` is a.b), and its outputs."""

    begin_ns = BEGIN
    clock_offset_ns = 0

    def __init__(self, **request: Any) -> None:
        self.now = BEGIN  # time at which the present step is due
        self.journal: list[str] = []
        self.outputs: list[Outputs] = []
        self.settings = complete_settings(**request)
        self.rig = rig_of(self.settings)
        self.session = Session(prepare(self.settings), on_entry=self.journal.append)
        self.schedule = TickSchedule(step=0, time_ns=BEGIN, rate=self.session.rate)
        self.session.set_tick_schedule(self.schedule)
        self._waiting: list[tuple[int, Sample]] = []

    def go(self, steps: int) -> list[Outputs]:
        """Advance by a number of steps and return their outputs."""
        first = len(self.outputs)
        for _ in range(steps):
            self.now = self.schedule.deadline(self.session.step)
            count = sum(arrival <= self.now for arrival, _ in self._waiting)
            samples = samples_of([sample for _, sample in self._waiting[:count]])
            del self._waiting[:count]
            self.session.measure(samples, clock_offset_ns=self.clock_offset_ns)
            self.outputs.append(self.session.advance())
        return self.outputs[first:]

    def go_until(self, phase: Phase, limit: int = 20_000) -> Outputs:
        """Advance to the step that enters a phase."""
        for _ in range(limit):
            (outputs,) = self.go(1)
            if any(change.phase is phase for change in outputs.phases):
                return outputs
        raise AssertionError(f'{phase} has not come in {limit} steps')

    def send(self, samples: Iterable[Sample], delays: Sequence[int] = ()) -> None:
        """Queue samples that arrive with the given delays after their stamps."""
        for sample, delay in itertools.zip_longest(samples, delays, fillvalue=TRANSPORT):
            self._waiting.append((sample.stamp_ns + delay, sample))
        self._waiting.sort(key=lambda item: item[0])

    def receive(self) -> None:
        """Advance until all samples have arrived."""
        while self._waiting:
            self.go(1)

    def measure(
        self, rig: Rig | None = None, change: Callable[..., Iterable[Sample]] = list, **kwargs: Any
    ) -> None:
        """Measure a throw of a rig of its own by changed samples, and go on to their end."""
        kwargs.setdefault('begin_ns', self.schedule.deadline(self.session.step))
        self.send(change(measured_throw(rig or self.rig, **kwargs)))
        self.receive()

    def results(self, stage: str) -> list[ThrowResult]:
        results = (result for outputs in self.outputs for result in outputs.results)
        return [result for result in results if result.stage == stage]

    def events(self) -> list[Event]:
        return [event for outputs in self.outputs for event in outputs.events]

    def phases(self) -> list[Phase]:
        return [change.phase for change in self.phase_changes()]

    def phase_changes(self) -> list[PhaseChange]:
        return [change for outputs in self.outputs for change in outputs.phases]

    def entries(self, kind: str) -> list[dict[str, Any]]:
        entries = map(journal.decode, self.journal)
        return [entry for entry in entries if entry['kind'] == kind]

    def starts(self) -> list[int]:
        """Return the steps at which throws started."""
        return [entry['step'] for entry in self.entries('throw')]

    def assert_repeated(self, throw: int = 0) -> None:
        """Assert that the replay, from the start of a throw, has the same outputs bit by bit."""
        self.session.close()
        entries, written = list(map(journal.decode, self.journal)), list[str]()
        kinds = [(entry['kind'], entry.get('throw')) for entry in entries]
        first = kinds.index(('throw', throw)) if throw else 0
        session = Session.from_entry(entries[first], on_entry=written.append)
        again = [out for entry in entries[first + 1:] for out in session.follow(entry)]
        session.close()
        begin = entries[first]['step']
        assert len(again) == len(self.outputs) - begin
        assert all(map(same, again, self.outputs[begin:]))
        assert throw or written == self.journal


STROKE = [
    (0.0, 0.0, 0.0, 0.0), (0.015, 2e-3, 0.0, 0.0),
    (0.03, 1e-3, -0.125, 0.0), (0.045, 0.0, 0.0, 0.0),
]


def stroke(row: int = 0, **changes: float) -> str:
    """Return the CSV of a stroke from rest to rest, with changes of one of its states."""
    names = ['t', 'z', 'velocity', 'acceleration']
    rows = [dict(zip(names, state, strict=True)) for state in STROKE]
    rows[row] |= changes
    return '\n'.join([','.join(names), *(','.join(map(str, row.values())) for row in rows)])


MEASUREMENT = TwinConfig(settings=TWIN.defaults(), rig=Rig()).measurement
PLATE = MEASUREMENT.plate
INTERVAL = 200_000  # [ns]


def make_samples(
    count: int = 100, *, onset: float = math.inf, noise: float = 0.0, seed: int = 4
) -> list[Sample]:
    """Measure a plate every 0.2 ms, at a height of 0.3 m before it starts, and a projectile."""
    random = np.random.default_rng(seed)
    stamps = BEGIN + INTERVAL * np.arange(count)
    heights = 0.3 + PLATE.position((stamps - BEGIN) / SECOND - onset)
    heights += noise * random.standard_normal(count)
    return list(map(Sample, stamps.tolist(), heights.tolist(), itertools.repeat(0.5)))


def complete_settings(**request: Any) -> dict[str, Any]:
    """Return complete settings, `a__b` for a.b."""
    change = {name.replace('__', '.'): value for name, value in request.items()}
    return {**TWIN.defaults(), **TWIN.change(TWIN.defaults(), change)}


def same(ours: Outputs, theirs: Outputs) -> bool:
    """Compare outputs: numbers by all digits, arrays by bytes, and fields of throws by calls."""
    return _content([*vars(ours).values()]) == _content([*vars(theirs).values()])


def _content(value: Any) -> Any:
    if isinstance(value, (tuple, list)):
        return [_content(part) for part in value]
    if callable(value):
        return _content(value())
    return value.tobytes() if hasattr(value, 'tobytes') else repr(value)


def states_at(rig: Rig, times: Iterable[float]) -> NDArray[np.float64]:
    """Return the states of a throw at increasing times since its start, before which it rests."""
    model, states = make_stepper(rig), []
    for time in times:
        model.advance_to(max(time, 0.0))
        states.append(model.state.copy())
    return np.array(states)


def measured_throw(
    rig: Rig, *, begin_ns: int, onset: float = 0.05, duration: float = 0.12, rate: float = 5000.0,
    noise: float = 0.0, jitter: float = 0.0, seed: int = 0,
) -> list[Sample]:
    """Return the samples of a throw that starts at `onset` [s]; `jitter` is in intervals."""
    random = np.random.default_rng(seed)
    count = round(duration * rate)
    since = (np.arange(count) + jitter * random.uniform(-1.0, 1.0, count)) / rate
    stamps = begin_ns + np.round(since * SECOND).astype(np.int64)
    states = states_at(rig, ((stamps - begin_ns) / SECOND - onset).tolist())
    rows = states[:, [PLATE_POSITION, PROJECTILE_POSITION]]
    rows += [0.3, -0.2]  # readings at height 0 [m]
    rows += noise * random.standard_normal(rows.shape)
    return list(map(Sample, stamps.tolist(), *rows.T.tolist()))
