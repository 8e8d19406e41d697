# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Throws under way: what all have in common, and the one whose plate moves as the engine says."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
import dataclasses
from typing import NamedTuple

import numpy as np
from soft_throw_ros.configuration.twin_config import TwinConfig
from soft_throw_ros.core.stepper import Event, EventLimitError, Stepper
from soft_throw_ros.core.throw import apex_height, ejections
from soft_throw_ros.twin.plate_estimator import PlateStates
from soft_throw_ros.twin.prepared_rig import FIELD_POINTS, PreparedRig, stepper_of
from soft_throw_ros.twin.results import (
    Accuracy,
    Comparison,
    LayerState,
    PredictedState,
    Release,
    Residual,
    State,
    ThrowField,
    ThrowResult,
)

LONGEST_THROW = 10.0  # is over in any case: without gravity nothing comes down [s]
REST_SPEED = 1e-3  # what is slower than this part of the plate's largest speed is at rest [-]


class ThrowStep(NamedTuple):
    """What one step of a throw gives; all but the first two only with a measured plate."""

    state: State
    events: tuple[Event, ...]  # which have happened, or become certain, since the last step
    forecast: ThrowResult | None = None  # when the first release has become known
    prediction: PredictedState | None = None
    residual: Residual | None = None  # at the last sample that could be compared


class OngoingThrow(ABC):
    """
    A throw, from its start until it is over: its events, its end, and what it gave.

    It ends at rest, besides other reasons, see `ThrowResult`: in contact, and both plate and
    projectile below `rest_speed` for as long as the slower of the two takes to swing once.

    Parameters
    ----------
    prepared : PreparedRig
        What throws; its stepper is reset.
    number : int
        Of the throw.
    start_ns : int
        When it starts, by the clock of the ticks. [ns]
    rest_speed : float
        Below which things are at rest. [m/s]

    """

    def __init__(
        self, prepared: PreparedRig, *, number: int, start_ns: int, rest_speed: float
    ) -> None:
        prepared.stepper.reset()
        self.number = number
        self.ended_by = ''  # while it goes on
        self.events: list[Event] = []  # so far
        self.engine_holds = True  # whether the plate has done so far as the engine should
        self._prepared = prepared
        self._stepper = self._shown = prepared.stepper
        self._start_ns = start_ns
        self._peak_plate_speed = prepared.peak_plate_speed
        self._has_shown_field = False
        self._last_moving_time = 0.0
        self._rest_speed = rest_speed
        rig = prepared.rig
        self._settling_time = 1.0 / min(rig.engine.frequency, rig.natural_frequency)

    @property
    def first_release(self) -> Event | None:
        """Return the first release, if the projectile has left."""
        return self.events[0] if self.events else None

    @property
    def layer(self) -> LayerState:
        """Return what the layer does now."""
        rows = np.empty((3, FIELD_POINTS))
        self._shown.read_layer(rows)
        return LayerState(*rows)

    @abstractmethod
    def advance(
        self, step: int, now_ns: int, motion: PlateStates, config: TwinConfig
    ) -> ThrowStep:
        """Go on to a step, which is due now, with how a measured plate has moved until then."""

    @abstractmethod
    def throw_field(self) -> ThrowField | None:
        """Return the layer over time, once, when it is known for long enough or no more."""

    def result(self, stage: str, step: int, config: TwinConfig) -> ThrowResult:
        """Sum up what there is so far."""
        return self._sum_up(stage, step, config, self._stepper, self.events)

    def _go_to(self, time: float, max_events: int) -> tuple[State, tuple[Event, ...]]:
        """Go on to `time` after the start; return the state, and what happened on the way."""
        stepper, seen = self._stepper, len(self.events)
        try:
            count = stepper.advance_to(time)
        except EventLimitError:
            count = seen
            self.ended_by = 'max_events'
        state = State._make(stepper.state.tolist()[1:])
        if max(abs(state.plate_velocity), abs(state.projectile_velocity)) > self._rest_speed:
            self._last_moving_time = time
        if count > seen:
            self.events = stepper.events()
            if sum(event.kind != 'release' for event in self.events) >= max_events:
                self.ended_by = 'max_events'
        if time > LONGEST_THROW:
            self.ended_by = 'duration'
        elif time - self._last_moving_time > self._settling_time and stepper.in_contact:
            self.ended_by = 'rest'
        return state, tuple(self.events[seen:]) if count > seen else ()

    def _sum_up(
        self,
        stage: str,
        step: int,
        config: TwinConfig,
        stepper: Stepper,
        events: Sequence[Event],
        *,
        lead: float | None = None,
        accuracy: Accuracy | None = None,
        comparison: Comparison | None = None,
    ) -> ThrowResult:
        prepared, loads = self._prepared, stepper.loads
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
            peak_plate_speed=self._peak_plate_speed,
            peak_strain=loads.strain,
            max_strain=config.max_strain,
            peak_acceleration=loads.acceleration,
            peak_force=loads.plate_force,
            plate_work=stepper.plate_work,
            apex_height=apex_height(found[-1], prepared.rig.gravity) if found else rest_height,
            recontacts=kinds.count('recontact'),
            landings=kinds.count('landing'),
            lead=lead,
            accuracy=accuracy,
            comparison=comparison,
        )

    def _release(self, event: Event) -> Release:
        return Release(
            ejection_time=event.time,
            ejection_speed=event.velocity,
            energy_transfer=(event.velocity / self._peak_plate_speed) ** 2,
        )


class ScheduledThrow(OngoingThrow):
    """A throw by the schedule or on request, see `OngoingThrow`."""

    def __init__(
        self, prepared: PreparedRig, *, number: int, start_step: int = 0, start_ns: int = 0
    ) -> None:
        super().__init__(
            prepared,
            number=number,
            start_ns=start_ns,
            rest_speed=REST_SPEED * prepared.peak_plate_speed,
        )
        self._start_step = start_step
        self._time = 0.0

    def advance(
        self,
        step: int,
        now_ns: int,  # noqa: ARG002  this and the motion are for measured plates
        motion: PlateStates,  # noqa: ARG002
        config: TwinConfig,
    ) -> ThrowStep:
        """Go on to a step."""
        self._time = (step - self._start_step) * self._prepared.tick
        return ThrowStep(*self._go_to(self._time, config.max_events))

    def throw_field(self) -> ThrowField | None:
        """Return the layer over time, once, when that time has passed or the throw is over."""
        field = self._prepared.throw_field
        if self._has_shown_field or field is None:
            return None
        if self._time < field.times[-1] and not self.ended_by:
            return None
        self._has_shown_field = True
        return field._replace(start_ns=self._start_ns)


def time_until_over(prepared: PreparedRig, elapsed: float, *, max_events: int) -> float:
    """
    Find how much longer a throw takes that has gone on for `elapsed`, by throwing once more.

    At most `LONGEST_THROW`, and exact to a millisecond or a tick. [s]
    """
    # the stepper of the rig is busy with the throw that is under way
    another = dataclasses.replace(prepared, stepper=stepper_of(prepared.config))
    throw = ScheduledThrow(another, number=0)
    tick = max(prepared.tick, 1e-3)
    ticks = 0
    while not throw.ended_by:
        ticks += 1
        throw._go_to(ticks * tick, max_events)
    return max(ticks * tick - elapsed, 0.0)
