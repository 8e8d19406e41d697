# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A monitor of a measured plate that takes its samples and finds the onset of a throw."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
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

_MEMORY = np.dtype(
    [
        ('height', 'f8'),  # smoothed once [m]
        ('later', 'f8'),  # smoothed twice [m]
        ('speed', 'f8'),  # [m/s]
        ('stamp', 'i8'),  # of the last sample [ns]
        ('quiet', 'i8'),  # last time at which it was slow enough for a rest [ns]
        ('moving', 'i8'),  # last time at which it was too fast for a rest, or `LONG_AGO` [ns]
        ('begun', 'i8'),  # time at which it reached the speed of a start, or `LONG_AGO` [ns]
        ('armed', '?'),  # whether the plate is at rest, so that a jump starts a throw
    ],
    align=True,
)


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
        height = 0.0 if onset is None else self._rest
        # height [m] and speed [m/s], on a slow plate those of the plate
        self._projectile = height, 0.0
        self._memory = np.array([(height, height, 0.0, *[LONG_AGO] * 4, False)], _MEMORY)
        self._present = self._memory[0]

    @property
    def is_armed(self) -> bool:
        """Whether the plate is at rest, so that a jump starts a throw."""
        return bool(self._present['armed'])

    def rearm(self, config: MeasurementConfig, crossing_time: float) -> None:
        """Wait for another rest before a throw, and use these parameters from now on."""
        if config != self.buffer.config:
            self.buffer = SampleBuffer(config, self.buffer.counts)
        self._crossing_time = crossing_time
        _disarm(self._memory)

    def advance(self, now_ns: int) -> Onset | None:
        """Observe the samples that are complete now; return the onset of a throw."""
        new = self.buffer.complete(now_ns)
        if not new:
            return None
        config = self.buffer.config
        begun_ns = _observe(
            self._memory, new.stamps, new.heights, config.smoothing_window_ns,
            longest_rise(config), config.position_noise, config.start_speed, config.direction,
        )
        if begun_ns != LONG_AGO and (onset := _find_onset(self.buffer, begun_ns)) is not None:
            _disarm(self._memory)
            return None if self.rate_fault() else onset
        height, speed = float(self._present['height']), float(self._present['speed'])
        if math.isnan(self._rest):
            self._rest, self._projectile = height, (height, 0.0)
        is_slow = abs(speed) < config.start_speed
        self._projectile = (height, speed) if is_slow else (self._projectile[0], 0.0)
        return None

    def state(self, rest: State) -> State:
        """Return the state of the plate, with the projectile lying on the layer."""
        if math.isnan(self._rest):
            return rest
        height, speed = self._projectile
        return rest._replace(
            plate_position=rest.plate_position + float(self._present['height']) - self._rest,
            projectile_position=rest.projectile_position + height - self._rest,
            plate_velocity=float(self._present['speed']),
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
    plate, projectile, scatter = _baseline(before.heights)
    # rounded samples at rest are all the same, so that their scatter underestimates the noise
    noise = max(config.position_noise, scatter)
    rest = RestBaseline(plate, projectile, noise, noise / math.sqrt(len(before)))
    start, is_start = _fit_start(
        config.start_table, samples.seconds_since(begun_ns), samples.plate - plate, noise,
        config.stamp_error, config.smoothing_window, -config.rise_time, config.start_speed,
        config.direction, 2.0 * AMPLITUDE_ERROR * config.plate.amplitude,
    )
    if not is_start:
        return None
    onset_ns = begun_ns + round(start * SECOND)
    return Onset(onset_ns=onset_ns, rest=rest, samples=buffer.between(onset_ns - window_ns))


@kernel
def _disarm(memory: NDArray[np.void]) -> None:
    """Wait for another rest."""
    s = memory[0]
    s.armed, s.moving, s.begun = False, LONG_AGO, LONG_AGO


@kernel
def _observe(
    memory: NDArray[np.void], stamps: NDArray[np.int64], heights: Floats, window_ns: int,
    rise: float, noise: float, start_speed: float, direction: float,
) -> int:
    """Observe samples; return when the first possible throw began, `LONG_AGO` without one [ns]."""
    s, lag, first = memory[0], _LAG * (window_ns / SECOND), LONG_AGO
    for n in range(stamps.size):
        since_ns = stamps[n] - s.stamp
        ratio = since_ns / SECOND / lag
        weight = ratio / (1.0 + ratio)
        s.stamp = stamps[n]
        s.height += weight * (heights[n, 0] - s.height)
        s.later += weight * (s.height - s.later)
        s.speed = (s.height - s.later) / lag
        # the square root is the standard error of lag times speed, over that of the heights
        error = noise / lag * math.sqrt(2.0 * ratio / (2.0 + ratio) ** 3)
        least = OUTLIER_SIGMAS * error
        is_over = s.begun != LONG_AGO and s.stamp >= s.begun + window_ns
        if since_ns > window_ns or is_over:  # a gap, or it was no start
            _disarm(memory)
        if s.moving == LONG_AGO:
            s.moving = s.stamp
        elif s.begun == LONG_AGO:
            if s.armed and direction * s.speed > max(start_speed, least):
                s.begun = s.stamp
            elif abs(s.speed) > max(0.5 * start_speed, least):
                s.moving = s.stamp
                s.armed = s.armed and s.stamp - s.quiet <= rise * SECOND
            else:
                s.quiet = s.stamp
                s.armed = s.armed or s.stamp - s.moving >= REST_WINDOWS * window_ns
        if first == LONG_AGO:
            first = s.begun
    return first


@kernel
def _baseline(heights: Floats) -> tuple[float, float, float]:
    """Return the mean heights of plate and projectile, and the scatter of the plate."""
    plate, projectile = heights[:, 0], heights[:, 1]
    return plate.mean(), float(np.nanmean(projectile)), plate.std()


@kernel
def _fit_start(
    table: Floats, since: Floats, heights: Floats, noise: float, stamp_error: float,
    window: float, start: float, start_speed: float, direction: float, tolerance: float,
) -> tuple[float, bool]:
    """Fit start, near a first value, and relative amplitude; return whether it is a start."""
    size, most = 1.0, 0.25 * window
    for _ in range(_START_STEPS):  # by Gauss and Newton
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
    moved, fitting, fastest = 0, 0, 0.0
    for n in range(since.size):
        if since[n] > start:
            speed = size * direction * np.interp(since[n] - start, table[0], table[2])
            misfit = heights[n] - size * np.interp(since[n] - start, table[0], table[1])
            error = math.hypot(noise, stamp_error * speed)
            moved, fastest = moved + 1, max(fastest, speed)
            fitting += abs(misfit) <= max(tolerance, OUTLIER_SIGMAS * error)
    return start, moved >= FEWEST - 1 and fastest >= start_speed and 2 * fitting > moved


def warm_up() -> None:
    """Compile the kernels, or load them from the cache on disk."""
    memory, rows, none = np.zeros(1, _MEMORY), np.zeros((1, 2)), np.zeros(0)
    _disarm(memory)
    _observe(memory, np.zeros(1, np.int64), rows, 1, 1.0, 1.0, 1.0, 1.0)
    _baseline(rows)
    _fit_start(np.ones((3, 1)), none, none, 1.0, 0.0, 1.0, 0.0, 1.0, 1.0, 1.0)
