# SPDX-License-Identifier: Apache-2.0
"""
The twin without ROS: what happens at which step.

A step is a tick of `rate.state`, and steps are all the time there is: whoever drives a session
(a node by the clock, a replay as fast as it can) asks for one after the other and gets the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
import math
from threading import Lock
from typing import Any

import numpy as np
from soft_throw_ros.configuration import Settings, TWIN
from soft_throw_ros.twin import journal
from soft_throw_ros.twin.flight import Flight, time_until_over
from soft_throw_ros.twin.pace import Pace
from soft_throw_ros.twin.plan import FIELD_POINTS, Plan
from soft_throw_ros.twin.results import (
    Event,
    Field,
    Outputs,
    Phase,
    State,
    ThrowField,
    ThrowResult,
)


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
        self._flight: Flight | None = None
        self._start = step  # what the period and the time of a throw are counted from
        self._scheduled = math.inf
        self._asked = math.inf
        self._path = _Path(begin=step, end=step, origin=self._state, goal=self._state)
        self._field_start = step
        self._field_row = -1
        self._phases = [Phase.REST]
        self._results: list[ThrowResult] = []
        self._throw_field: ThrowField | None = None
        self._pace_entry: journal.Entry | None = None
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
            If one is under way, saying how long that takes.

        """
        with self._lock:
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

    # steps

    def keep_pace(self, pace: Pace) -> None:
        """
        Write down when steps are due from the next one on.

        It changes nothing here. It is in the journal, and again before every throw, so that
        whoever has some of the messages can tell by their stamps which steps they are of.
        """
        with self._lock:
            self._pace_entry = journal.pace_entry(self.step, pace)
            self._write(self._pace_entry)

    def advance(self) -> Outputs:
        """Go one step on."""
        with self._lock:
            step = self.step
            events: tuple[Event, ...] = ()
            has_returned = self._phase is Phase.RETURNING and step >= self._path.end
            if self._phase is Phase.REST or has_returned:
                self._begin_if_due(step, has_returned=has_returned)
            if self._flight is not None:
                events = self._fly(step, self._flight)
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
            )
            self._phases.clear()
            self._results.clear()
            self._throw_field = None
            self.step = step + 1
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

    def _begin_throw(self, step: int) -> None:
        self.throws += 1
        self._asked = math.inf
        self._start = step
        self._field_start, self._field_row = step, -1
        self._schedule()
        if self._pace_entry is not None:
            self._write({**self._pace_entry, 'step': step})
        self._write(
            journal.throw_entry(step, self._settings, throw=self.throws, pending=self.pending)
        )
        self._flight = Flight(self._plan, self._plan.stepper, number=self.throws)
        self._enter(Phase.CONTACT)

    def _fly(self, step: int, flight: Flight) -> tuple[Event, ...]:
        """Advance the throw under way, and end it when it is over."""
        had_left = flight.has_left
        self._state, events = flight.advance(
            (step - self._start) * self._plan.tick, max_events=self._settings['throw.max_events']
        )
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
        return events

    def _end_throw(self, step: int, flight: Flight, ended_by: str) -> None:
        flight.ended_by = ended_by
        self._results.append(flight.result('final', step, self._settings['max_strain']))
        self._throw_field = flight.field()
        self._flight = None
        self._put_back(step)

    def _put_back(self, step: int) -> None:
        """Begin the way back to rest, with whatever has waited in effect."""
        if self._wanted_plan is not self._plan:
            passed = (step - self._start) * self._plan.tick
            self._plan = self._wanted_plan
            self._settings = self._wanted
            self._start = step - round(passed / self._plan.tick)
            self._schedule()
        ticks = self._plan.return_ticks(self._settings['throw.period'])
        self._path = _Path(begin=step, end=step + ticks, origin=self._state, goal=self._plan.rest)
        self._field_start, self._field_row = step, -1
        self._enter(Phase.RETURNING)

    def _schedule(self) -> None:
        """Find when the next throw is due by the period."""
        period = self._settings['throw.period']
        self._scheduled = self._start + self._plan.period_ticks(period) if period else math.inf

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
            self._plan.stepper.read_field(field.strain, field.velocity)
        return field

    def _enter(self, phase: Phase) -> None:
        self._phase = phase
        self._phases.append(phase)

    def _write(self, entry: journal.Entry) -> None:
        self._on_entry(journal.encode(entry))


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
    session = None
    for entry in entries:
        if entry['kind'] == 'throw' and throw in (0, entry['throw']):
            break
        if entry['kind'] == 'start' and throw == 0:
            break
    else:
        raise journal.JournalError(f'the journal has no start of throw {throw}')
    session = Session.from_entry(entry)
    for entry in entries:
        if entry['kind'] == 'start' or entry['step'] >= until:
            break
        if entry['kind'] == 'input':
            while session.step < entry['step']:
                yield session.advance()
            session.take(entry)
    while session.step < until:
        yield session.advance()


def _waits(name: str) -> bool:
    """Tell whether a change of a setting waits until things are put back."""
    entry = TWIN.by_name[name]
    return entry.is_of_rig or entry.group in ('rate', 'time_scale')
