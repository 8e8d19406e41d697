# SPDX-License-Identifier: Apache-2.0
"""One throw under way: what it has given so far, and when it is over."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math

from soft_throw_ros.core.stepping import (
    EventLimitError,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    ThrowStepper,
)
from soft_throw_ros.twin.plan import make_stepper, Plan
from soft_throw_ros.twin.results import (
    Event,
    Field,
    Release,
    State,
    ThrowField,
    ThrowResult,
)

LONGEST = 10.0
"""After this a throw is over in any case: without gravity nothing comes down. [s]"""

QUIET = 1e-3
"""What is slower than this part of the plate's largest speed is at rest. [-]"""


class Flight:
    """
    A throw, from its start until it is over.

    Parameters
    ----------
    plan : Plan
        What throws.
    stepper : ThrowStepper
        Of that plan's rig; it is reset.
    number : int
        Of the throw.
    quiet_speed : float, optional
        Below which things are at rest, if not by `QUIET`. [m/s]

    Attributes
    ----------
    ended_by : str
        Why it is over: 'rest', 'max_events' or 'duration'; empty while it goes on.
    peak_plate_speed : float
        :math:`V_p^*`, that of the plan unless it is set. [m/s]

    Notes
    -----
    At rest means: in contact, and both plate and projectile below `QUIET` for as long as the
    slower of the two takes to swing once.

    """

    def __init__(
        self,
        plan: Plan,
        stepper: ThrowStepper,
        *,
        number: int = 0,
        quiet_speed: float | None = None,
    ) -> None:
        stepper.reset()
        self.plan = plan
        self.number = number
        self.ended_by = ''
        self.peak_plate_speed = plan.peak_plate_speed
        self._stepper = stepper
        self._events: list[Event] = []
        self._time = 0.0
        self._has_shown_field = False
        self._restless = 0.0  # when plate or projectile was last too fast to be at rest
        self._quiet_speed = QUIET * plan.peak_plate_speed if quiet_speed is None else quiet_speed
        rig = plan.rig
        self._quiet_time = 1.0 / min(rig.engine.frequency, rig.natural_frequency)

    @property
    def has_left(self) -> bool:
        """Whether the projectile has left at least once."""
        return bool(self._events)

    @property
    def first_release(self) -> Event | None:
        """When the projectile has left first, if it has."""
        return self._events[0] if self._events else None

    @property
    def has_landed(self) -> bool:
        """Whether the projectile has come down at least once."""
        return len(self._events) > 1

    def advance(self, time: float, *, max_events: int) -> tuple[State, tuple[Event, ...]]:
        """Go on to `time` after the start; return the state, and what happened on the way."""
        self._time = time
        seen = len(self._events)
        try:
            count = self._stepper.advance_to(time)
        except EventLimitError:
            count = seen
            self.ended_by = 'max_events'
        state = State._make(self._stepper.state.tolist()[1:])
        if max(abs(state.plate_velocity), abs(state.projectile_velocity)) > self._quiet_speed:
            self._restless = time
        if count > seen:
            self._events = _events(self._stepper)
            if self._landings >= max_events:
                self.ended_by = 'max_events'
        if time > LONGEST:
            self.ended_by = 'duration'
        elif time - self._restless > self._quiet_time and self._stepper.in_contact:
            self.ended_by = 'rest'
        return state, tuple(self._events[seen:])

    @property
    def _landings(self) -> int:
        return sum(event.kind == 'landing' for event in self._events)

    def result(self, stage: str, step: int, max_strain: float) -> ThrowResult:
        """Sum up what there is so far; before the throw is over, loads are those up to release."""
        return self._result(stage, step, max_strain, self._stepper, self._events)

    def forecast(self, step: int, max_strain: float, scout: ThrowStepper) -> ThrowResult:
        """Sum up the first release as a stepper has it that has gone ahead."""
        return self._result('predicted', step, max_strain, scout, _events(scout)[:1])

    def _result(
        self,
        stage: str,
        step: int,
        max_strain: float,
        stepper: ThrowStepper,
        events: Sequence[Event],
    ) -> ThrowResult:
        plan = self.plan
        peaks = stepper.peaks if stage == 'final' else stepper.first_peaks
        ejections = self._ejections(events)
        return ThrowResult(
            throw=self.number,
            step=step,
            stage=stage,
            ended_by=self.ended_by,
            rig=plan.rig,
            first=ejections[0] if ejections else None,
            last=ejections[-1] if ejections else None,
            peak_plate_speed=self.peak_plate_speed,
            peak_strain=max(
                plan.peak_strain if ejections else 0.0, peaks.plate_strain, peaks.contact_strain
            ),
            max_strain=max_strain,
            peak_acceleration=peaks.acceleration,
            peak_force=peaks.plate_force,
            plate_work=stepper.peak_work,
            apex_height=self._apex_height(stepper),
            recontacts=max(len(ejections) - 1, 0),
            landings=self._landings,
            models=plan.models,
        )

    def _ejections(self, events: Iterable[Event]) -> list[Release]:
        """Return the releases before the projectile falls back on the layer."""
        found = []
        for event in events:
            if event.kind == 'release':
                found.append(
                    Release.of(
                        time=event.time,
                        speed=event.velocity,
                        peak_plate_speed=self.peak_plate_speed,
                    )
                )
            elif event.velocity <= 0.0 and self.plan.rig.gravity > 0.0:
                break
        return found

    def _apex_height(self, stepper: ThrowStepper) -> float:
        """Return the highest point of the projectile, the rest of its way up included."""
        gravity = self.plan.rig.gravity
        highest = stepper.highest_position
        position, speed = stepper.state[PROJECTILE_POSITION], stepper.state[PROJECTILE_VELOCITY]
        if stepper.in_contact or speed <= 0.0:
            return highest
        return max(highest, float(position + 0.5 * speed**2 / gravity)) if gravity else math.inf

    def read_field(self, field: Field) -> None:
        """Write what the layer does now."""
        self._stepper.read_field(field.strain, field.velocity)

    def field(self) -> ThrowField | None:
        """Return the layer over time, once, when that time has passed or the throw is over."""
        field = self.plan.throw_field
        if (
            field is None
            or self._has_shown_field
            or (self._time < field.times[-1] and not self.ended_by)
        ):
            return None
        self._has_shown_field = True
        return field


def _events(stepper: ThrowStepper) -> list[Event]:
    return [Event._make(event) for event in stepper.events()]


def time_until_over(plan: Plan, elapsed: float, *, max_events: int) -> float:
    """
    Find how much longer a throw takes that has gone on for `elapsed`, by throwing once more.

    At most `LONGEST`, and exact to a millisecond or a tick. [s]
    """
    flight = Flight(plan, make_stepper(plan.rig, plan.model))
    tick = max(plan.tick, 1e-3)
    ticks = 0
    while not flight.ended_by:
        ticks += 1
        flight.advance(ticks * tick, max_events=max_events)
    return max(ticks * tick - elapsed, 0.0)
