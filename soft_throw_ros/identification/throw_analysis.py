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
r"""
What a throw gave: ejection time and speed, plate speed, energy transfer (Sec. II A of the paper).

By running averages and centred differences, which need to know nothing of the layer; or from a
rig that was fitted, which is several times as exact if the model is right.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.identification.least_squares import Estimate, FitError
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.tracks import ThrowTracks, Track

Floats = NDArray[np.float64]

_WINDOW = 1.0 / 16.0  # of the running average, in plate periods
_SAMPLES_PER_PERIOD = 20  # of the plate at least
_FULL_SPEED = 0.97  # of the largest speed, at which the projectile leaves about now
_APPROACH = 0.16  # of the ejection speed: how much of the end of its rise is fitted, ...
_OTHER_APPROACHES = (0.12, 0.24)  # and what else one could have taken
_REPEATS = 100  # with other noise, for the errors
_MIN_FLIGHT_SAMPLES = 8
_SPEED_OVER_NOISE = 10.0  # that averages leave, at least
_MAX_TIME_ERROR = 0.125  # plate periods, beyond which the ejection is not determined, ...
_MAX_SPEED_ERROR = 0.25  # and of the speed
_JUMP_SHARE = 0.025  # of them with other echoes, from which on an interval of 95 % holds both
_DRAWS = 400  # of rigs that may be as well as the one that was fitted


@dataclass(frozen=True, kw_only=True)
class Ejection:
    r"""
    How the projectile left, with standard errors.

    Near a jump it may be another within the errors, which then are those of a choice between two:
    it jumps where it passes odd multiples of the crossing time.
    """

    time: Estimate
    r""":math:`t_e`, since the plate began to move. [s]"""
    speed: Estimate
    r""":math:`V_e`. [m/s]"""
    peak_plate_speed: Estimate
    r""":math:`V_p^*`. [m/s]"""
    energy_transfer: Estimate
    r""":math:`\alpha = (V_e / V_p^*)^2`. [-]"""
    is_near_jump: bool = False


class SeenPlate(NamedTuple):
    """What has to be known of a plate to say how a projectile left it."""

    start_time: Estimate
    """On the clock of the track. [s]"""
    period: float
    """[s]"""
    peak_speed: Estimate
    r""":math:`V_p^*`. [m/s]"""

    @classmethod
    def by_its_track(cls, track: Track) -> SeenPlate:
        """Fit a damped step, without a drift or ringing."""
        found = fit_plate(track)
        return cls(found.fit['start_time'], 1.0 / found.motion.frequency, found.peak_velocity)

    @classmethod
    def of(cls, found: RigFit, throw: int) -> SeenPlate:
        """Take it from a fit, which knows drift and ringing."""
        period = 1.0 / found.rig.engine.frequency
        return cls(found.start_time(throw), period, found.peak_plate_speed(throw))


def analyse_throw(
    tracks: ThrowTracks, *, gravity: float, plate: SeenPlate | None = None
) -> Ejection:
    r"""
    Find how the projectile left from running averages and centred differences.

    Parameters
    ----------
    tracks : ThrowTracks
        Of one throw, with a projectile, which is seen flying. The interval between samples may
        vary a little.
    gravity : float
        [m/s2]
    plate : SeenPlate, optional
        From a fit that knows more than the track of the plate alone, which may drift or ring.

    Raises
    ------
    FitError
        If the tracks do not show it, saying what is missing, or do not determine it.

    Notes
    -----
    Running averages take a sixteenth of a plate period. In flight the speed falls with gravity
    alone; before, it falls short of that by :math:`k (t_e - t)^2 / 2`, since the contact force
    vanishes at :math:`t_e`. That is fitted where it falls short by less than 16 %, and
    :math:`V_e` is the speed of the flight, taken back to :math:`t_e`; if the projectile was
    caught up in between, it is that of the last release. What is smooth is smoothed once more to
    see what that does, and that is taken back (twicing [1]_). :math:`V_p^*` is that of the motion
    that fits the plate (D4).

    Errors are the spread of results with other noise, half of what was taken back, and for
    :math:`t_e` the difference between fitting 12 % and 24 %.

    References
    ----------
    .. [1] J. W. Tukey, "Exploratory Data Analysis", Addison-Wesley (1977), ch. 16.

    """
    if tracks.projectile is None:
        raise FitError(f'{tracks.name}: there is no track of the projectile')
    plate = plate or SeenPlate.by_its_track(tracks.plate)
    period, interval = plate.period, tracks.projectile.interval
    if interval * _SAMPLES_PER_PERIOD > period:
        raise FitError(
            f'{tracks.name}: running averages need at least {_SAMPLES_PER_PERIOD} samples per '
            f'plate period ({period:.3g} s), got one every {interval:.3g} s'
        )
    projectile = tracks.projectile.without_spikes()
    averages = _RunningAverages(
        max(3, 2 * round(0.5 * _WINDOW * period / interval) + 1), period, gravity
    )
    try:
        found, taken_back = averages.measure_twice(projectile)
        others = [averages.measure(projectile, approach) for approach in _OTHER_APPROACHES]
    except FitError as error:
        raise FitError(f'{tracks.name}: {error}') from None
    doubt = (others[1] - others[0])[0]
    errors = np.hypot(averages.spread(projectile), 0.5 * taken_back)
    time_error = math.hypot(errors[0], doubt, plate.start_time.error)
    time = Estimate(float(found[0]) - plate.start_time.value, time_error)
    speed = Estimate(float(found[1]), math.hypot(errors[1], gravity * doubt))
    is_seen = time.value > 0.0 and time_error < _MAX_TIME_ERROR * period
    if not (is_seen and speed.error < _MAX_SPEED_ERROR * speed.value):
        raise FitError(
            f'{tracks.name}: the ejection is not determined by running averages, for noise: they '
            f'see it after {time} s, at {speed} m/s'
        )
    plate_speed = plate.peak_speed
    alpha = (speed.value / plate_speed.value) ** 2
    relative = math.hypot(speed.error / speed.value, plate_speed.error / plate_speed.value)
    return Ejection(
        time=time,
        speed=speed,
        peak_plate_speed=plate_speed,
        energy_transfer=Estimate(alpha, 2.0 * alpha * relative),
    )


class _RunningAverages(NamedTuple):
    """Averages over `width` samples at a time, of a throw with such a plate period."""

    width: int
    period: float
    gravity: float

    def measure_twice(self, projectile: Track) -> tuple[Floats, Floats]:
        """Measure after smoothing once, less what smoothing once more does; and that alone."""
        once = self.measure(projectile, _APPROACH)
        again = self.measure(self.smooth(projectile), _APPROACH)
        return 2.0 * once - again, once - again

    def spread(self, projectile: Track) -> Floats:
        """Measure how results vary with noise, by giving the smoothed track another one."""
        rng = np.random.default_rng(0)
        smooth = self.smooth(projectile)
        results = []
        for _ in range(_REPEATS):
            noise = rng.normal(0.0, smooth.noise, smooth.time.size)
            with contextlib.suppress(FitError):  # then the ejection is not to be seen
                noisy = replace(smooth, position=smooth.position + noise)
                results.append(self.measure_twice(noisy)[0])
        if len(results) < 0.5 * _REPEATS:
            return np.full(2, math.inf)
        return np.asarray(np.std(results, axis=0, ddof=1))

    def smooth(self, track: Track) -> Track:
        """Average."""
        if track.time.size < 4 * self.width:
            raise FitError(
                f'{track.time.size} samples are too few to average over {self.width} at a time'
            )
        kernel = np.full(self.width, 1.0 / self.width)
        return Track(
            time=np.convolve(track.time, kernel, 'valid'),
            position=np.convolve(track.position, kernel, 'valid'),
            known_noise=track.noise,
        )

    def measure(self, projectile: Track, approach: float) -> Floats:
        """Find when, on the clock of the track, and how fast the projectile leaves."""
        smooth = self.smooth(projectile)
        time, position = smooth.time, smooth.position
        speed = (position[2:] - position[:-2]) / (time[2:] - time[:-2])
        time, height = time[1:-1], position[1:-1]
        noise = projectile.noise / (self.width * projectile.interval)
        if speed.max() < _SPEED_OVER_NOISE * noise:
            raise FitError(
                f'the ejection is not determined by running averages: the projectile goes at '
                f'{speed.max():.2g} m/s at most, with a noise of {noise:.2g} m/s'
            )
        fastest = int(np.argmax(speed >= _FULL_SPEED * speed.max()))
        is_flight = time > time[fastest] + self.period / 8.0
        fallen = np.flatnonzero(is_flight & (height < height[fastest]))
        is_flight[fallen[0] if fallen.size else time.size:] = False
        if is_flight.sum() < _MIN_FLIGHT_SAMPLES:
            raise FitError(
                f'the projectile is seen flying at {is_flight.sum()} moments, where at least '
                f'{_MIN_FLIGHT_SAMPLES} are needed'
            )
        level = float(np.mean((speed + self.gravity * time)[is_flight]))
        short = level - self.gravity * time - speed  # of the speed of the flight
        slow = np.flatnonzero(
            (short > approach * (level - self.gravity * time[fastest]))
            & (time < time[is_flight][0])
        )
        if not slow.size:
            raise FitError('the projectile is not seen gathering speed')
        part = (time > time[slow[-1]]) & (time < time[slow[-1]] + 0.25 * self.period)
        if part.sum() < 4:
            raise FitError('the projectile is not seen as it leaves')
        ejection_time = _hinge(time[part], short[part])
        return np.array([ejection_time, level - self.gravity * ejection_time])


def _hinge(time: Floats, values: Floats) -> float:
    """Find when a parabola falls to 0, to stay there: the best of many by least squares."""
    times = np.linspace(time[0], time[-1], 40 * time.size)
    shapes = np.maximum(times[:, None] - time, 0.0) ** 2
    weights = np.maximum(shapes @ values, 0.0)
    gains = weights**2 / np.maximum(np.sum(shapes**2, axis=1), 1e-300)
    return float(times[np.argmax(gains)])


def ejection_of(found: RigFit) -> Ejection:
    r"""
    Find how the projectile of a fitted rig leaves, at its first release.

    Raises
    ------
    FitError
        If it does not leave.

    Notes
    -----
    Errors are the spread over rigs that are drawn from the covariance of the fit, since
    :math:`t_e` and :math:`\alpha` jump and have no derivative there. A layer that sticks lets go
    so much later, and has slowed the projectile down by then; the error of how long is added.

    """
    releases = found.releases(_DRAWS)
    if np.isnan(releases.time[0]):
        raise FitError('the projectile of the rig that was fitted does not leave the layer')
    seen = ~np.isnan(releases.time)

    def estimate(values: Floats) -> Estimate:
        error = float(np.std(values[seen], ddof=1)) if seen.sum() > 1 else 0.0
        return Estimate(float(values[0]), error)

    return Ejection(
        time=estimate(releases.time),
        speed=estimate(releases.speed),
        peak_plate_speed=estimate(releases.peak_plate_speed),
        energy_transfer=estimate(releases.energy_transfer),
        is_near_jump=bool(np.mean(releases.echoes[seen] != releases.echoes[0]) > _JUMP_SHARE),
    )
