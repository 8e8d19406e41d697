# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The states of a rig in a session: at rest, in a throw, and returning to rest.

Before `advance` gives the outputs of the present step, `start_next` enters the next state if it is
due. `refusal` returns the reason to refuse a throw, or an empty text, and the step of its end.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import math
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from soft_throw_ros.core.stepper import Event, EventLimitError, Stepper
from soft_throw_ros.core.throw import apex_height, ejections
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.prepared_rig import FIELD_POINTS, layer_of, state_of
from soft_throw_ros.twin.results import (
    INVALID_ENDS,
    LayerState,
    Outputs,
    Phase,
    PhaseChange,
    Release,
    State,
    ThrowField,
    ThrowResult,
)

if TYPE_CHECKING:
    from soft_throw_ros.twin.session import Session

LONGEST_THROW = 10.0
"""Longest duration of a throw, which without gravity would never end. [s]"""

REST_SPEED = 1e-3
"""Largest speed at rest, over the largest speed of the plate. [-]"""

_PHASES = {'release': Phase.FLIGHT, 'recontact': Phase.CONTACT, 'landing': Phase.LANDED}


@dataclass
class AtRest:
    """Plate and projectile are at rest; the next throw starts when it is due or requested."""

    session: Session
    start_step: int | None = None  # of the next throw, whose motion is commanded already

    def start_next(self) -> None:
        """Start the next throw, or put back a rig with pending changes first."""
        session = self.session
        if self.start_step is not None:
            if session.step >= self.start_step:
                session.begin_throw()
        elif session.step >= session.next_start:
            if session.pending:
                session.put_back()
            else:
                session.command_plate()

    def advance(self, outputs: Outputs) -> None:
        """Output the rest, of a measured plate as it is measured."""
        rest, monitor = self.session.prepared.rest, self.session.monitor
        outputs.state = rest if monitor is None else monitor.state(rest)

    def layer(self) -> LayerState:
        """Return the layer at rest."""
        return self.session.prepared.rest_layer

    def refusal(self) -> tuple[str, float]:
        """Refuse another throw if one is about to start."""
        is_about_to_start = self.session.is_requested or self.start_step is not None
        reason = f'throw {self.session.throws + 1} is about to start'
        return reason if is_about_to_start else '', math.inf


@dataclass
class Returning:
    """
    Plate and projectile return to rest between two steps.

    A measured plate returns by itself: it is at rest when its monitor is armed.
    """

    session: Session
    begin: int
    end: int
    origin: State

    def start_next(self) -> None:
        """Start a throw that is due, or else rest."""
        session = self.session
        if session.step >= self.end:
            if session.step >= session.next_start:
                session.command_plate()
            else:
                session.enter(AtRest(session), Phase.REST)

    def advance(self, outputs: Outputs) -> None:
        """
        Output a point of the way to rest with the least jerk [1]_, or that of a measured plate.

        Plate and projectile have covered the same share of their ways at any time, so that they
        do not collide. Forces are zero, because the layer is left out.

        References
        ----------
        .. [1] Flash and Hogan, "The coordination of arm movements", J. Neurosci. 5 (1985) 1688.

        """
        session, origin, goal = self.session, self.origin, self.session.prepared.rest
        if session.monitor is not None:
            outputs.state = session.monitor.state(goal)
            return
        ticks = self.end - self.begin
        time = (session.step - self.begin) / ticks  # over the duration
        share = time**3 * (10.0 - 15.0 * time + 6.0 * time**2)
        speed = 30.0 * (time * (1.0 - time)) ** 2 / (ticks * session.prepared.tick)
        plate, projectile = origin.plate_position, origin.projectile_position
        way, other = goal.plate_position - plate, goal.projectile_position - projectile
        outputs.state = State(
            plate + share * way, projectile + share * other, speed * way, speed * other, 0.0, 0.0
        )

    def layer(self) -> LayerState:
        """Return the layer lying on the plate without force."""
        prepared, state = self.session.prepared, self.session.outputs.state
        rest, gap = prepared.rest, state.projectile_position - state.plate_position
        scale = min(1.0, gap / (rest.projectile_position - rest.plate_position))
        height = prepared.rest_layer.height - rest.plate_position
        return LayerState(
            state.plate_position + scale * height,
            np.full(FIELD_POINTS, state.plate_velocity),
            np.zeros(FIELD_POINTS),
        )

    def refusal(self) -> tuple[str, float]:
        """Refuse a throw until the rig is at rest."""
        return 'resetting the rig', self.end


class OngoingThrow(ABC):
    """
    A state of the rig: a throw from its start to its end, with its events and results.

    A throw ends at rest, or for another reason, see `ThrowResult`. Rest means contact, and speeds
    of plate and projectile below `rest_speed` [m/s] for the longer of their periods.
    """

    def __init__(self, session: Session, *, start_ns: int, rest_speed: float) -> None:
        session.prepared.stepper.reset()
        self.session = session
        self.number = session.throws
        self.start_ns = start_ns  # by the clock of the ticks [ns]
        self.ended_by = ''  # while it goes on
        self.events: list[Event] = []  # so far
        self._prepared = session.prepared
        self._stepper = session.prepared.stepper
        self._rest_speed = rest_speed
        self._last_moving_time = 0.0  # since the start [s]
        self._has_shown_field = False

    def advance(self, outputs: Outputs) -> None:
        """Advance to the present step, and end the throw if it is over."""
        session, was_released = self.session, bool(self.events)
        self._advance(outputs)
        for event in outputs.events:
            outputs.phases.append(PhaseChange(_PHASES[event.kind], self._event_ns(event)))
        if self.events and not was_released:
            session.report(self._result('release'))
        returning = self._prepared.return_ticks(session.config.throw_period)
        if self.ended_by or session.step >= session.next_start - returning:
            self.end(self.ended_by or 'period')
        else:
            outputs.throw_field = self._throw_field()

    def end(self, ended_by: str) -> None:
        """End the throw, and put the rig back."""
        self.ended_by = ended_by
        self.session.report(self._result('final'))
        self.session.outputs.throw_field = self._throw_field()
        self.session.put_back()

    def layer(self) -> LayerState:
        """Return the present state of the layer."""
        return layer_of(self._stepper)

    def refusal(self) -> tuple[str, float]:
        """Refuse another throw."""
        return f'throw {self.number} is under way', self.session.due

    @abstractmethod
    def _advance(self, outputs: Outputs) -> None:
        """Advance to the present step; end the throw by `ended_by`."""

    @abstractmethod
    def _throw_field(self) -> Callable[[], ThrowField] | None:
        """Return the layer over time once, when it is known for long enough or the throw ends."""

    @abstractmethod
    def _event_ns(self, event: Event) -> int:
        """Return the time of an event, by the clock of the ticks [ns]."""

    @abstractmethod
    def _peak_plate_speed(self, release: Event | None) -> float:
        """Return the largest speed of the plate, until the first release if it is known [m/s]."""

    def _go_to(self, time: float) -> tuple[State, list[Event]]:
        """Advance to a time after the start; return the state and the new events."""
        stepper, seen = self._stepper, len(self.events)
        count = self._try_to_advance(stepper, time)
        state = state_of(stepper)
        if max(abs(state.plate_velocity), abs(state.projectile_velocity)) > self._rest_speed:
            self._last_moving_time = time
        if count > seen:
            self.events = stepper.events()
            contacts = sum(event.kind != 'release' for event in self.events)
            if contacts >= self.session.config.max_events:
                self.ended_by = 'max_events'
        if time > LONGEST_THROW:
            self.ended_by = 'duration'
        elif time - self._last_moving_time > self._prepared.settling_time and stepper.in_contact:
            self.ended_by = 'rest'
        return state, self.events[seen:]

    def _try_to_advance(self, stepper: Stepper, time: float) -> int:
        """Advance a stepper to a time; return its number of events, 0 if that is too large."""
        try:
            return stepper.advance_to(time)
        except EventLimitError:
            self.ended_by = 'max_events'
            return 0

    def _result(self, stage: str, fork: Stepper | None = None) -> ThrowResult:
        """Return the result so far, or by a fork; an invalid throw has no events."""
        stepper, events = fork or self._stepper, fork.events()[:1] if fork else self.events
        rig, loads = self._prepared.rig, stepper.loads
        peak_speed = self._peak_plate_speed(events[0] if events else None)
        if self.ended_by in INVALID_ENDS:
            events = []
        ejected = ejections(events)
        releases = [
            Release(
                ejection_time=event.time,
                ejection_speed=event.velocity,
                energy_transfer=(event.velocity / peak_speed) ** 2,
                release_ns=self._event_ns(event),
            )
            for event in ejected
        ]
        kinds = [event.kind for event in events]
        rest_height = self._prepared.rest.projectile_position
        return ThrowResult(
            throw=self.number,
            step=self.session.step,
            stage=stage,
            ended_by=self.ended_by,
            start_ns=self.start_ns,
            rig=rig,
            first=releases[0] if releases else None,
            last=releases[-1] if releases else None,
            peak_plate_speed=peak_speed,
            peak_strain=loads.strain,
            max_strain=self.session.config.rig.layer.linear_range,
            peak_acceleration=loads.acceleration,
            peak_plate_force=loads.plate_force,
            plate_work=stepper.plate_work,
            apex_height=apex_height(ejected[-1], rig.gravity) if ejected else rest_height,
            recontacts=kinds.count('recontact'),
            landings=kinds.count('landing'),
        )


class ScheduledThrow(OngoingThrow):
    """A throw by the period or on request, see `OngoingThrow`."""

    def __init__(self, session: Session) -> None:
        rest_speed = REST_SPEED * session.prepared.peak_plate_speed
        super().__init__(session, start_ns=session.due_ns(session.step), rest_speed=rest_speed)
        self._start_step = session.step
        self._time = 0.0  # since the start [s]
        self._stamps: dict[Event, int] = {}  # of events, by the clock of the ticks [ns]

    def _advance(self, outputs: Outputs) -> None:
        self._time = (outputs.step - self._start_step) * self._prepared.tick
        outputs.state, outputs.events = self._go_to(self._time)

    def _event_ns(self, event: Event) -> int:
        # relative to the step, because steps may be skipped
        since = (self._time - event.time) / self._prepared.config.time_scale
        due_ns = self.session.due_ns(self.session.step)
        return self._stamps.setdefault(event, due_ns - round(since * SECOND))

    def _peak_plate_speed(self, release: Event | None) -> float:  # noqa: ARG002
        return self._prepared.peak_plate_speed

    def _throw_field(self) -> Callable[[], ThrowField] | None:
        field = self._prepared.throw_field
        if self._has_shown_field or field is None:
            return None
        if self._time < field.times[-1] and not self.ended_by:
            return None
        self._has_shown_field = True
        return partial(field._replace, start_ns=self.start_ns)


RigState: TypeAlias = AtRest | OngoingThrow | Returning
