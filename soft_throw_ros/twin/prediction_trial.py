# SPDX-License-Identifier: Apache-2.0
"""How good the predictions of measured throws are: a throw of which the truth is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np
from soft_throw_ros.configuration import Settings, TWIN
from soft_throw_ros.configuration.twin import rig_of
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import PLATE_POSITION, PROJECTILE_POSITION
from soft_throw_ros.core.wave_stepper import WaveStepper
from soft_throw_ros.twin.plate_estimator import Sample
from soft_throw_ros.twin.results import Release, ThrowResult
from soft_throw_ros.twin.session import Session
from soft_throw_ros.twin.tick_schedule import SECOND, TickSchedule

BEGIN_NS = 1_700_000_000 * SECOND
TRANSPORT_NS = 150_000  # of a sample to the twin [ns]
_FOLLOWED = 0.02  # how long after its start a throw is measured [s]
_AMPLITUDE = 0.03  # standard deviation of a throw's amplitude, as a part of it [-]


@dataclass(frozen=True, kw_only=True)
class PredictionTrial:
    """
    A throw as it was, and as it was predicted.

    Attributes
    ----------
    truth : Release
        When, how fast, and with how much energy the projectile left.
    release_ns : int
        When, by the clock of the twin. [ns]
    results : tuple of ThrowResult
        What the twin said, in order: see their `stage` and `accuracy`.

    """

    truth: Release
    release_ns: int
    results: tuple[ThrowResult, ...]

    @property
    def predictions(self) -> list[ThrowResult]:
        """Return what was said beforehand: first well enough known, and then for certain."""
        return [result for result in self.results if result.stage == 'predicted']

    def deviations(self, result: ThrowResult) -> tuple[float, float, float]:
        """Return how many of their errors time, speed and energy transfer are off the truth."""
        accuracy, first, truth = result.accuracy, result.first, self.truth
        assert accuracy is not None
        assert first is not None
        late = (accuracy.release_ns - self.release_ns) / SECOND
        transfer = first.energy_transfer - truth.energy_transfer
        return (
            late / accuracy.release_time_error,
            (first.ejection_speed - truth.ejection_speed) / accuracy.ejection_speed_error,
            transfer / accuracy.energy_transfer_error,
        )


def throw_results(settings: Settings, samples: Sequence[Sample]) -> list[ThrowResult]:
    """
    Have a twin follow what was measured, and return what it said.

    Parameters
    ----------
    settings : mapping of str to value
        Of the twin, complete, with `engine.motion` 'measured'.
    samples : sequence of Sample
        In order, from 1 s or less before the start of a throw on.

    """
    session = Session(settings)
    begin_ns = samples[0].stamp_ns
    session.set_tick_schedule(TickSchedule(step=0, time_ns=begin_ns, rate=session.rate))
    found: list[ThrowResult] = []
    taken = 0
    while taken < len(samples):
        arrived = session.due_ns(session.step) - TRANSPORT_NS
        first = taken
        while taken < len(samples) and samples[taken].stamp_ns <= arrived:
            taken += 1
        session.measure(samples[first:taken])
        found += session.advance().results
    session.close()
    return found


def prediction_trial(
    seed: int,
    *,
    settings: Settings | None = None,
    rate: float = 5000.0,
    noise: float = 5e-6,
    outliers: float = 0.0,
) -> PredictionTrial:
    """
    Simulate a throw of an engine that is known to the errors of the settings, and predict it.

    Parameters
    ----------
    seed : int
        Of all that is random.
    settings : mapping of str to value, optional
        Of the twin, complete; 'engine.motion' need not be 'measured'.
    rate : float
        Of the samples, whose stamps are off by up to 0.3 of their distance. [Hz]
    noise : float
        Standard deviation of positions. [m]
    outliers : float
        Part of them that is off by 1 mm. [-]

    Examples
    --------
    >>> trial = prediction_trial(1)
    >>> [result.accuracy.is_certain for result in trial.predictions]
    [False, True]
    >>> trial.predictions[0].lead > 2e-3
    True

    """
    settings = {**(settings or TWIN.defaults()), 'engine.motion': 'measured'}
    random = np.random.default_rng(seed)
    rig = rig_of(settings)
    engine = replace(
        rig.engine,
        frequency=rig.engine.frequency
        + settings['uncertainty.frequency'] * random.standard_normal(),
        damping_ratio=abs(
            rig.engine.damping_ratio
            + settings['uncertainty.damping_ratio'] * random.standard_normal()
        ),
        amplitude=rig.engine.amplitude * (1.0 + _AMPLITUDE * random.standard_normal()),
    )
    rig = replace(rig, engine=engine)
    rest = 12.0 * settings['measured.window'] + random.uniform(0.0, 2e-3)
    samples = _measure(rig, rest, rate, noise, outliers, random)
    exact = WaveStepper(rig)
    while not exact.advance_to(float(exact.state[0]) + 1e-3):
        pass
    release = exact.events()[0]
    return PredictionTrial(
        truth=Release.of(
            time=release.time,
            speed=release.velocity,
            peak_plate_speed=Underdamped.of(engine).peak_velocity,
        ),
        release_ns=BEGIN_NS + round((rest + release.time) * SECOND),
        results=tuple(throw_results(settings, samples)),
    )


def _measure(
    rig: Rig,
    rest: float,
    rate: float,
    noise: float,
    outliers: float,
    random: np.random.Generator,
) -> list[Sample]:
    """Measure a throw that begins after so much rest."""
    count = math.ceil((rest + _FOLLOWED) * rate)
    times = (np.arange(count) + 0.3 * random.uniform(-1.0, 1.0, count)) / rate
    stepper = WaveStepper(rig)
    heights = np.empty((count, 2))
    for row, time in zip(heights, times.tolist(), strict=True):
        stepper.advance_to(max(time - rest, 0.0))
        row[:] = stepper.state[[PLATE_POSITION, PROJECTILE_POSITION]]
    heights += noise * random.standard_normal(heights.shape)
    is_off = random.uniform(size=heights.shape) < outliers
    heights += np.where(is_off, 1e-3 * random.choice([-1.0, 1.0], heights.shape), 0.0)
    return [
        Sample(BEGIN_NS + round(time * SECOND), plate, math.nan, projectile)
        for time, (plate, projectile) in zip(times.tolist(), heights.tolist(), strict=True)
    ]
