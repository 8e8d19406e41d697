# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The motion of a measured plate, estimated from samples as they arrive.

Samples are sorted by their stamps. Samples older than the newest stamp by more than
`measured.latency` (the watermark) are complete, and are smoothed at times an eighth of the window
apart, see `soft_throw_ros.core.smoothing`. The plate is therefore known up to a quarter of the
window, the latency and at most an eighth of the window before the newest sample. Samples that
arrive for a complete time are late, and are refused.

Outliers among complete samples are left out, see `outlier_filter`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import Enum
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.kernels import kernel
from soft_throw_ros.core.smoothing import AHEAD, FEWEST, fit_cubics
from soft_throw_ros.twin.outlier_filter import OutlierFilter
from soft_throw_ros.twin.sample_buffer import LONG_AGO, SampleBuffer, Samples
from soft_throw_ros.twin.tick_schedule import SECOND

Floats = NDArray[np.float64]

REASONS = ('not finite', 'out of range', 'future', 'past', 'doubled', 'late')
"""Why a sample is refused."""

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
    refused: Counter[str] = field(default_factory=Counter)  # by `REASONS` and those of messages


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
    samples: Samples  # sorted, from a window before the start on
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
    counts : SampleCounts
        Counts of samples, which the estimator updates.
    origin_ns : int, optional
        Time 0; by default the stamp of the first sample. [ns]
    samples : Samples, optional
        Samples that have been accepted already, sorted.

    """

    def __init__(
        self,
        config: MeasurementConfig,
        counts: SampleCounts,
        *,
        origin_ns: int | None = None,
        samples: Samples | None = None,
    ) -> None:
        self.config = config
        self.origin_ns = origin_ns
        self.counts = counts
        self._buffer = SampleBuffer(samples or Samples.of([]))
        self.newest_ns = int(samples.stamps[-1]) if samples else LONG_AGO  # newest stamp [ns]
        self.outliers = 0  # accepted samples that were left out later
        self.complete_ns = LONG_AGO  # time until which samples are complete [ns]
        self._next = 0  # next time to estimate, in spacings
        self._outlier_filter = OutlierFilter(
            config.plate, config.position_noise, config.stamp_error
        )

    def samples(self, begin_ns: int = LONG_AGO, end_ns: int | None = None) -> Samples:
        """Return the stored samples from one time to before another."""
        return self._buffer.between(begin_ns, end_ns)

    def rest_before(self, end_ns: int) -> RestBaseline | None:
        """Return the rest of some windows before a time; None if there are too few samples."""
        window_ns = self.config.smoothing_window_ns
        samples = self.samples(end_ns - (REST_WINDOWS - 1) * window_ns, end_ns)
        if len(samples) < FEWEST:
            return None
        plate, projectile = samples.plate, samples.projectile
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
        stamps = self._buffer.samples.stamps
        if len(stamps) < FEWEST:
            return 0.0
        return SECOND / float(np.median(np.diff(stamps)))

    def missing_since(self, begin_ns: int) -> int:
        """Count the samples that are missing since a time, compared with an even rate."""
        intervals = np.diff(self.samples(begin_ns).stamps)
        if len(intervals) < FEWEST:
            return 0
        return int((np.rint(intervals / np.median(intervals)) - 1.0).clip(0.0).sum())

    def add_samples(self, samples: Samples, now_ns: int) -> Samples:
        """Add samples in their order of arrival, count refused ones, and return the added ones."""
        counts, refusals = self.counts, np.zeros(len(samples), np.int64)
        known = self._buffer.samples.stamps
        late, self.newest_ns = _check(
            samples.stamps, samples.heights, known, now_ns, self.newest_ns, self.complete_ns,
            refusals,
        )
        counts.out_of_order += late
        if refusals.any():
            counts.refused.update(REASONS[number - 1] for number in refusals[refusals > 0])
            samples = samples[refusals == 0]
        self._buffer.add(samples)
        counts.taken += len(samples)
        return samples

    def _complete(self, until_ns: int) -> float:
        """Leave out the outliers among the samples that are complete now; return their gap [s]."""
        buffer = self._buffer
        first, last = buffer.index(self.complete_ns + 1), buffer.index(until_ns + 1)
        self.complete_ns = max(self.complete_ns, until_ns)
        if first >= last:
            return 0.0
        assert self.origin_ns is not None
        new = buffer.samples[first:last]
        is_outlier = self._outlier_filter.find(new.seconds_since(self.origin_ns), new.heights)
        if is_outlier.any():
            outliers = int(is_outlier.any(axis=1).sum())
            self.outliers += outliers
            self.counts.outliers += outliers
            new.projectile[is_outlier[:, 1]] = math.nan
            buffer.remove(first, is_outlier[:, 0])
            last -= int(is_outlier[:, 0].sum())
        stamps = buffer.samples.stamps[max(first - 1, 0):last]
        return float((stamps[1:] - stamps[:-1]).max(initial=0)) / SECOND

    def advance(self, now_ns: int) -> PlateStates:
        """Return the motion since the last call, up to the latest known time."""
        buffer, config, spacing_ns = self._buffer, self.config, state_spacing_ns(self.config)
        if not len(buffer):
            return NO_STATES
        if self.origin_ns is None:
            self.origin_ns = int(buffer.samples.stamps[0])
        gap = self._complete(min(self.newest_ns, now_ns) - config.latency_ns)
        ahead_ns = round(AHEAD * config.smoothing_window_ns)
        end = (self.complete_ns - ahead_ns - self.origin_ns) // spacing_ns + 1
        begin = max(self._next, end - _LONGEST_STEP)
        buffer.drop_before(self.complete_ns - _KEPT_WINDOWS * config.smoothing_window_ns)
        if begin >= end:
            return NO_STATES._replace(gap=gap)
        self._next = end
        states, errors = np.empty((end - begin, 3)), np.empty(end - begin)
        times, rows = spacing_ns * np.arange(begin, end) / SECOND, buffer.samples
        since, half = rows.seconds_since(self.origin_ns), 0.5 * config.smoothing_window
        fit_cubics(times, since, rows.plate.copy(), half, states, errors)
        known = np.isfinite(errors)
        if not known.all():
            times, states, errors = times[known], states[known], errors[known]
        return PlateStates(times, states, config.position_noise * errors, gap)


@kernel
def _check(
    stamps: NDArray[np.int64],
    heights: Floats,
    known: NDArray[np.int64],
    now_ns: int,
    newest_ns: int,
    complete_ns: int,
    refusals: NDArray[np.int64],
) -> tuple[int, int]:
    """
    Write the numbers of the `REASONS` of refused samples, from 1.

    Return the number of others that are out of order, and the newest stamp.
    """
    late = 0
    for n in range(stamps.size):
        stamp, plate, projectile = stamps[n], heights[n, 0], heights[n, 1]
        index = np.searchsorted(known, stamp)
        is_doubled = index < known.size and known[index] == stamp
        for m in range(n):
            is_doubled |= refusals[m] == 0 and stamps[m] == stamp
        if not math.isfinite(plate) or math.isinf(projectile):
            refusals[n] = 1
        elif abs(plate) > FARTHEST or abs(projectile) > FARTHEST:
            refusals[n] = 2
        elif stamp > now_ns + FUTURE:
            refusals[n] = 3
        elif stamp < now_ns - PAST:
            refusals[n] = 4
        elif is_doubled:
            refusals[n] = 5
        elif stamp <= complete_ns:
            refusals[n] = 6
        else:
            late += stamp < newest_ns
            newest_ns = max(stamp, newest_ns)
    return late, newest_ns


def warm_up() -> None:
    """Compile or load the kernels."""
    samples = Samples.of([])
    _check(samples.stamps, samples.heights, samples.stamps, 0, 0, 0, samples.stamps)
