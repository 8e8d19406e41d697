# SPDX-License-Identifier: Apache-2.0
"""
The twin without ROS: what happens at which step.

A step is a tick of `rate.state`, and steps are all the time there is: whoever drives a session
(a node by the clock, a replay as fast as it can) asks for one after the other and gets the same.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
import math
from threading import Lock
from typing import Any

import numpy as np
from soft_throw_ros.configuration import Settings, TWIN
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.flight import Flight, time_until_over
from soft_throw_ros.twin.measurement import Departure, Nodes, Sample, Track, Watch
from soft_throw_ros.twin.pace import Pace
from soft_throw_ros.twin.plan import FIELD_POINTS, Plan
from soft_throw_ros.twin.pursuit import Pursuit
from soft_throw_ros.twin.results import (
    Event,
    Field,
    Outputs,
    Phase,
    Prediction,
    Residual,
    State,
    ThrowField,
    ThrowResult,
)

BATCH_TIME = 0.1
"""For which samples are put together in an entry of the journal, by the clock. [s]"""


class Refused(Exception):
    """What was asked for cannot be done now; the message says why, and for how long."""


class Session:
    """
    A rig, its schedule of throws, and what is changed and asked for meanwhile.

    Parameters
    ----------
    settings : mapping of str to value
        Complete settings to start with.
    step : int
        Number of the first step.
    on_entry : callable
        Called with every line of the journal, in order. It must not call back.

    Attributes
    ----------
    step : int
        Number of the next step.
    throws : int
        How many throws have started.
    taken, disordered : int
        How many samples of the rig were taken, and of these after later ones.
    refused : Counter of str
        How many were refused, by reason, see `measurement.Track`.

    Raises
    ------
    ValueError
        If the rig cannot be stepped in real time, with the number.

    Notes
    -----
    A throw starts when it is due by `throw.period`, counted from the last start, or when asked
    for. It is over when the projectile is at rest, after `throw.max_events` landings, when the
    period leaves just the time to put things back, or after `flight.LONGEST`. Then plate and
    projectile are put back along a minimum-jerk path [1]_: positions are continuous, and the two
    do not run into each other, since both go the same part of their way at a time. The layer is
    left out meanwhile: forces and strain are zero.

    Changes of the rig, of rates and of the time scale wait, and take effect together whenever
    things are put back: after a throw, at a reset, or, if the rig is at rest, before the next
    throw, which starts so much later. Every other change is effective at once.

    If the plate is measured, a throw starts when that jumps up after a rest, whatever the period,
    and is over, besides, when nothing is known of the plate for longer than a wave needs to cross
    the layer, or when it jumps again. What was pending then takes effect with the throw. In
    between plate and projectile are where the plate was measured last.

    Inputs may come from another thread than steps are asked for from. An input is taken between
    two steps, and has the number of the second one in the journal.

    References
    ----------
    .. [1] Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985) 1688.

    """

    def __init__(
        self,
        settings: Settings,
        *,
        step: int = 0,
        on_entry: Callable[[str], None] = lambda _line: None,
    ) -> None:
        self.step = step
        self.throws = 0
        self._on_entry = on_entry
        self._lock = Lock()  # held for microseconds
        self._changing = Lock()  # held while a plan is made, for milliseconds
        self._settings = settings  # in effect
        self._plan = Plan.of(settings)
        self._wanted = settings  # in effect once things have been put back
        self._wanted_plan = self._plan
        self._phase = Phase.REST
        self._state = self._plan.rest
        self._flight: Flight | Pursuit | None = None
        self._start = step  # what the period and the time of a throw are counted from
        self._scheduled = math.inf
        self._asked = math.inf
        self._path = _Path(begin=step, end=step, origin=self._state, goal=self._state)
        self._field_start = step
        self._field_row = -1
        self._phases = [Phase.REST]
        self._results: list[ThrowResult] = []
        self._throw_field: ThrowField | None = None
        self._pace = Pace(step=step, time_ns=0, rate=self._plan.rate)
        self._pace_entry: journal.Entry | None = None
        self.taken = self.disordered = 0
        self.refused: Counter[str] = Counter()
        self._batches: list[tuple[int, list[Sample]]] = []  # that are not in the journal yet
        self._written = 0  # samples
        self._told = step  # when they were written last
        self._track: Track | None = None  # of a measured plate
        self._watch: Watch | None = None
        self._departure: Departure | None = None  # which is to begin a throw
        self._plate = _Plate()
        self._notices: list[str] = []
        self._attend()
        self._schedule()
        self._write(journal.start_entry(step, settings))

    @classmethod
    def from_entry(
        cls, entry: journal.Entry, *, on_entry: Callable[[str], None] = lambda _line: None
    ) -> Session:
        """
        Continue from the start of a session or of a throw, as the journal has it.

        The next step is the entry's own. It gives what it gave then, to the last bit, and so do
        all that follow if they get the same inputs (see `take`).

        Raises
        ------
        JournalError
            If the entry is no such start, or lacks something.
        ValueError
            If the rig cannot be stepped in real time.

        """
        try:
            if entry['kind'] == 'start':
                return cls(entry['settings'], step=entry['step'], on_entry=on_entry)
            if entry['kind'] != 'throw':
                raise journal.JournalError(
                    f'a session starts with an entry start or throw, got {entry["kind"]!r}'
                )
            session = cls(entry['settings'], step=entry['step'])
            session._on_entry = on_entry
            session.throws = entry['throw'] - 1
            session._asked = session.step
            session._phase = Phase.RETURNING  # until this very step, so that nothing delays it
            session._phases.clear()
            if session._plan.tuning is not None:
                session._departure = journal.values_departure(entry.get('departure'))
            session._wanted = {**entry['settings'], **entry['pending']}
            if entry['pending']:
                session._wanted_plan = Plan.of(session._wanted)
        except KeyError as error:
            raise journal.JournalError(f'an entry lacks {error}: {dict(entry)!r}') from error
        return session

    @property
    def rate(self) -> float:
        """Steps per second of the clock, now. [Hz]"""
        return self._plan.rate

    @property
    def time_scale(self) -> float:
        """Time of the rig over time of the clock, now. [-]"""
        return self._plan.time_scale

    @property
    def pending(self) -> dict[str, Any]:
        """The changes that wait, by name."""
        settings, wanted = self._settings, self._wanted
        return {
            name: value
            for name, value in wanted.items()
            if _waits(name) and value != settings[name]
        }

    # inputs

    def ask_throw(self) -> None:
        """
        Have a throw start with the next step, or after putting back if changes wait.

        Raises
        ------
        Refused
            If one is under way, saying how long that takes, or the plate is measured.

        """
        with self._lock:
            if self._track is not None:
                raise Refused('the plate is measured: a throw starts when it jumps up')
            if self._phase is Phase.REST:
                if self._asked < math.inf:
                    raise Refused(f'throw {self.throws + 1} is about to start')
                self._write(journal.input_entry(self.step, 'throw'))
                self._asked = self.step
                return
            plan, flight, path = self._plan, self._flight, self._path
            elapsed = self.step - self._start
            longest = self._scheduled - self.step
            max_events = self._settings['throw.max_events']
            period = self._settings['throw.period']
        if flight is None:
            seconds = max(path.end - self.step, 0) / plan.rate
            raise Refused(f'the rig is being put back: ready in {seconds:.2f} s')
        left = time_until_over(plan, elapsed * plan.tick, max_events=max_events)
        seconds = min(left / plan.tick + plan.return_ticks(period), longest) / plan.rate
        raise Refused(f'throw {flight.number} is under way: ready in {seconds:.2f} s')

    def reset(self) -> None:
        """Break off a throw under way, put things back, and count the period from here."""
        with self._lock:
            self._write(journal.input_entry(self.step, 'reset'))
            if self._flight is not None:
                self._end_throw(self.step, self._flight, 'reset')
            else:
                self._put_back(self.step)
            self._asked = math.inf
            self._start = self.step
            self._schedule()

    def change(self, values: Settings) -> None:
        """
        Change settings.

        Parameters
        ----------
        values : mapping of str to value
            What is to change; values are taken as they are.

        Raises
        ------
        ValueError
            If the rig could not be stepped in real time; then nothing has changed.

        """
        with self._changing:
            wanted = {**self._wanted, **values}
            plan = None
            if any(_waits(name) and wanted[name] != self._wanted[name] for name in values):
                plan = Plan.of(wanted)
            with self._lock:
                self._write(journal.input_entry(self.step, 'parameters', values))
                self._wanted = wanted
                self._settings = {
                    name: self._settings[name] if _waits(name) else value
                    for name, value in wanted.items()
                }
                if not self.pending:
                    self._wanted_plan = self._plan
                elif plan is not None:
                    self._wanted_plan = plan
                if 'throw.period' in values:
                    self._schedule()

    @property
    def is_measured(self) -> bool:
        """Whether samples of the rig are taken."""
        return self._track is not None

    @property
    def is_at_rest(self) -> bool:
        """Whether a measured plate is at rest, so that a throw starts when it jumps up."""
        return self._watch is not None and self._watch.is_armed

    def measure(self, samples: Sequence[Sample]) -> None:
        """Take samples of the rig, if the plate is measured, or refuse and count them."""
        with self._lock:
            if self._track is None:
                return
            newest_ns = self._track.newest_ns
            taken = self._track.take(samples, self._pace.deadline(self.step))
            if not taken:
                return
            self._batches.append((self.step, taken))
            self.taken += len(taken)
            for sample in taken:
                self.disordered += sample.stamp_ns < newest_ns
                newest_ns = max(newest_ns, sample.stamp_ns)

    def take(self, entry: journal.Entry) -> None:
        """
        Take an input from a journal.

        Raises
        ------
        JournalError
            If it is none, or belongs before another step than the next one.
        Refused
            If it cannot be taken, so that this is not the session that the journal is of.

        """
        if entry['kind'] != 'input' or entry['step'] != self.step:
            raise journal.JournalError(
                f'before step {self.step} an input of that step can be taken, got {dict(entry)!r}'
            )
        if entry['input'] == 'throw':
            self.ask_throw()
        elif entry['input'] == 'reset':
            self.reset()
        elif entry['input'] == 'parameters':
            self.change(entry['values'])
        else:
            raise journal.JournalError(f'no input is named {entry["input"]!r}')

    def follow(self, entry: journal.Entry) -> Iterator[Outputs]:
        """
        Take whatever an entry of a journal tells, after the steps that come before that.

        Yields
        ------
        Outputs
            One for each step.

        Raises
        ------
        JournalError, Refused
            As `take`.

        """
        if entry['kind'] == 'samples':
            for step, samples in journal.entry_samples(entry):
                yield from self._advance_to(step)
                self.measure(samples)
            return
        yield from self._advance_to(entry['step'])
        if entry['kind'] == 'pace':
            self.keep_pace(journal.entry_pace(entry))
        elif entry['kind'] == 'input':
            self.take(entry)

    def _advance_to(self, step: int) -> Iterator[Outputs]:
        while self.step < step:
            yield self.advance()

    # steps

    def keep_pace(self, pace: Pace) -> None:
        """
        Write down when steps are due from the next one on.

        It matters for samples of the rig, which have stamps. It is in the journal, and again
        before every throw, so that whoever has some of the messages can tell by their stamps
        which steps they are of.
        """
        with self._lock:
            self._pace = Pace(step=pace.step, time_ns=pace.time_ns, rate=pace.rate)
            self._pace_entry = journal.pace_entry(self.step, pace)
            self._write(self._pace_entry)

    def close(self) -> None:
        """Write down what is not in the journal yet, since there are no more steps."""
        with self._lock:
            if self._batches:
                self._write_samples()

    def advance(self) -> Outputs:
        """Go one step on."""
        with self._lock:
            step = self.step
            events: tuple[Event, ...] = ()
            prediction = residual = nodes = None
            if self._track is not None:
                nodes = self._attend_to(step, self._track)
            else:
                has_returned = self._phase is Phase.RETURNING and step >= self._path.end
                if self._phase is Phase.REST or has_returned:
                    self._begin_if_due(step, has_returned=has_returned)
            flight = self._flight
            if isinstance(flight, Flight):
                events = self._fly(step, flight)
            elif flight is not None and nodes is not None:
                events, prediction, residual = self._pursue(step, flight, nodes)
            elif self._track is not None:
                self._state = self._plate.state(self._plan.rest)
            elif self._phase is Phase.RETURNING:
                self._state = self._path.state(step, tick=self._plan.tick)
            else:
                self._state = self._plan.rest
            outputs = Outputs(
                step=step,
                throw=self.throws,
                state=self._state,
                phases=tuple(self._phases),
                events=events,
                results=tuple(self._results),
                field=self._field(step),
                throw_field=self._throw_field,
                prediction=prediction,
                residual=residual,
                notices=tuple(self._notices),
            )
            self._phases.clear()
            self._results.clear()
            self._notices.clear()
            self._throw_field = None
            self.step = step + 1
            if self._track is not None and step - self._told >= BATCH_TIME * self._plan.rate:
                self._write_samples()  # even if there are none, which is worth knowing
            return outputs

    def _begin_if_due(self, step: int, *, has_returned: bool) -> None:
        """From rest, start a throw, or put things back before it if changes wait."""
        if step < min(self._asked, self._scheduled):
            if has_returned:
                self._enter(Phase.REST)
        elif has_returned or self._wanted_plan is self._plan:
            self._begin_throw(step)
        else:
            self._put_back(step)

    def _begin_throw(self, step: int, departure: Departure | None = None) -> None:
        self.throws += 1
        self._asked = math.inf
        self._start = step
        self._field_start, self._field_row = step, -1
        self._schedule()
        if self._pace_entry is not None:
            self._write({**self._pace_entry, 'step': step})
        self._write(
            journal.throw_entry(
                step,
                self._settings,
                throw=self.throws,
                pending=self.pending,
                departure=departure,
            )
        )
        if departure is None:
            self._flight = Flight(self._plan, self._plan.stepper, number=self.throws)
        else:
            self._attend(departure)
            assert self._track is not None
            self._flight = Pursuit(self._plan, departure, self._track, number=self.throws)
        self._enter(Phase.CONTACT)

    def _fly(self, step: int, flight: Flight) -> tuple[Event, ...]:
        """Advance the throw under way, and end it when it is over."""
        had_left = flight.has_left
        self._state, events = flight.advance(
            (step - self._start) * self._plan.tick, max_events=self._settings['throw.max_events']
        )
        self._account_for(step, flight, events, had_left=had_left)
        return events

    def _account_for(
        self, step: int, flight: Flight | Pursuit, events: Sequence[Event], *, had_left: bool
    ) -> None:
        """Tell what a step of a throw gave, and end it when it is over."""
        for event in events:
            self._enter(Phase.FLIGHT if event.kind == 'release' else Phase.LANDED)
        if flight.has_left and not had_left:
            self._results.append(flight.result('release', step, self._settings['max_strain']))
        returning = self._plan.return_ticks(self._settings['throw.period'])
        ended_by = flight.ended_by or ('period' if step >= self._scheduled - returning else '')
        if ended_by:
            self._end_throw(step, flight, ended_by)
        else:
            self._throw_field = flight.field()

    # with a measured plate

    def _attend(self, departure: Departure | None = None) -> None:
        """Begin to watch for the next jump of the plate, if it is measured."""
        tuning, track = self._plan.tuning, self._track
        if tuning is None:
            self._track = self._watch = None
            self._plate = _Plate()
            return
        self._asked = math.inf
        if departure is not None:
            self._plate = _Plate(departure.plate_rest)
            self._track = Track(
                tuning,
                origin_ns=departure.onset_ns,
                samples=departure.samples,
                refused=self.refused,
            )
        elif track is None or track.tuning != tuning:
            self._track = Track(tuning, refused=self.refused)
        assert self._track is not None
        self._watch = Watch(self._track)

    def _attend_to(self, step: int, track: Track) -> Nodes | None:
        """See how the plate moves, and start a throw when it jumps up."""
        watch = self._watch
        assert watch is not None
        departure, self._departure = self._departure, None
        nodes = None
        if departure is None:
            nodes = track.advance(self._pace.deadline(step))
            self._plate.see(nodes, start_speed=track.tuning.start_speed)
            departure = watch.see(nodes)
            if departure is not None and not self._is_fast_enough(track):
                departure = None
        if departure is not None:
            if self._flight is not None:
                self._end_throw(step, self._flight, 'next')
            if self._wanted_plan is not self._plan:
                self._take_over(step)
            if self._plan.tuning is not None:
                self._begin_throw(step, departure)
                nodes = self._look_back(step)
            elif self._phase is not Phase.RETURNING:  # from now on it is not measured
                self._put_back(step)
        elif self._phase is Phase.RETURNING and watch.is_armed:
            self._enter(Phase.REST)
            self._is_fast_enough(track)
        return nodes

    def _look_back(self, step: int) -> Nodes:
        """Return how the plate has moved since the start of a throw."""
        assert self._track is not None
        assert self._watch is not None
        nodes = self._track.advance(self._pace.deadline(step))
        self._watch.see(nodes)
        self._plate.see(nodes, start_speed=self._track.tuning.start_speed)
        return nodes

    def _is_fast_enough(self, track: Track) -> bool:
        """Tell whether there are enough samples, and if not, say so."""
        rate = track.rate()
        least, reason = track.tuning.least_rate(self._plan.rig.crossing_time)
        if rate >= least:
            return True
        self._notices.append(
            f'the plate is measured at {rate:.0f} Hz, which must be at least {least:.0f} Hz, '
            f'{reason}: no throw is followed'
        )
        return False

    def _pursue(
        self, step: int, flight: Pursuit, nodes: Nodes
    ) -> tuple[tuple[Event, ...], Prediction, Residual | None]:
        """Advance the throw of a measured plate that is under way."""
        had_left = flight.has_left
        max_strain = self._settings['max_strain']
        advanced = flight.advance(
            nodes,
            step=step,
            now_ns=self._pace.deadline(step),
            max_events=self._settings['throw.max_events'],
            max_strain=max_strain,
        )
        self._state = advanced.state
        if advanced.forecast is not None:
            self._results.append(advanced.forecast)
        self._account_for(step, flight, advanced.events, had_left=had_left)
        return advanced.events, advanced.prediction, advanced.residual

    def _end_throw(self, step: int, flight: Flight | Pursuit, ended_by: str) -> None:
        flight.ended_by = ended_by
        self._results.append(flight.result('final', step, self._settings['max_strain']))
        self._throw_field = flight.field()
        self._flight = None
        self._put_back(step)

    def _put_back(self, step: int) -> None:
        """Begin the way back to rest, with whatever has waited in effect."""
        if self._wanted_plan is not self._plan:
            self._take_over(step)
        if self._plan.tuning is None:
            ticks = self._plan.return_ticks(self._settings['throw.period'])
            self._path = _Path(
                begin=step, end=step + ticks, origin=self._state, goal=self._plan.rest
            )
        self._attend()
        self._field_start, self._field_row = step, -1
        self._enter(Phase.RETURNING)

    def _take_over(self, step: int) -> None:
        """Put in effect what has waited."""
        passed = (step - self._start) * self._plan.tick
        self._plan = self._wanted_plan
        self._settings = self._wanted
        self._start = step - round(passed / self._plan.tick)
        self._schedule()

    def _schedule(self) -> None:
        """Find when the next throw is due by the period."""
        period = self._settings['throw.period']
        is_due = period and self._plan.tuning is None
        self._scheduled = self._start + self._plan.period_ticks(period) if is_due else math.inf

    def _field(self, step: int) -> Field | None:
        """Return the layer, if `rate.field` has it due."""
        row = int((step - self._field_start) * self._plan.field_rate // self._plan.rate)
        if row == self._field_row:
            return None
        self._field_row = row
        if self._phase is Phase.REST:
            return self._plan.rest_field
        field = Field(np.zeros(FIELD_POINTS), np.zeros(FIELD_POINTS))
        if self._flight is not None:
            self._flight.read_field(field)
        return field

    def _enter(self, phase: Phase) -> None:
        self._phase = phase
        self._phases.append(phase)

    def _write(self, entry: journal.Entry) -> None:
        if self._batches:
            self._write_samples()
        self._on_entry(journal.encode(entry))

    def _write_samples(self) -> None:
        """Write down what has been measured since the last time."""
        entry = journal.samples_entry(self.step, self._batches, first=self._written)
        self._written += entry['count']
        self._told = self.step
        self._batches = []
        self._on_entry(journal.encode(entry))


class _Plate:
    """Where a measured plate was seen last, above where it was at rest."""

    def __init__(self, rest: float = math.nan) -> None:
        self._rest = self._height = self._carried = rest
        self._speed = self._carried_speed = 0.0

    def see(self, nodes: Nodes, *, start_speed: float) -> None:
        """Take in how the plate moves, which carries the projectile if that is slow."""
        if not nodes.times.size:
            return
        self._height, self._speed, _ = nodes.states[-1].tolist()
        if math.isnan(self._rest):
            self._rest = self._carried = self._height
        self._carried_speed = 0.0
        if abs(self._speed) < start_speed:
            self._carried, self._carried_speed = self._height, self._speed

    def state(self, rest: State) -> State:
        """Return the state of the plate, and of the projectile, which lies on the layer."""
        if math.isnan(self._rest):
            return rest
        return rest._replace(
            plate_position=rest.plate_position + self._height - self._rest,
            projectile_position=rest.projectile_position + self._carried - self._rest,
            plate_velocity=self._speed,
            projectile_velocity=self._carried_speed,
        )


@dataclass(frozen=True, kw_only=True)
class _Path:
    """The way back to rest: from standing still to standing still with the least jerk."""

    begin: int
    end: int
    origin: State
    goal: State

    def state(self, step: int, *, tick: float) -> State:
        ticks = self.end - self.begin
        part = (step - self.begin) / ticks
        mixture = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
        speed = 30.0 * (part * (1.0 - part)) ** 2 / (ticks * tick)
        plate = self.goal.plate_position - self.origin.plate_position
        projectile = self.goal.projectile_position - self.origin.projectile_position
        return State(
            plate_position=self.origin.plate_position + mixture * plate,
            projectile_position=self.origin.projectile_position + mixture * projectile,
            plate_velocity=speed * plate,
            projectile_velocity=speed * projectile,
            plate_force=0.0,
            projectile_force=0.0,
        )


def replay(lines: Iterable[str], *, until: int, throw: int = 0) -> Iterator[Outputs]:
    """
    Repeat what a journal is of.

    Parameters
    ----------
    lines : iterable of str
        The journal, or its end.
    until : int
        The first step that is not asked for.
    throw : int
        Number of the throw to begin with; 0 for the first entry that can be begun with.

    Yields
    ------
    Outputs
        One for each step.

    Raises
    ------
    JournalError
        If there is no such throw, or the journal does not fit itself.
    Refused
        If an input that was taken then is refused now.

    """
    entries = map(journal.decode, lines)
    pace = None
    for entry in entries:
        if entry['kind'] == 'throw' and throw in (0, entry['throw']):
            break
        if entry['kind'] == 'start' and throw == 0:
            break
        if entry['kind'] == 'pace':
            pace = entry
    else:
        raise journal.JournalError(f'the journal has no start of throw {throw}')
    session = Session.from_entry(entry)
    if pace is not None:
        session.keep_pace(journal.entry_pace(pace))
    for entry in entries:
        if entry['kind'] == 'start' or session.step >= until:
            break
        if entry['kind'] == 'samples' or entry['step'] < until:
            yield from takewhile(lambda outputs: outputs.step < until, session.follow(entry))
    yield from session._advance_to(until)


def _waits(name: str) -> bool:
    """Tell whether a change of a setting waits until things are put back."""
    entry = TWIN.by_name[name]
    return entry.is_of_rig or entry.group in ('rate', 'time_scale', 'measured')
