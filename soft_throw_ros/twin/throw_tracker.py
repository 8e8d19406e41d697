# SPDX-License-Identifier: Apache-2.0
"""What every throw under way has in common: its events, its end, and what it gave."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from soft_throw_ros.core.stepper import Event, EventLimitError, Stepper
from soft_throw_ros.core.throw import apex_height, ejections
from soft_throw_ros.twin.prepared_rig import PreparedRig
from soft_throw_ros.twin.results import Prediction, Release, Residual, State, ThrowResult

LONGEST_THROW = 10.0
"""After this a throw is over in any case: without gravity nothing comes down. [s]"""

REST_SPEED = 1e-3
"""What is slower than this part of the plate's largest speed is at rest. [-]"""


class ThrowStep(NamedTuple):
    """
    What one step of a throw gives.

    Attributes
    ----------
    state : State
        At the step.
    events : tuple of Event
        What has happened, or become certain, since the last step.
    forecast : ThrowResult or None
        With a measured plate, in the step in which the first release has become known.
    prediction : Prediction or None
        With a measured plate, the projectile as far ahead as it is known.
    residual : Residual or None
        At the last sample of the projectile that could be compared.

    """

    state: State
    events: tuple[Event, ...]
    forecast: ThrowResult | None = None
    prediction: Prediction | None = None
    residual: Residual | None = None


class ThrowTracker:
    """
    Follows a stepper through a throw, until that is over.

    Parameters
    ----------
    prepared : PreparedRig
        What throws; its stepper is reset.
    number : int
        Of the throw.
    rest_speed : float, optional
        Below which things are at rest, if not by `REST_SPEED`. [m/s]

    Attributes
    ----------
    ended_by : str
        Why the throw is over, see `ThrowResult`; empty while it goes on.
    peak_plate_speed : float
        :math:`V_p^*`, that of the engine unless it is set. [m/s]
    time : float
        How far it has come. [s]

    Notes
    -----
    At rest means: in contact, and both plate and projectile below `REST_SPEED` for as long as the
    slower of the two takes to swing once.

    """

    def __init__(
        self, prepared: PreparedRig, *, number: int, rest_speed: float | None = None
    ) -> None:
        prepared.stepper.reset()
        self.prepared = prepared
        self.number = number
        self.ended_by = ''
        self.peak_plate_speed = prepared.peak_plate_speed
        self.time = 0.0
        self._stepper = prepared.stepper
        self._events: list[Event] = []
        self._last_moving_time = 0.0
        self._rest_speed = (
            REST_SPEED * prepared.peak_plate_speed if rest_speed is None else rest_speed
        )
        rig = prepared.rig
        self._settling_time = 1.0 / min(rig.engine.frequency, rig.natural_frequency)

    @property
    def first_release(self) -> Event | None:
        """The first release, if the projectile has left."""
        return self._events[0] if self._events else None

    @property
    def has_met_again(self) -> bool:
        """Whether layer and projectile have met again since the first release."""
        return len(self._events) > 1

    def advance(self, time: float, *, max_events: int) -> tuple[State, tuple[Event, ...]]:
        """Go on to `time` after the start; return the state, and what happened on the way."""
        self.time = time
        stepper, seen = self._stepper, len(self._events)
        try:
            count = stepper.advance_to(time)
        except EventLimitError:
            count = seen
            self.ended_by = 'max_events'
        state = State._make(stepper.state.tolist()[1:])
        if max(abs(state.plate_velocity), abs(state.projectile_velocity)) > self._rest_speed:
            self._last_moving_time = time
        if count > seen:
            self._events = stepper.events()
            if sum(event.kind != 'release' for event in self._events) >= max_events:
                self.ended_by = 'max_events'
        if time > LONGEST_THROW:
            self.ended_by = 'duration'
        elif time - self._last_moving_time > self._settling_time and stepper.in_contact:
            self.ended_by = 'rest'
        return state, tuple(self._events[seen:]) if count > seen else ()

    def result(self, stage: str, step: int, max_strain: float) -> ThrowResult:
        """Sum up what there is so far."""
        return self._result(stage, step, max_strain, self._stepper, self._events)

    def forecast(self, step: int, max_strain: float, fork: Stepper) -> ThrowResult:
        """Sum up the first release as a stepper has it that has gone ahead."""
        return self._result('predicted', step, max_strain, fork, fork.events()[:1])

    def _result(
        self,
        stage: str,
        step: int,
        max_strain: float,
        stepper: Stepper,
        events: Sequence[Event],
    ) -> ThrowResult:
        prepared, loads = self.prepared, stepper.loads
        found = ejections(events)
        kinds = [event.kind for event in events]
        rest_height = prepared.rest.projectile_position
        return ThrowResult(
            throw=self.number,
            step=step,
            stage=stage,
            ended_by=self.ended_by,
            rig=prepared.rig,
            first=self._release(found[0]) if found else None,
            last=self._release(found[-1]) if found else None,
            peak_plate_speed=self.peak_plate_speed,
            peak_strain=loads.strain,
            max_strain=max_strain,
            peak_acceleration=loads.acceleration,
            peak_force=loads.plate_force,
            plate_work=stepper.plate_work,
            apex_height=apex_height(found[-1], prepared.rig.gravity) if found else rest_height,
            recontacts=kinds.count('recontact'),
            landings=kinds.count('landing'),
            models=prepared.models,
        )

    def _release(self, event: Event) -> Release:
        return Release.of(
            time=event.time, speed=event.velocity, peak_plate_speed=self.peak_plate_speed
        )
