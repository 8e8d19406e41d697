# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A monitor of a measured plate that takes its samples and finds the onset of a throw."""

from __future__ import annotations

import math

import numpy as np
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.kernels import kernel
from soft_throw_ros.storage.message import SECOND
from soft_throw_ros.twin.plate_observer import AMPLITUDE_ERROR
from soft_throw_ros.twin.results import Floats, State
from soft_throw_ros.twin.sample_buffer import (
    FEWEST,
    LONG_AGO,
    Onset,
    OUTLIER_SIGMAS,
    REST_WINDOWS,
    RestBaseline,
    SampleBuffer,
    SampleCounts,
)

RISE = 0.125
"""Time until the plate reaches the speed of a start, over its period. [-]"""

_LAG = 0.125
"""Time constant of the smoothing of heights, over the smoothing window. [-]"""

_START_STEPS = 6
"""Gauss-Newton steps in the fit of the start. [-]"""

FEWEST_PER_CROSSING = 3
"""Fewest samples while a wave crosses the layer. [-]"""


class PlateMonitor:
    """
    A monitor of the plate from one throw to the next, and of its sensor.

    Height and speed are by double exponential smoothing. The plate is at rest when for
    `REST_WINDOWS` windows it has not been faster than half of the speed of a start, and no more
    when it has been for `RISE` of its period. A throw has begun when it goes upwards at that
    speed, and has a start within the next window, see `_find_onset`. Both speeds are at least six
    standard errors by the noise of the samples. The samples of the `onset` of a throw that has
    just begun are used again. `crossing_time` is that of the wave in the layer [s].
    """

    def __init__(
        self, config: MeasurementConfig, crossing_time: float, counts: SampleCounts,
        onset: Onset | None = None,
    ) -> None:
        self.buffer = SampleBuffer(config, counts, None if onset is None else onset.samples)
        self._crossing_time = crossing_time
        self._rest = math.nan if onset is None else onset.rest.plate  # height of the plate [m]
        self._height = self._later = self._rest if onset else 0.0  # smoothed once and twice [m]
        self._speed = 0.0  # [m/s]
        # height [m] and speed [m/s], on a slow plate those of the plate
        self._projectile = self._height, 0.0
        self._stamp_ns = LONG_AGO  # of the last sample
        self._quiet_ns = LONG_AGO  # last time at which it was slow enough for a rest
        self._disarm()

    def _disarm(self) -> None:
        """Wait for another rest."""
        self.is_armed = False  # whether the plate is at rest, so that a jump starts a throw
        self._moving_ns: int | None = None  # last time at which it was too fast for a rest
        self._begun_ns: int | None = None  # time at which it reached the speed of a start

    def rearm(self, config: MeasurementConfig, crossing_time: float) -> None:
        """Wait for another rest before a throw, and use these parameters from now on."""
        if config != self.buffer.config:
            self.buffer = SampleBuffer(config, self.buffer.counts)
        self._crossing_time = crossing_time
        self._disarm()

    def advance(self, now_ns: int) -> Onset | None:
        """Observe the samples that are complete now; return the onset of a throw."""
        new, is_tried = self.buffer.complete(now_ns), False  # with all complete samples
        for stamp_ns, height in zip(new.stamps.tolist(), new.plate.tolist(), strict=True):
            self._observe(stamp_ns, height)
            if self._begun_ns is not None and not is_tried:
                onset, is_tried = _find_onset(self.buffer, self._begun_ns), True
                if onset is not None:
                    self._disarm()
                    return None if self.rate_fault() else onset
        if new:
            if math.isnan(self._rest):
                self._rest, self._projectile = self._height, (self._height, 0.0)
            self._projectile = self._projectile[0], 0.0
            if abs(self._speed) < self.buffer.config.start_speed:
                self._projectile = self._height, self._speed
        return None

    def _observe(self, stamp_ns: int, height: float) -> None:
        """Observe the next height of the plate."""
        config, since_ns = self.buffer.config, stamp_ns - self._stamp_ns
        self._stamp_ns, window_ns = stamp_ns, config.smoothing_window_ns
        lag = _LAG * config.smoothing_window
        ratio = since_ns / SECOND / lag
        weight = ratio / (1.0 + ratio)
        self._height += weight * (height - self._height)
        self._later += weight * (self._height - self._later)
        self._speed = (self._height - self._later) / lag
        # the square root is the standard error of lag times speed, over that of the heights
        error = config.position_noise / lag * math.sqrt(2.0 * ratio / (2.0 + ratio) ** 3)
        least = OUTLIER_SIGMAS * error
        is_over = self._begun_ns is not None and stamp_ns >= self._begun_ns + window_ns
        if since_ns > window_ns or is_over:  # a gap, or it was no start
            self._disarm()
        if self._moving_ns is None:
            self._moving_ns = stamp_ns
        elif self._begun_ns is not None:
            return
        elif self.is_armed and config.direction * self._speed > max(config.start_speed, least):
            self._begun_ns = stamp_ns
        elif abs(self._speed) > max(0.5 * config.start_speed, least):
            self._moving_ns = stamp_ns
            self.is_armed &= stamp_ns - self._quiet_ns <= longest_rise(config) * SECOND
        else:
            self._quiet_ns = stamp_ns
            self.is_armed |= stamp_ns - self._moving_ns >= REST_WINDOWS * window_ns

    def state(self, rest: State) -> State:
        """Return the state of the plate, with the projectile lying on the layer."""
        if math.isnan(self._rest):
            return rest
        height, speed = self._projectile
        return rest._replace(
            plate_position=rest.plate_position + self._height - self._rest,
            projectile_position=rest.projectile_position + height - self._rest,
            plate_velocity=self._speed,
            projectile_velocity=speed,
        )

    def rate_fault(self) -> str:
        """Return the fault of a rate of samples that is too low to follow a throw, if any."""
        rate = self.buffer.rate()
        spans = (
            (FEWEST_PER_CROSSING, self._crossing_time),
            (FEWEST, self.buffer.config.smoothing_window),
        )
        if not rate or all(round(rate * span) >= fewest for fewest, span in spans):
            return ''
        required = max(fewest / span for fewest, span in spans)
        return (
            f'the plate is measured at {rate:.0f} Hz, which must be at least {required:.0f} Hz, '
            f'{FEWEST_PER_CROSSING} samples in a crossing of the wave and {FEWEST} in '
            'measured.smoothing_window: no throw is followed'
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
    scatter = max(config.position_noise, float(before.plate.std()))
    projectile = before.projectile[np.isfinite(before.projectile)]
    rest = RestBaseline(
        plate=float(before.plate.mean()),
        projectile=float(projectile.mean()) if projectile.size else math.nan,
        noise=scatter,
        error=scatter / math.sqrt(len(before)),
    )
    start, size = _fit_start(
        config.start_table, samples.seconds_since(begun_ns), samples.plate - rest.plate,
        rest.noise, config.stamp_error, config.smoothing_window, -config.rise_time,
    )
    onset_ns = begun_ns + round(start * SECOND)
    moved = buffer.between(onset_ns + 1, end_ns)
    if len(moved) < FEWEST - 1:
        return None
    times, heights, speeds = config.start_table
    since = moved.seconds_since(onset_ns)
    speed = size * config.direction * np.interp(since, times, speeds)
    if speed.max() < config.start_speed:
        return None
    differences = moved.plate - rest.plate - size * np.interp(since, times, heights)
    noise = np.hypot(rest.noise, config.stamp_error * speed)
    tolerance = 2.0 * AMPLITUDE_ERROR * config.plate.amplitude
    misfit = np.abs(differences) / np.maximum(tolerance, OUTLIER_SIGMAS * noise)
    if np.sort(misfit)[len(moved) // 2] > 1.0:
        return None
    return Onset(onset_ns=onset_ns, rest=rest, samples=buffer.between(onset_ns - window_ns))


@kernel
def _fit_start(
    table: Floats, since: Floats, heights: Floats, noise: float, stamp_error: float,
    window: float, start: float,
) -> tuple[float, float]:
    """Fit the start, near a first value, and the relative amplitude, by Gauss-Newton steps."""
    size, most = 1.0, 0.25 * window
    for _ in range(_START_STEPS):
        a, b, c = AMPLITUDE_ERROR**-2, 0.0, window**-2  # the normal equations, with a prior
        p, q = a * (1.0 - size), 0.0
        for n in range(since.size):
            height = np.interp(since[n] - start, table[0], table[1])
            slope = -size * np.interp(since[n] - start, table[0], table[2])
            weight = 1.0 / (noise**2 + (slope * stamp_error) ** 2)
            misfit = heights[n] - size * height
            a += weight * height * height
            b += weight * height * slope
            c += weight * slope * slope
            p += weight * height * misfit
            q += weight * slope * misfit
        size += (c * p - b * q) / (a * c - b * b)
        start += min(max((a * q - b * p) / (a * c - b * b), -most), most)
    return start, size


def warm_up() -> None:
    """Compile the kernel, or load it from the cache on disk."""
    _fit_start(np.ones((3, 1)), np.zeros(1), np.zeros(1), 1.0, 0.0, 1.0, 0.0)
