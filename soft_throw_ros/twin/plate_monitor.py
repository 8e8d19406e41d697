# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A monitor of a measured plate that takes its samples and finds the onset of a throw."""

from __future__ import annotations

import math

import numpy as np
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.plate_observer import AMPLITUDE_ERROR
from soft_throw_ros.twin.results import State
from soft_throw_ros.twin.sample_buffer import (
    FEWEST,
    LONG_AGO,
    MEDIAN_DEVIATION,
    Onset,
    OUTLIER_SIGMAS,
    RestBaseline,
    SampleBuffer,
    SampleCounts,
    Samples,
)

RISE = 0.125
"""Time until the plate reaches the speed of a start, over its period. [-]"""

REST_WINDOWS = 8
"""Shortest rest of the plate before a throw, in smoothing windows. [-]"""

_LAGS = 1.0 / 16.0, 3.0 / 16.0
"""Delays of two running means of the heights, over the smoothing window. [-]"""

_NOISE_OF_MEANS = 0.29
"""Largest standard error of the difference of these means at any rate, over the noise. [-]"""

_REST_SIGMAS = 4.0
"""Standard errors of the speed within which the plate is at rest. [-]"""

_MOST_FOR_START = 128
"""Most samples in the fit of the start, to bound its cost. [-]"""

_MOST_MISFIT = 0.05
"""Median difference of the samples from a start, over the engine's amplitude, that is one. [-]"""

_START_STEPS = 6
"""Gauss-Newton steps of this fit. [-]"""

PER_CROSSING, PER_PERIOD = 3, 20
"""Samples that are needed while a wave crosses the layer, and in a period of the plate. [-]"""

MAX_NOISE = 1.5
"""Noise of the samples over `measured.position_noise`, above which it is reported. [-]"""

_RATE_ERROR = 0.03
"""Error of the estimated rate of a sensor whose stamps jitter, relative to the rate. [-]"""

_FEWEST_FOR_NOISE = 30
"""Fewest samples that give an estimate of the noise. [-]"""

_NOISE_RANGE = 15.0
"""Range of heights, in standard deviations, of a plate that is at rest but for noise. [-]"""


class _PlateTracker:
    """
    Smoothed height and speed of the plate, and whether it rests or has begun to move.

    The speed is the difference of two running means over that of their delays.
    """

    def __init__(self, config: MeasurementConfig, height: float) -> None:
        self.height = self._later = height  # means with the shorter and the longer delay [m]
        self.stamp_ns = LONG_AGO  # of the last sample
        self.speed = 0.0  # [m/s]
        self.quiet_ns = LONG_AGO  # last time at which it was slow enough for a rest
        self.disarm()
        self._config = config
        self._lags = [lag * config.smoothing_window for lag in _LAGS]
        error = _NOISE_OF_MEANS * config.position_noise / (self._lags[1] - self._lags[0])
        self._fast = max(config.start_speed, OUTLIER_SIGMAS * error)
        self._slow = max(0.5 * config.start_speed, _REST_SIGMAS * error)

    def disarm(self) -> None:
        """Wait for another rest."""
        self.is_armed = False  # whether the plate is at rest, so that a jump starts a throw
        self.moving_ns: int | None = None  # last time at which it was too fast for a rest
        self.begun_ns: int | None = None  # time at which it reached the speed of a start

    def observe(self, stamp_ns: int, height: float) -> None:
        """Observe the next height of the plate."""
        window_ns, since_ns = self._config.smoothing_window_ns, stamp_ns - self.stamp_ns
        since = since_ns / SECOND
        self.stamp_ns = stamp_ns
        short, long = self._lags
        self.height += since / (since + short) * (height - self.height)
        self._later += since / (since + long) * (height - self._later)
        self.speed = (self.height - self._later) / (long - short)
        is_over = self.begun_ns is not None and stamp_ns >= self.begun_ns + window_ns
        if since_ns > window_ns or is_over:  # a gap, or it was no start
            self.disarm()
        if self.moving_ns is None:
            self.moving_ns = stamp_ns
        elif self.begun_ns is not None:
            return
        elif self.is_armed and self._config.direction * self.speed > self._fast:
            self.begun_ns = stamp_ns
        elif abs(self.speed) > self._slow:
            self.moving_ns = stamp_ns
            self.is_armed &= stamp_ns - self.quiet_ns <= longest_rise(self._config) * SECOND
        else:
            self.quiet_ns = stamp_ns
            self.is_armed |= stamp_ns - self.moving_ns >= REST_WINDOWS * window_ns


class PlateMonitor:
    """
    A monitor of the plate from one throw to the next, and of its sensor.

    The samples of the `onset` of a throw that has just begun are used again. The plate is at rest
    when for `REST_WINDOWS` windows it has not been faster than half of the speed of a start, or
    four standard errors, and no more when it has been for `RISE` of its period. A throw has begun
    when it goes upwards at that speed, and at six standard errors of it, and has a start within
    the next window, see `_find_onset`. `crossing_time` is that of the wave in the layer [s].
    """

    def __init__(
        self,
        config: MeasurementConfig,
        crossing_time: float,
        counts: SampleCounts,
        onset: Onset | None = None,
    ) -> None:
        self.buffer = SampleBuffer(config, counts, None if onset is None else onset.samples)
        self._crossing_time = crossing_time
        self._rest = math.nan if onset is None else onset.rest.plate  # height of the plate [m]
        self._plate = _PlateTracker(config, self._rest if onset else 0.0)
        # height [m] and speed [m/s], on a slow plate those of the plate
        self._projectile = self._plate.height, 0.0
        self._reported: set[str] = set()  # kinds of faults

    def rearm(self, config: MeasurementConfig, crossing_time: float) -> None:
        """Wait for another rest before a throw, and use these parameters from now on."""
        if config != self.buffer.config:
            self.buffer = SampleBuffer(config, self.buffer.counts)
            self._plate = _PlateTracker(config, self._plate.height)
        self._crossing_time = crossing_time
        self._plate.disarm()

    @property
    def is_armed(self) -> bool:
        """Whether the plate is at rest, so that a jump starts a throw."""
        return self._plate.is_armed

    def advance(self, now_ns: int) -> Onset | None:
        """Observe the samples that are complete now; return the onset of a throw."""
        buffer, plate = self.buffer, self._plate
        config, new = buffer.config, buffer.complete(now_ns)
        is_tried = False  # with all complete samples
        for stamp_ns, height in zip(new.stamps.tolist(), new.plate.tolist(), strict=True):
            plate.observe(stamp_ns, height)
            if plate.begun_ns is not None and not is_tried:
                onset, is_tried = _find_onset(buffer, plate.begun_ns), True
                if onset is not None:
                    plate.disarm()
                    return None if self._rate_fault() else onset
        if new:
            if math.isnan(self._rest):
                self._rest, self._projectile = plate.height, (plate.height, 0.0)
            self._projectile = self._projectile[0], 0.0
            if abs(plate.speed) < config.start_speed:
                self._projectile = plate.height, plate.speed
        return None

    def state(self, rest: State) -> State:
        """Return the state of the plate, with the projectile lying on the layer."""
        if math.isnan(self._rest):
            return rest
        return rest._replace(
            plate_position=rest.plate_position + self._plate.height - self._rest,
            projectile_position=rest.projectile_position + self._projectile[0] - self._rest,
            plate_velocity=self._plate.speed,
            projectile_velocity=self._projectile[1],
        )

    def faults(self) -> tuple[str, ...]:
        """Return the faults of the sensor since the last call, each kind once."""
        faults = {'rate': self._rate_fault(), 'noise': self._noise_fault()}
        new = {kind for kind, fault in faults.items() if fault} - self._reported
        self._reported |= new
        return tuple(faults[kind] for kind in sorted(new))

    def _rate_fault(self) -> str:
        """Return the fault of a rate of samples that is too low to follow a throw, if any."""
        config, rate = self.buffer.config, self.buffer.rate()
        required = max(
            PER_CROSSING / self._crossing_time,
            PER_PERIOD * config.plate.frequency,
            FEWEST / config.smoothing_window,
        )
        if not 0.0 < rate < (1.0 - _RATE_ERROR) * required:
            return ''
        return (
            f'the plate is measured at {rate:.0f} Hz, which must be at least {required:.0f} Hz, '
            f'{PER_CROSSING} samples in a crossing of the wave, {PER_PERIOD} in a plate period '
            f'and {FEWEST} in measured.smoothing_window: no throw is followed'
        )

    def _noise_fault(self) -> str:
        """Return the fault of noise that hides the rest, or of heights in another unit, if any."""
        heights, expected = self.buffer.samples.plate, self.buffer.config.position_noise
        if self.is_armed or heights.size < _FEWEST_FOR_NOISE:
            return ''
        # second differences, which have six times the variance, are free of slow motions
        deviation = float(np.median(np.abs(np.diff(heights, 2)))) / MEDIAN_DEVIATION
        noise = deviation / math.sqrt(6.0)
        if noise <= MAX_NOISE * expected or np.ptp(heights) >= _NOISE_RANGE * noise:
            return ''
        return (
            f'the plate at rest scatters by {1e6 * noise:.3g} um, {noise / expected:.1f} times '
            f'measured.position_noise {1e6 * expected:.3g} um: set it, or divide heights in '
            'millimetres by 1000; the plate may never seem at rest, and then no throw is followed'
        )


def longest_rise(config: MeasurementConfig) -> float:
    """Return the longest time from a slow motion to the speed of a start [s]."""
    return max(RISE / config.plate.frequency, 2.0 * config.rise_time)


def _find_onset(buffer: SampleBuffer, begun_ns: int) -> Onset | None:
    """Find the start of a plate that was fast at `begun_ns`, if its motion is that of a start."""
    config, end_ns = buffer.config, buffer.complete_ns + 1
    window_ns = config.smoothing_window_ns
    first_ns = begun_ns - max(window_ns, round(longest_rise(config) * SECOND))
    before = buffer.between(first_ns - (REST_WINDOWS - 1) * window_ns, first_ns)
    samples = buffer.between(first_ns, end_ns)
    if min(len(before), len(samples)) < FEWEST:
        return None
    # rounded samples at rest are all the same, so that their scatter underestimates the noise
    noise = max(config.position_noise, float(before.plate.std()))
    projectile = before.projectile[np.isfinite(before.projectile)]
    rest = RestBaseline(
        plate=float(before.plate.mean()),
        projectile=float(projectile.mean()) if projectile.size else math.nan,
        noise=noise,
        error=noise / math.sqrt(len(before)),
    )
    # a slow engine moves for many samples; a subset suffices
    stride = math.ceil(len(samples) / _MOST_FOR_START)
    thinned = samples[(len(samples) - 1) % stride::stride]
    onset_ns, size = _find_start(thinned, begun_ns, rest, config)
    moved = buffer.between(onset_ns + 1, end_ns)
    if len(moved) < FEWEST - 1:
        return None
    height, speed, _ = size * config.motion.states_at(moved.seconds_since(onset_ns)).T
    if (config.direction * speed).max() < config.start_speed:
        return None
    misfit = float(np.median(np.abs(moved.plate - rest.plate - height)))
    if misfit > max(_MOST_MISFIT * config.plate.amplitude, OUTLIER_SIGMAS * rest.noise):
        return None
    return Onset(onset_ns=onset_ns, rest=rest, samples=buffer.between(onset_ns - window_ns))


def _find_start(
    samples: Samples, begun_ns: int, rest: RestBaseline, config: MeasurementConfig
) -> tuple[int, float]:
    """Fit the start [ns], near `begun_ns`, and the relative amplitude [-], from expected ones."""
    window = config.smoothing_window
    since, heights = samples.seconds_since(begun_ns), samples.plate - rest.plate
    start, size = -config.rise_time, 1.0
    prior = np.array([1.0 / AMPLITUDE_ERROR, 1.0 / window]) ** 2
    for _ in range(_START_STEPS):
        height, speed, _ = config.motion.states_at(since - start).T
        error = np.hypot(rest.noise, size * speed * config.stamp_error)
        rows = np.stack((height, -size * speed)) / error
        misfit = rows @ ((heights - size * height) / error) + prior * [1.0 - size, 0.0]
        change = np.linalg.solve(rows @ rows.T + np.diag(prior), misfit)
        size += float(change[0])
        start += float(np.clip(change[1], -0.25 * window, 0.25 * window))
    return begun_ns + round(start * SECOND), size
