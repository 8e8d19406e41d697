# SPDX-License-Identifier: Apache-2.0
"""
From samples of a rig, as they come, to the motion of its plate.

Samples are put in the order of their stamps. What is older than the newest stamp by more than the
time to wait for stragglers (the watermark) is complete, and is smoothed there, see
`soft_throw_ros.core.smoothing`, at times an eighth of the window apart. So the plate is known up
to a quarter of the window, the time to wait and at most an eighth of the window behind the newest
sample. What comes for a time that has been smoothed already is late, and is refused.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize_scalar
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.smoothing import AHEAD, BEHIND, FEWEST, fit_cubics

Floats = NDArray[np.float64]

SECOND = 1_000_000_000
"""[ns]"""

FUTURE = SECOND // 10
"""How far ahead of the clock a stamp may be. [ns]"""

PAST = SECOND
"""How far behind the clock a stamp may be. [ns]"""

FARTHEST, FASTEST = 100.0, 1000.0
"""Heights [m] and velocities [m/s] beyond which no rig goes, whatever its sensors say."""

REST_WINDOWS = 8
"""So many windows the plate must be at rest before a throw."""

RISE = 0.125
"""Part of the plate's period in which it gets to the speed of a start. [-]"""

PER_CROSSING, PER_PERIOD = 3, 20
"""Fewest samples while a wave crosses the layer, and in a period of the plate."""

_PER_WINDOW = 8  # times at which the plate is smoothed
_KEPT_WINDOWS = 16  # for which samples are kept: rest, start, and some reserve
_LONGEST_STEP = 1000  # times that are smoothed at once; what is before them is given up
_SURE, _QUIET = 6.0, 4.0  # standard errors that are no noise, and that are nothing else


class Sample(NamedTuple):
    """
    What was measured at a time.

    Attributes
    ----------
    stamp_ns : int
        When. [ns]
    plate, plate_velocity : float
        Height [m], and velocity [m/s] or NaN.
    projectile : float
        Height of the projectile, or NaN. [m]

    """

    stamp_ns: int
    plate: float
    plate_velocity: float = math.nan
    projectile: float = math.nan


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """
    How measurements are taken.

    Parameters
    ----------
    window_ns : int
        Over which the plate is smoothed. [ns]
    wait_ns : int
        For stragglers. [ns]
    position_noise, velocity_noise : float
        Standard deviations. [m], [m/s]
    start_speed : float
        Of the plate, upwards, at which a throw has begun. [m/s]
    band : float
        How far the projectile may be off the model, rms. [m]
    plate : Underdamped
        About how it moves then.

    """

    window_ns: int
    wait_ns: int
    position_noise: float
    velocity_noise: float
    start_speed: float
    band: float
    plate: Underdamped

    @classmethod
    def of(cls, settings: Settings, plate: Underdamped) -> Tuning:
        """Take it from the parameters."""
        return cls(
            window_ns=round(settings['measured.window'] * SECOND),
            wait_ns=round(settings['measured.wait'] * SECOND),
            position_noise=settings['measured.position_noise'],
            velocity_noise=settings['measured.velocity_noise'],
            start_speed=settings['measured.start'] * plate.peak_velocity,
            band=settings['measured.band'],
            plate=plate,
        )

    @property
    def spacing_ns(self) -> int:
        """Time between those at which the plate is smoothed. [ns]"""
        return self.window_ns // _PER_WINDOW

    @property
    def window(self) -> float:
        """Over which the plate is smoothed. [s]"""
        return self.window_ns / SECOND

    def least_rate(self, crossing_time: float) -> tuple[float, str]:
        """Return the lowest rate of samples that will do, and why. [Hz]"""
        return max(
            (PER_CROSSING / crossing_time, f'{PER_CROSSING} in a crossing of the wave'),
            (PER_PERIOD * self.plate.frequency, f'{PER_PERIOD} in a period of the plate'),
            (FEWEST / self.window, f'{FEWEST} in measured.window'),
        )


class Nodes(NamedTuple):
    """
    Motion of the plate, smoothed.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Since the origin of the track. [s]
    states : ndarray, shape (n, 3)
        Height [m], velocity [m/s], acceleration [m/s2].
    errors : ndarray, shape (n,)
        Standard errors of the velocity. [m/s]
    gap : float
        Longest time between samples on the way here. [s]

    """

    times: Floats
    states: Floats
    errors: Floats
    gap: float = 0.0


_NOTHING = Nodes(np.empty(0), np.empty((0, 3)), np.empty(0))


class Track:
    """
    Samples in their order, and the motion of the plate through them.

    Parameters
    ----------
    tuning : Tuning
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
    tuning, origin_ns, refused
        As above.

    """

    def __init__(
        self,
        tuning: Tuning,
        *,
        origin_ns: int | None = None,
        samples: Sequence[Sample] = (),
        refused: Counter[str] | None = None,
    ) -> None:
        self.tuning = tuning
        self.origin_ns = origin_ns
        self.refused: Counter[str] = Counter() if refused is None else refused
        self._samples = list(samples)
        self._next = 0  # node
        self._used_ns = -math.inf  # what is not later has been used

    @property
    def newest_ns(self) -> float:
        """Stamp of the newest sample, minus infinity if there is none. [ns]"""
        return self._samples[-1].stamp_ns if self._samples else -math.inf

    def samples(self, begin_ns: float, end_ns: float = math.inf) -> list[Sample]:
        """Return the samples from one time to before another, as far back as they are kept."""
        first = bisect_left(self._samples, (begin_ns,))
        last = bisect_left(self._samples, (end_ns,))
        return self._samples[first:last]

    def rate(self) -> float:
        """Return the rate of the samples that are kept, 0 if there are too few to tell. [Hz]"""
        stamps = [sample.stamp_ns for sample in self._samples]
        if len(stamps) < FEWEST:
            return 0.0
        return SECOND / float(np.median(np.diff(stamps)))

    def take(self, samples: Sequence[Sample], now_ns: int) -> list[Sample]:
        """
        Take samples, or refuse and count them.

        Parameters
        ----------
        samples : sequence of Sample
            In the order in which they came.
        now_ns : int
            By the clock that they are stamped by. [ns]

        Returns
        -------
        list of Sample
            Those that were taken.

        """
        taken = []
        for sample in samples:
            reason = self._refusal(sample, now_ns)
            if reason:
                self.refused[reason] += 1
                continue
            taken.append(sample)
            if sample.stamp_ns > self.newest_ns:
                self._samples.append(sample)
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
        place = bisect_left(self._samples, (stamp_ns,))
        if place < len(self._samples) and self._samples[place].stamp_ns == stamp_ns:
            return 'doubled'
        return 'late' if stamp_ns <= self._used_ns else ''

    def advance(self, now_ns: int) -> Nodes:
        """Return the motion since the last call, as far as it is known."""
        if not self._samples:
            return _NOTHING
        if self.origin_ns is None:
            self.origin_ns = self._samples[0].stamp_ns
        tuning, spacing = self.tuning, self.tuning.spacing_ns
        behind, ahead = round(BEHIND * tuning.window_ns), round(AHEAD * tuning.window_ns)
        complete_ns = min(self._samples[-1].stamp_ns, now_ns) - tuning.wait_ns
        end = (complete_ns - ahead - self.origin_ns) // spacing + 1
        begin = max(self._next, end - _LONGEST_STEP)
        if begin >= end:
            return _NOTHING
        self._next = end
        at_ns = self.origin_ns + spacing * np.arange(begin, end)
        first = bisect_left(self._samples, (at_ns[0] - behind,))
        last = bisect_left(self._samples, (at_ns[-1] + ahead + 1,))
        samples = self._samples[max(first - 1, 0) : last]
        before_ns, self._used_ns = self._used_ns, int(at_ns[-1]) + ahead
        kept_ns = self._used_ns - _KEPT_WINDOWS * tuning.window_ns
        del self._samples[: bisect_left(self._samples, (kept_ns,))]
        if len(samples) < FEWEST:
            return _NOTHING
        stamps = [sample.stamp_ns for sample in samples]
        gap_ns = max(
            (later - earlier for earlier, later in pairwise(stamps) if later > before_ns),
            default=0,
        )
        _, plate, velocity, _ = np.array(samples).T
        at = (at_ns - self.origin_ns) / SECOND
        times = (np.array(stamps) - self.origin_ns) / SECOND
        states, errors = np.empty((at.size, 3)), np.empty(at.size)
        ratio = tuning.position_noise / tuning.velocity_noise
        fit_cubics(
            at,
            times,
            plate.copy(),
            velocity.copy(),
            0.5 * tuning.window,
            ratio,
            states,
            errors,
        )
        known = np.isfinite(errors)
        return Nodes(
            at[known], states[known], tuning.position_noise * errors[known], gap_ns / SECOND
        )


@dataclass(frozen=True, kw_only=True)
class Departure:
    """
    The plate has begun to move.

    Parameters
    ----------
    onset_ns : int
        When, which is when the throw starts. [ns]
    plate_rest, projectile_rest : float
        Where they were measured before; NaN if the projectile was not. [m]
    samples : tuple of Sample
        What has been taken, in order, from a window before on.

    """

    onset_ns: int
    plate_rest: float
    projectile_rest: float
    samples: tuple[Sample, ...]


class Watch:
    r"""
    Waits for the plate to come to rest, and then for it to jump up.

    Parameters
    ----------
    track : Track
        Of the plate.

    Attributes
    ----------
    is_armed : bool
        Whether the plate has been at rest.

    Notes
    -----
    The plate is at rest when for `REST_WINDOWS` windows it has not been faster than half of the
    speed of a start, or four standard errors, and no more when it has been for `RISE` of its
    period. A throw has begun when it goes upwards at that speed, and at six standard errors of
    it. The time of the start is found a window later, see `find_start`.

    """

    def __init__(self, track: Track) -> None:
        self._track = track
        self._restless = -math.inf  # when the plate was last too fast to be at rest, ...
        self._quiet = -math.inf  # and when it was not
        self._begun = math.inf  # when it was fast enough to have started
        self._first = math.nan  # when it was seen first
        self._rise_time = RISE / track.tuning.plate.frequency
        self.is_armed = False

    def see(self, nodes: Nodes) -> Departure | None:
        """Take in how the plate moves, and tell if it has begun to."""
        window = self._track.tuning.window
        start = self._track.tuning.start_speed
        if nodes.gap > window:
            self._first, self._begun = math.nan, math.inf
            self.is_armed = False
            return None
        for time, (height, speed, _), error in zip(
            nodes.times.tolist(), nodes.states.tolist(), nodes.errors.tolist(), strict=True
        ):
            if math.isnan(self._first):
                self._first = self._restless = time
            if self._begun < math.inf:
                if time >= self._begun + window:
                    begun, self._begun = self._begun, math.inf
                    self.is_armed = False
                    self._restless = time
                    departure = self._departure(begun, time, height, speed)
                    if departure is not None:
                        return departure
            elif self.is_armed and speed > max(start, _SURE * error):
                self._begun = time
            elif abs(speed) > max(0.5 * start, _QUIET * error):
                self._restless = time
                self.is_armed = self.is_armed and time - self._quiet <= self._rise_time
            else:
                self._quiet = time
                if time - self._restless >= REST_WINDOWS * window:
                    self.is_armed = True
        return None

    def _departure(
        self, begun: float, time: float, height: float, speed: float
    ) -> Departure | None:
        """Find when the plate started, if it goes on going up."""
        track, tuning = self._track, self._track.tuning
        assert track.origin_ns is not None
        begun_ns = track.origin_ns + round(begun * SECOND)
        at_rest = track.samples(
            begun_ns - REST_WINDOWS * tuning.window_ns, begun_ns - tuning.window_ns
        )
        if not at_rest or speed <= tuning.start_speed:
            return None
        _, plate, _, projectile = np.array(at_rest).T
        plate_rest = float(plate.mean())
        measured = projectile[np.isfinite(projectile)]
        since = time_since_start(height - plate_rest, speed, tuning.plate)
        onset_ns = track.origin_ns + round((time - since) * SECOND)
        onset_ns += find_start(track.samples(at_rest[-1].stamp_ns), onset_ns, plate_rest, tuning)
        if len(track.samples(onset_ns + 1, onset_ns + tuning.window_ns)) < FEWEST - 1:
            return None
        return Departure(
            onset_ns=onset_ns,
            plate_rest=plate_rest,
            projectile_rest=float(measured.mean()) if measured.size else math.nan,
            samples=tuple(track.samples(onset_ns - tuning.window_ns)),
        )


def first_states(departure: Departure, tuning: Tuning) -> tuple[Floats, Floats]:
    r"""
    Return how the plate has started, for as long as a window would reach to before that.

    Parameters
    ----------
    departure : Departure
        Of the plate.
    tuning : Tuning
        How it is measured.

    Returns
    -------
    times : ndarray, shape (n,)
        Since the start, the first 0. [s]
    states : ndarray, shape (n, 3)
        Height above rest [m], velocity [m/s], acceleration [m/s2].

    Notes
    -----
    No cubic goes round the corner where the plate starts, at which its acceleration jumps. So the
    first window after it is fitted apart, by an underdamped start from rest whose size changes
    linearly, :math:`(p + q t) z(t)`, by least squares.

    """
    plate, ratio = tuning.plate, tuning.position_noise / tuning.velocity_noise
    first = [
        sample
        for sample in departure.samples
        if 0 < sample.stamp_ns - departure.onset_ns <= tuning.window_ns
    ]
    since = np.array([sample.stamp_ns - departure.onset_ns for sample in first]) / SECOND
    heights = np.array([sample.plate for sample in first]) - departure.plate_rest
    speeds = np.array([sample.plate_velocity for sample in first])
    measured = np.isfinite(speeds)
    position, velocity = plate.position(since), plate.velocity(since)
    sizes = np.concatenate((position, ratio * velocity[measured]))
    slopes = np.concatenate((since * position, ratio * (position + since * velocity)[measured]))
    values = np.concatenate((heights, ratio * speeds[measured]))
    a, b, c = (sizes * sizes).sum(), (sizes * slopes).sum(), (slopes * slopes).sum()
    right, below = (sizes * values).sum(), (slopes * values).sum()
    determinant = a * c - b * b
    p, q = (c * right - b * below) / determinant, (a * below - b * right) / determinant

    times = np.arange(round(BEHIND * _PER_WINDOW)) * (tuning.spacing_ns / SECOND)
    z, v = plate.position(times), plate.velocity(times)
    omega = 2.0 * math.pi * plate.frequency
    acceleration: Floats = omega**2 * (plate.amplitude - z) - 2.0 * plate.damping_ratio * omega * v
    size = p + q * times
    states = np.stack((size * z, size * v + q * z, size * acceleration + 2.0 * q * v), axis=1)
    return np.asarray(times), states


def time_since_start(height: float, speed: float, plate: Underdamped) -> float:
    r"""
    Find how long ago an underdamped plate started, whatever its amplitude.

    Its height over its speed is the same at one time only: without damping, that is
    :math:`\arctan(2 \pi f z / v) / \pi f`.

    Parameters
    ----------
    height, speed : float
        Of the plate, going up for the first time. [m], [m/s]
    plate : Underdamped
        Of the same frequency and damping.

    Returns
    -------
    float
        At most until the plate is highest. [s]

    Examples
    --------
    >>> plate = Underdamped(frequency=63.2, amplitude=1.0, damping_ratio=0.064)
    >>> round(time_since_start(3.0 * plate.position(2e-3), 3.0 * plate.velocity(2e-3), plate), 9)
    0.002

    """
    highest = math.pi / plate.exponent.imag
    ratio = max(height, 0.0) / speed
    if ratio == 0.0:
        return 0.0

    def excess(time: float) -> float:
        return float(plate.position(time) - ratio * plate.velocity(time))

    # until it is fastest, the plate has come less far than it would have at its speed now
    return float(brentq(excess, min(ratio, plate.peak_velocity_time), highest, xtol=1e-12))


def find_start(samples: Sequence[Sample], onset_ns: int, plate_rest: float, tuning: Tuning) -> int:
    """
    Find when the plate has started, by least squares.

    Parameters
    ----------
    samples : sequence of Sample
        From before the start to about a window after it.
    onset_ns : int
        First guess, to a quarter of the window. [ns]
    plate_rest : float
        Height before the start. [m]
    tuning : Tuning
        How the plate is measured, and moves but for its amplitude.

    Returns
    -------
    int
        How much later than `onset_ns`. [ns]

    """
    since = np.array([sample.stamp_ns - onset_ns for sample in samples]) / SECOND
    heights = np.array([sample.plate for sample in samples]) - plate_rest

    def misfit(later: float) -> float:
        shape = tuning.plate.position(since - later)
        size = (shape * heights).sum() / (shape * shape).sum()
        return float(((heights - size * shape) ** 2).sum())

    reach = 0.25 * tuning.window
    best = minimize_scalar(
        misfit, bounds=(-reach, reach), method='bounded', options={'xatol': 1e-8}
    )
    return round(float(best.x) * SECOND)


def peak_speed(times: Sequence[float], speeds: Sequence[float], period: float) -> float:
    """
    Find the largest of noisy speeds, by a parabola through those around it.

    Parameters
    ----------
    times, speeds : sequence of float
        Of the plate. [s], [m/s]
    period : float
        Of the plate: the parabola goes through an eighth of it. [s]

    """
    time, speed = np.array(times), np.array(speeds)
    largest = int(np.argmax(speed))
    since = time - time[largest]
    near = np.abs(since) <= period / 16.0
    if near.sum() < 5 or since[-1] < period / 16.0:
        return float(speed[largest])
    c, b, a = np.polyfit(since[near], speed[near], 2).tolist()
    return a - 0.25 * b * b / c if c < 0.0 else float(speed[largest])
