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
"""
From samples of a rig, as they come, to the motion of its plate.

Samples are put in the order of their stamps. What is older than the newest stamp by more than the
time to wait for stragglers (the watermark) is complete, and is smoothed there, see
`soft_throw_ros.core.smoothing`, at times an eighth of the window apart. So the plate is known up
to a quarter of the window, the time to wait and at most an eighth of the window behind the newest
sample. What comes for a time that is complete already is late, and is refused.

Complete samples are held against where those before them say that the plate must be: a body that
is not accelerated by much more than the engine can do gets no farther. Those that have
jumped are left out, see `jump_filter`.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration.twin_config import MeasurementConfig
from soft_throw_ros.core.smoothing import AHEAD, BEHIND, FEWEST, fit_cubics
from soft_throw_ros.twin.jump_filter import JumpFilter
from soft_throw_ros.twin.tick_schedule import SECOND

Floats = NDArray[np.float64]

FUTURE = SECOND // 10  # how far ahead of the clock a stamp may be [ns]
PAST = SECOND  # how far behind the clock a stamp may be [ns]
FARTHEST, FASTEST = 100.0, 1000.0  # heights [m], velocities [m/s] that no rig goes beyond
PER_CROSSING, PER_PERIOD = 3, 20  # fewest samples in a crossing of the wave, and a plate period
STATES_PER_WINDOW = 8  # times at which the plate is smoothed, in a window
_KEPT_WINDOWS = 16  # for which samples are kept: rest, start, and some reserve
_LONGEST_STEP = 1000  # times that are smoothed at once; what is before them is given up


class Sample(NamedTuple):
    """What was measured at a time."""

    stamp_ns: int  # when [ns]
    plate: float  # height [m]
    plate_velocity: float = math.nan  # or NaN [m/s]
    projectile: float = math.nan  # height, or NaN [m]


class PlateStates(NamedTuple):
    """Motion of the plate, smoothed."""

    times: Floats  # since the origin of the estimator, shape (n,) [s]
    states: Floats  # height [m], velocity [m/s], acceleration [m/s2], shape (n, 3)
    errors: Floats  # standard errors of the velocity, shape (n,) [m/s]
    gap: float = 0.0  # longest time between samples on the way here [s]


NO_STATES = PlateStates(np.empty(0), np.empty((0, 3)), np.empty(0))


def state_spacing_ns(config: MeasurementConfig) -> int:
    """Return the time between those at which the plate is smoothed [ns]."""
    return config.smoothing_window_ns // STATES_PER_WINDOW


def least_rate(config: MeasurementConfig, crossing_time: float) -> tuple[float, str]:
    """Return the lowest rate of samples that will do, and why [Hz]."""
    return max(
        (PER_CROSSING / crossing_time, f'{PER_CROSSING} in a crossing of the wave'),
        (PER_PERIOD * config.plate.frequency, f'{PER_PERIOD} in a period of the plate'),
        (FEWEST / config.smoothing_window, f'{FEWEST} in measured.window'),
    )


class PlateEstimator:
    """
    Samples in their order, and the motion of the plate through them.

    Parameters
    ----------
    config : MeasurementConfig
        How they are taken.
    origin_ns : int, optional
        Time 0; that of the first sample if not given. [ns]
    samples : sequence of Sample
        That have been taken already, in their order.
    refused : Counter of str, optional
        Where samples that are refused are counted, by reason: 'not finite', 'out of range',
        'future', 'past', 'doubled' and 'late'.

    Attributes
    ----------
    jumped : int
        Samples that were taken, and left out since plate or projectile cannot have been there.
    newest_ns : float
        Stamp of the newest sample, minus infinity if there is none. [ns]
    complete_ns : float
        Until when samples are complete, by the last call of `advance`. [ns]

    """

    def __init__(
        self,
        config: MeasurementConfig,
        *,
        origin_ns: int | None = None,
        samples: Sequence[Sample] = (),
        refused: Counter[str] | None = None,
    ) -> None:
        self.config = config
        self.origin_ns = origin_ns
        self.refused: Counter[str] = Counter() if refused is None else refused
        self._samples = list(samples)
        self.newest_ns = samples[-1].stamp_ns if samples else -math.inf
        self._next = 0  # time at which to smooth, in spacings
        self.jumped = 0
        self.complete_ns = -math.inf
        self._smoothed_ns = -math.inf  # what is not later has been in a window
        plate = config.plate
        acceleration = plate.amplitude * (2.0 * math.pi * plate.frequency) ** 2
        self._plate_filter = JumpFilter(acceleration, config.position_noise)
        self._projectile_filter = JumpFilter(acceleration, config.position_noise)

    def samples(self, begin_ns: float, end_ns: float = math.inf) -> list[Sample]:
        """Return the samples from one time to before another, as far back as they are kept."""
        first = bisect_left(self._samples, (begin_ns,))
        last = bisect_left(self._samples, (end_ns,))
        return self._samples[first:last]

    def rate(self) -> float:
        """Return the rate of the samples that are kept, 0 if there are too few to tell [Hz]."""
        stamps = [sample.stamp_ns for sample in self._samples]
        if len(stamps) < FEWEST:
            return 0.0
        return SECOND / float(np.median(np.diff(stamps)))

    def take(self, samples: Sequence[Sample], now_ns: int) -> list[Sample]:
        """Take samples in the order in which they came, or refuse and count them."""
        taken = []
        for sample in samples:
            reason = self._refusal(sample, now_ns)
            if reason:
                self.refused[reason] += 1
                continue
            taken.append(sample)
            if sample.stamp_ns > self.newest_ns:
                self._samples.append(sample)
                self.newest_ns = sample.stamp_ns
            else:
                self._samples.insert(bisect_left(self._samples, sample), sample)
        return taken

    def _refusal(self, sample: Sample, now_ns: int) -> str:
        stamp_ns, plate, velocity, projectile = sample
        if not math.isfinite(plate) or math.isinf(velocity) or math.isinf(projectile):
            return 'not finite'
        if max(abs(plate), abs(projectile)) > FARTHEST or abs(velocity) > FASTEST:
            return 'out of range'
        if stamp_ns > now_ns + FUTURE:
            return 'future'
        if stamp_ns < now_ns - PAST:
            return 'past'
        if stamp_ns > self.newest_ns:
            return ''
        index = bisect_left(self._samples, (stamp_ns,))
        if index < len(self._samples) and self._samples[index].stamp_ns == stamp_ns:
            return 'doubled'
        return 'late' if stamp_ns <= self.complete_ns else ''

    def _complete(self, until_ns: int) -> None:
        """Leave out what has jumped of the samples that are complete now."""
        first = bisect_left(self._samples, (self.complete_ns + 1,))
        end = bisect_left(self._samples, (until_ns + 1,))
        self.complete_ns = max(self.complete_ns, until_ns)
        new = self._samples[first:end]
        if not new:
            return
        assert self.origin_ns is not None
        count, origin_ns = len(new), self.origin_ns
        times, plates, tops = np.array(
            [((stamp_ns - origin_ns) / SECOND, at, top) for stamp_ns, at, _, top in new]
        ).T.copy()
        out, top_out = np.zeros((2, count), dtype=np.bool_)
        plate_filter, top_filter = self._plate_filter, self._projectile_filter
        plate_filter.judge(times, plates, count - 1, out)
        top_filter.judge(times, tops, count - 1, top_out)
        last = times[-1:], plates[-1:], tops[-1:]
        if plate_filter.is_doubtful(times[-1], plates[-1]) or top_filter.is_doubtful(
            times[-1], tops[-1]
        ):  # the next one will tell
            self.complete_ns, end, count = new[-1].stamp_ns - 1, end - 1, count - 1
        else:
            plate_filter.judge(last[0], last[1], 1, out[-1:])
            top_filter.judge(last[0], last[2], 1, top_out[-1:])
        if not (out[:count].any() or top_out[:count].any()):
            return
        self.jumped += int((out | top_out)[:count].sum())
        self._samples[first:end] = [
            sample._replace(projectile=math.nan) if top_out[k] else sample
            for k, sample in enumerate(new[:count])
            if not out[k]
        ]

    def advance(self, now_ns: int) -> PlateStates:
        """Return the motion since the last call, as far as it is known."""
        if not self._samples:
            return NO_STATES
        if self.origin_ns is None:
            self.origin_ns = self._samples[0].stamp_ns
        config, spacing = self.config, state_spacing_ns(self.config)
        behind = round(BEHIND * config.smoothing_window_ns)
        ahead = round(AHEAD * config.smoothing_window_ns)
        complete_ns = min(int(self.newest_ns), now_ns) - config.wait_ns
        self._complete(complete_ns)
        end = (int(self.complete_ns) - ahead - self.origin_ns) // spacing + 1
        begin = max(self._next, end - _LONGEST_STEP)
        if begin >= end:
            return NO_STATES
        self._next = end
        at_ns = self.origin_ns + spacing * np.arange(begin, end)
        first = bisect_left(self._samples, (at_ns[0] - behind,))
        last = bisect_left(self._samples, (at_ns[-1] + ahead + 1,))
        before = max(first - 1, 0)
        samples = self._samples[before:last]
        before_ns, self._smoothed_ns = self._smoothed_ns, int(at_ns[-1]) + ahead
        kept_ns = self._smoothed_ns - _KEPT_WINDOWS * config.smoothing_window_ns
        del self._samples[: bisect_left(self._samples, (kept_ns,))]
        if len(samples) < FEWEST:
            return NO_STATES
        stamps = [sample.stamp_ns for sample in samples]
        gap_ns = max(
            (later - earlier for earlier, later in pairwise(stamps) if later > before_ns),
            default=0,
        )
        _, plate, velocity, _ = np.array(samples).T
        at = (at_ns - self.origin_ns) / SECOND
        times = (np.array(stamps) - self.origin_ns) / SECOND
        states, errors = np.empty((at.size, 3)), np.empty(at.size)
        ratio = config.position_noise / config.velocity_noise
        fit_cubics(
            at,
            times,
            plate.copy(),
            velocity.copy(),
            0.5 * config.smoothing_window,
            ratio,
            states,
            errors,
        )
        known = np.isfinite(errors)
        return PlateStates(
            at[known], states[known], config.position_noise * errors[known], gap_ns / SECOND
        )
