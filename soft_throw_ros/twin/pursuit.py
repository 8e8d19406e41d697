# SPDX-License-Identifier: Apache-2.0
"""
A throw of a measured plate: what the model says of it, ahead of the rig.

A wave needs a crossing time to get from the plate to the projectile. So what the projectile does
is known that much longer than what the plate does, by a model that goes ahead while the plate,
for all that it matters, goes on as it was (see `ThrowStepper.depart`).
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.stepping import (
    EventLimitError,
    FEED_SEGMENTS,
    PROJECTILE_FORCE,
    PROJECTILE_POSITION,
    PROJECTILE_VELOCITY,
    ThrowStepper,
    TIME,
)
from soft_throw_ros.twin.flight import Flight
from soft_throw_ros.twin.measurement import (
    Departure,
    first_states,
    Nodes,
    PAST,
    peak_speed,
    SECOND,
    Track,
)
from soft_throw_ros.twin.plan import FIELD_POINTS, make_stepper, Plan, THROW_FIELD_ROWS
from soft_throw_ros.twin.results import (
    Comparison,
    Event,
    Field,
    Prediction,
    Residual,
    State,
    ThrowField,
    ThrowResult,
)

LOST = PAST
"""When nothing has come for so long, what comes then is too old, and the plate is lost. [ns]"""

FEWEST = 8
"""Samples of the projectile in flight that tell its errors."""

QUIET = 0.5
"""What is slower than this part of the speed of a start is at rest. [-]"""


class Advanced(NamedTuple):
    """
    What a step gives.

    Attributes
    ----------
    state : State
        At the step.
    events : tuple of Event
        Releases and landings that have become certain.
    forecast : ThrowResult or None
        In the step in which the first release has become known.
    prediction : Prediction
        The projectile, as far ahead as it is known.
    residual : Residual or None
        At the last sample of the projectile that could be compared.

    """

    state: State
    events: tuple[Event, ...]
    forecast: ThrowResult | None
    prediction: Prediction
    residual: Residual | None


class Pursuit:
    """
    A throw whose plate is measured, from its start until it is over.

    Parameters
    ----------
    plan : Plan
        What throws, with a measured plate.
    departure : Departure
        How it began.
    track : Track
        Of the plate, from the origin of the departure on.
    number : int
        Of the throw.

    """

    def __init__(self, plan: Plan, departure: Departure, track: Track, *, number: int) -> None:
        self.plan = plan
        self._departure = departure
        self._track = track
        self._stepper = plan.stepper
        self._scout, self._far_scout = plan.scouts
        self._flight = Flight(
            plan,
            plan.stepper,
            number=number,
            quiet_speed=QUIET * track.tuning.start_speed,
        )
        times, states = first_states(departure, track.tuning)
        self._stepper.feed_states(times, states)
        self._times, self._states = times.tolist(), states.tolist()
        self._differences = _Differences(
            longest=1.0 / plan.rig.engine.frequency,
            band=track.tuning.band,
            gravity=plan.rig.gravity,
        )
        self._compared_ns = departure.onset_ns
        self._lead: float | None = None
        self._has_shown_field = False

    @property
    def number(self) -> int:
        """Number of the throw."""
        return self._flight.number

    @property
    def ended_by(self) -> str:
        """Why it is over, empty while it goes on; 'gap' if the plate was not seen for too long."""
        return self._flight.ended_by

    @ended_by.setter
    def ended_by(self, reason: str) -> None:
        self._flight.ended_by = reason

    @property
    def has_left(self) -> bool:
        """Whether the projectile has left at least once."""
        return self._flight.has_left

    def advance(
        self, nodes: Nodes, *, step: int, now_ns: int, max_events: int, max_strain: float
    ) -> Advanced:
        """Go on as far as the plate is known, and look ahead from there."""
        crossing = self.plan.rig.crossing_time
        if nodes.gap > crossing or now_ns - self._track.newest_ns > LOST:
            self.ended_by = 'gap'
        else:
            self._feed(nodes)
        events, residual = self._follow(max_events)
        known = self._stepper.horizon
        prediction, forecast = self._look_ahead(known, step, now_ns, max_strain)
        # what was extrapolated any longer would say nothing
        farthest = known + crossing + self._track.tuning.window
        now = (now_ns - self._departure.onset_ns) / SECOND
        self._send(self._scout, max(known, min(now, farthest)))
        state = State._make(self._scout.state.tolist()[1:])
        return Advanced(state, events, forecast, prediction, residual)

    def _feed(self, nodes: Nodes) -> None:
        """Have the model know of the plate."""
        later = nodes.times > self._times[-1]
        if not later.any():
            return
        times, states = nodes.times[later], nodes.states[later]
        states[:, 0] -= self._departure.plate_rest
        self._stepper.feed_states(times, states)
        if len(self._times) + times.size < FEED_SEGMENTS:
            self._times += times.tolist()
            self._states += states.tolist()

    def _follow(self, max_events: int) -> tuple[tuple[Event, ...], Residual | None]:
        """Go on as far as the plate is known, past the samples of the projectile."""
        flight, departure = self._flight, self._departure
        known = self._stepper.horizon
        until_ns = departure.onset_ns + math.ceil(known * SECOND)
        happened: list[Event] = []
        residual = None
        samples = self._track.samples(self._compared_ns + 1, until_ns + 1)
        if self._differences.is_complete:
            samples = samples[-2:]  # the last one may be too late
        for sample in samples:
            time = (sample.stamp_ns - departure.onset_ns) / SECOND
            if time > known:
                break
            self._compared_ns = sample.stamp_ns
            is_passed = time < self._stepper.state[TIME]  # it is late for the start
            if is_passed or math.isnan(sample.projectile - departure.projectile_rest):
                continue
            state, events = flight.advance(time, max_events=max_events)
            happened += events
            rise = state.projectile_position - self.plan.rest.projectile_position
            residual = Residual(
                sample.stamp_ns,
                state.plate_position - (sample.plate - departure.plate_rest),
                rise - (sample.projectile - departure.projectile_rest),
            )
            self._differences.add(time, residual.projectile, flight)
        _, events = flight.advance(known, max_events=max_events)
        return (*happened, *events), residual

    def _look_ahead(
        self, known: float, step: int, now_ns: int, max_strain: float
    ) -> tuple[Prediction, ThrowResult | None]:
        """Find out what the projectile does as long as the plate cannot change it any more."""
        plan, scout, onset_ns = self.plan, self._far_scout, self._departure.onset_ns
        ahead = known + plan.foresight
        self._send(scout, ahead)
        stamp_ns = onset_ns + round(ahead * SECOND)
        prediction = Prediction(
            stamp_ns,
            float(scout.state[PROJECTILE_POSITION]),
            float(scout.state[PROJECTILE_VELOCITY]),
            float(scout.state[PROJECTILE_FORCE]),
            stamp_ns - now_ns,
        )
        if self._lead is not None or not scout.event_count:
            return prediction, None
        release = scout.events()[0]
        if release.time > known + plan.release_foresight:
            return prediction, None
        self._lead = release.time - (now_ns - onset_ns) / SECOND
        self._measure_peak()
        forecast = self._flight.forecast(step, max_strain, scout)
        return prediction, dataclasses.replace(forecast, lead=self._lead)

    def _send(self, scout: ThrowStepper, time: float) -> None:
        """Have a scout go ahead, or as far as its memory for events lasts."""
        scout.depart(self._stepper)
        try:
            scout.advance_to(time)
        except EventLimitError:
            self.ended_by = 'max_events'

    def _measure_peak(self) -> None:
        """Find the largest speed of the plate so far, which has started by all means."""
        speeds = [speed for _, speed, _ in self._states]
        period = 1.0 / self.plan.rig.engine.frequency
        self._flight.peak_plate_speed = max(
            peak_speed(self._times, speeds, period), self._track.tuning.start_speed
        )

    def result(self, stage: str, step: int, max_strain: float) -> ThrowResult:
        """Sum up what there is so far; before the throw is over, loads are those up to release."""
        self._measure_peak()
        return dataclasses.replace(
            self._flight.result(stage, step, max_strain),
            lead=self._lead,
            comparison=self._differences.sum_up(self._flight.first_release),
        )

    def read_field(self, field: Field) -> None:
        """Write what the layer does now."""
        self._scout.read_field(field.strain, field.velocity)

    def field(self) -> ThrowField | None:
        """Return the layer over time, once, when the plate is known for long enough or no more."""
        release = self._flight.first_release
        known = self._times[-1]
        if self._has_shown_field or not (release or self.ended_by):
            return None
        length = 1.5 * release.time if release else known
        if length > known and not self.ended_by:
            return None
        self._has_shown_field = True
        stepper = make_stepper(self.plan.rig, self.plan.model, 'measured')
        stepper.feed_states(self._times, self._states)
        times = np.linspace(0.0, min(length, known), THROW_FIELD_ROWS)
        strain = np.empty((THROW_FIELD_ROWS, FIELD_POINTS))
        stepper.sample_field(np.minimum(times, stepper.horizon), strain)
        return ThrowField(times, strain)


class _Differences:
    """
    Positions of the projectile by the model less those measured.

    Parameters
    ----------
    longest : float
        For how long after the release they are taken. [s]
    band : float
        How large they may be, rms. [m]
    gravity : float
        [m/s2]

    Attributes
    ----------
    is_complete : bool
        Whether no more are taken.

    """

    def __init__(self, *, longest: float, band: float, gravity: float) -> None:
        self.is_complete = False
        self._longest = longest
        self._band = band
        self._gravity = gravity
        self._count = 0
        self._sum = 0.0  # of squares
        self._largest = 0.0
        self._aloft: list[tuple[float, float]] = []  # time since the release, and difference

    def add(self, time: float, difference: float, flight: Flight) -> None:
        """Take one, at a time since the start."""
        release = flight.first_release
        since = time - release.time if release else 0.0
        if since > self._longest:
            self.is_complete = True
            return
        self._count += 1
        self._sum += difference**2
        self._largest = max(self._largest, abs(difference))
        if release and not flight.has_landed:
            self._aloft.append((since, difference))

    def sum_up(self, release: Event | None) -> Comparison | None:
        """Return what they come to; None if there is none."""
        if not self._count:
            return None
        comparison = Comparison(
            samples=self._count,
            position_rms=math.sqrt(self._sum / self._count),
            position_max=self._largest,
            band=self._band,
        )
        is_enough = len(self._aloft) >= FEWEST and self._aloft[-1][0] >= 0.5 * self._longest
        if release is None or not is_enough:
            return comparison
        times, differences = np.array(self._aloft).T
        # both fly freely, so that the difference is a line
        slope, ahead = np.polyfit(times, differences, 1).tolist()
        later = -ahead / release.velocity
        return dataclasses.replace(
            comparison,
            ejection_time_error=later,
            ejection_speed_error=slope - self._gravity * later,
        )
