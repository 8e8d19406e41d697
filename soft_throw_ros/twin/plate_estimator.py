# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The motion of a measured plate, estimated from samples as they arrive.

Samples are sorted by their stamps. Samples older than the newest stamp by more than
`measured.latency` (the watermark) are complete, and are smoothed at times an eighth of the window
apart, see `soft_throw_ros.core.smoothing`. The plate is therefore known up to a quarter of the
window, the latency and at most an eighth of the window before the newest sample. Samples that
arrive for a complete time are late, and are refused.

Outliers among complete samples are left out, see `outlier_filter`: a body is not accelerated by
much more than the acceleration of the engine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.smoothing import AHEAD, BEHIND, FEWEST, fit_cubics
from soft_throw_ros.twin.outlier_filter import OutlierFilter
from soft_throw_ros.twin.sample_buffer import Rows, Sample, SampleBuffer, seconds_since
from soft_throw_ros.twin.tick_schedule import SECOND

Floats = NDArray[np.float64]

FUTURE = SECOND // 10
"""Largest accepted lead of a stamp over the clock. [ns]"""

PAST = SECOND
"""Largest accepted age of a stamp by the clock. [ns]"""

FARTHEST = 100.0
"""Largest accepted magnitude of a height; every real rig stays below. [m]"""

PER_CROSSING = 3
"""Samples that are needed while a wave crosses the layer. [-]"""

PER_PERIOD = 20
"""Samples that are needed in a period of the plate. [-]"""

REST_WINDOWS = 8
"""Shortest rest of the plate before a throw, in smoothing windows. [-]"""

STATES_PER_WINDOW = 8
"""Times in a smoothing window at which the plate is estimated. [-]"""

_KEPT_WINDOWS = 16
"""Length of the stored record in smoothing windows: the rest, the start and a reserve. [-]"""

_LONGEST_STEP = 1000
"""Times that one call smooths at most, to bound its cost; earlier times are skipped. [-]"""


class PlateStates(NamedTuple):
    """Smoothed motion of the plate."""

    times: Floats  # since the origin of the estimator, shape (n,) [s]
    states: Floats  # height [m], velocity [m/s], acceleration [m/s2], shape (n, 3)
    errors: Floats  # standard errors of the velocity, shape (n,) [m/s]
    gap: float = 0.0  # longest time between samples on the way here [s]


class SampledSpan(Enum):
    """Time spans in which a minimum number of samples is needed."""

    CROSSING = 'crossing of the wave'
    PERIOD = 'period of the plate'
    WINDOW = 'smoothing window'


@dataclass
class SampleCounts:
    """Numbers of accepted samples, late and outlying ones included, and refusals by reason."""

    taken: int = 0
    out_of_order: int = 0
    outliers: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    """By 'not finite', 'out of range', 'future', 'past', 'doubled' and 'late'."""


@dataclass(frozen=True, kw_only=True)
class RestBaseline:
    """Heights of plate and projectile at rest before a throw."""

    plate: float  # mean heights; that of the projectile is NaN if it was not measured [m]
    projectile: float
    noise: float  # standard deviation of the plate's samples [m]
    error: float  # standard error of its mean [m]


@dataclass(frozen=True, kw_only=True)
class Onset:
    """The start of the plate's motion, and so of a throw."""

    onset_ns: int  # time of the start [ns]
    rest: RestBaseline
    samples: tuple[Sample, ...]  # sorted, from a window before the start on
    clock_offset_ns: int = 0  # what was added to the stamps of the samples [ns]


NO_STATES = PlateStates(np.empty(0), np.empty((0, 3)), np.empty(0))


def state_spacing_ns(config: MeasurementConfig) -> int:
    """Return the interval between the times at which the plate is estimated [ns]."""
    return config.smoothing_window_ns // STATES_PER_WINDOW


def least_rate(config: MeasurementConfig, crossing_time: float) -> tuple[float, SampledSpan]:
    """Return the lowest sufficient rate of samples [Hz], and the time span that requires it."""
    rates = {
        SampledSpan.CROSSING: PER_CROSSING / crossing_time,
        SampledSpan.PERIOD: PER_PERIOD * config.plate.frequency,
        SampledSpan.WINDOW: FEWEST / config.smoothing_window,
    }
    span = max(rates, key=rates.__getitem__)
    return rates[span], span


class PlateEstimator:
    """
    Samples sorted by stamp, and the smoothed motion of the plate.

    Parameters
    ----------
    config : MeasurementConfig
        Parameters of the measurement.
    origin_ns : int, optional
        Time 0; by default the stamp of the first sample. [ns]
    samples : sequence of Sample
        Samples that have been accepted already, sorted.
    counts : SampleCounts, optional
        Counts of samples, which the estimator updates.

    """

    def __init__(
        self,
        config: MeasurementConfig,
        *,
        origin_ns: int | None = None,
        samples: Sequence[Sample] = (),
        counts: SampleCounts | None = None,
    ) -> None:
        self.config = config
        self.origin_ns = origin_ns
        self.counts = counts or SampleCounts()
        self._samples = SampleBuffer(samples)
        self.newest_ns = samples[-1].stamp_ns if samples else -math.inf  # newest stamp [ns]
        self._next = 0  # next time to estimate, in spacings
        self.outliers = 0  # accepted samples that were left out later
        self.complete_ns = -math.inf  # time until which samples are complete [ns]
        self._smoothed_ns = -math.inf  # end of the last window
        plate = config.plate
        acceleration = plate.amplitude * (2.0 * math.pi * plate.frequency) ** 2
        self._outlier_filter = OutlierFilter(
            acceleration, config.position_noise, config.stamp_error
        )

    def samples(self, begin_ns: float, end_ns: float = math.inf) -> Rows:
        """Return the stored samples from one time to before another."""
        return self._samples.between(begin_ns, end_ns)

    def rest_before(self, end_ns: float) -> RestBaseline | None:
        """Return the rest of some windows before a time; None if there are too few samples."""
        window_ns = self.config.smoothing_window_ns
        samples = self.samples(end_ns - (REST_WINDOWS - 1) * window_ns, end_ns)
        if len(samples) < FEWEST:
            return None
        plate, projectile = samples['plate'], samples['projectile']
        measured = projectile[np.isfinite(projectile)]
        # rounded samples at rest are all the same, so that their scatter underestimates the noise
        noise = max(self.config.position_noise, float(plate.std()))
        return RestBaseline(
            plate=float(plate.mean()),
            projectile=float(measured.mean()) if measured.size else math.nan,
            noise=noise,
            error=noise / math.sqrt(plate.size),
        )

    def rate(self) -> float:
        """Return the rate of the stored samples, 0 if there are too few [Hz]."""
        stamps = self._samples.rows['stamp_ns']
        if len(stamps) < FEWEST:
            return 0.0
        return SECOND / float(np.median(np.diff(stamps)))

    def missing_since(self, begin_ns: int) -> int:
        """Count the samples that are missing since a time, compared with an even rate."""
        intervals = np.diff(self.samples(begin_ns)['stamp_ns'])
        if len(intervals) < FEWEST:
            return 0
        return int((np.rint(intervals / np.median(intervals)) - 1.0).clip(0.0).sum())

    def add_samples(self, samples: Sequence[Sample], now_ns: int) -> list[Sample]:
        """Add samples in their order of arrival, count refused ones, and return the added ones."""
        added = []
        for sample in samples:
            reason = self._refusal(sample, now_ns)
            if reason:
                self.counts.refused[reason] += 1
                continue
            added.append(sample)
            self._samples.insert(sample)
            self.counts.out_of_order += sample.stamp_ns < self.newest_ns
            self.newest_ns = max(self.newest_ns, sample.stamp_ns)
        self.counts.taken += len(added)
        return added

    def _refusal(self, sample: Sample, now_ns: int) -> str:
        stamp_ns, plate, projectile = sample
        if not math.isfinite(plate) or math.isinf(projectile):
            return 'not finite'
        if max(abs(plate), abs(projectile)) > FARTHEST:
            return 'out of range'
        if stamp_ns > now_ns + FUTURE:
            return 'future'
        if stamp_ns < now_ns - PAST:
            return 'past'
        if stamp_ns > self.newest_ns:
            return ''
        if len(self._samples.between(stamp_ns, stamp_ns + 1)):
            return 'doubled'
        return 'late' if stamp_ns <= self.complete_ns else ''

    def _complete(self, until_ns: int) -> None:
        """Leave out the outliers among the samples that are complete now."""
        buffer = self._samples
        first = buffer.index(self.complete_ns + 1)
        self.complete_ns = max(self.complete_ns, until_ns)
        new = buffer.rows[first:buffer.index(until_ns + 1)]
        if not len(new):
            return
        assert self.origin_ns is not None
        times = seconds_since(self.origin_ns, new)
        positions = np.stack((new['plate'], new['projectile']), axis=1)
        is_outlier = self._outlier_filter.find(times, positions)
        count = len(is_outlier)
        if count < len(new):  # the last sample waits for the next one
            self.complete_ns = int(new['stamp_ns'][-1]) - 1
        outliers = int(is_outlier.any(axis=1).sum())
        if outliers:
            self.outliers += outliers
            self.counts.outliers += outliers
            new['projectile'][:count][is_outlier[:, 1]] = math.nan
            buffer.remove(first, is_outlier[:, 0])

    def advance(self, now_ns: int) -> PlateStates:
        """Return the motion since the last call, up to the latest known time."""
        if not len(self._samples):
            return NO_STATES
        if self.origin_ns is None:
            self.origin_ns = int(self._samples.rows['stamp_ns'][0])
        config, spacing_ns = self.config, state_spacing_ns(self.config)
        behind_ns = round(BEHIND * config.smoothing_window_ns)
        ahead_ns = round(AHEAD * config.smoothing_window_ns)
        self._complete(min(int(self.newest_ns), now_ns) - config.latency_ns)
        end = (int(self.complete_ns) - ahead_ns - self.origin_ns) // spacing_ns + 1
        begin = max(self._next, end - _LONGEST_STEP)
        if begin >= end:
            return NO_STATES
        self._next = end
        begin_ns = self.origin_ns + spacing_ns * begin - behind_ns
        end_ns = self.origin_ns + spacing_ns * (end - 1) + ahead_ns
        last_end_ns, self._smoothed_ns = self._smoothed_ns, end_ns
        first = max(self._samples.index(begin_ns) - 1, 0)
        rows = self._samples.rows[first:self._samples.index(end_ns + 1)]
        self._samples.drop_before(end_ns - _KEPT_WINDOWS * config.smoothing_window_ns)
        if len(rows) < FEWEST:
            return NO_STATES
        stamps = rows['stamp_ns']
        is_new = stamps[1:] > last_end_ns
        gap_ns = int(np.diff(stamps)[is_new].max()) if is_new.any() else 0
        motion = self._smooth(spacing_ns * np.arange(begin, end) / SECOND, rows)
        return motion._replace(gap=gap_ns / SECOND)

    def _smooth(self, times: Floats, rows: Rows) -> PlateStates:
        """Return the smoothed motion at times since the origin, where samples suffice."""
        assert self.origin_ns is not None
        noise = self.config.position_noise
        states, errors = np.empty((times.size, 3)), np.empty(times.size)
        fit_cubics(
            times,
            seconds_since(self.origin_ns, rows),
            rows['plate'].copy(),
            0.5 * self.config.smoothing_window,
            states,
            errors,
        )
        known = np.isfinite(errors)
        return PlateStates(times[known], states[known], noise * errors[known])
