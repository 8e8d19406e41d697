# SPDX-License-Identifier: Apache-2.0
r"""
What a throw gave: ejection time and speed, plate speed, energy transfer (Sec. II A of the paper).

By running averages and centred differences, as in the paper, which needs to know nothing of the
layer; or from a rig that was fitted, which is several times as exact if the model is right.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core import normal_modes, travelling_wave
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit import FitError, Value
from soft_throw_ros.identification.plate_fit import fit_plate, PlateFit
from soft_throw_ros.identification.problem import changed_rig, PARAMETERS
from soft_throw_ros.identification.rig_fit import RigFit
from soft_throw_ros.identification.tracks import ThrowTracks, Track

Floats = NDArray[np.float64]

_WINDOW = 1.0 / 16.0  # of the running average, in plate periods
_RATE = 20  # samples per plate period at least
_PEAK = 0.1  # plate periods beside its fastest moment that are fitted by a parabola
_FULL = 0.97  # of the largest speed, at which the projectile leaves about now
_APPROACH = (
    0.16  # of the ejection speed: how much of the end of its rise is fitted by another, ...
)
_APPROACHES = (0.12, 0.24)  # and what else one could have taken
_REPEATS = 100  # with other noise, for the errors
_FEWEST = 8  # samples of the flight
_DRAWS = 400  # of rigs that may be as well as the one that was fitted
_LEAST_LOSS = 1e-4  # for the sum over modes, to have an end


@dataclass(frozen=True, kw_only=True)
class Ejection:
    r"""
    How the projectile left, with standard errors.

    Parameters
    ----------
    time : Value
        :math:`t_e`, since the plate began to move. [s]
    speed : Value
        :math:`V_e`. [m/s]
    peak_plate_speed : Value
        :math:`V_p^*`. [m/s]
    energy_transfer : Value
        :math:`\alpha = (V_e / V_p^*)^2`. [-]
    is_near_jump : bool
        Whether the ejection may be another within the errors, since it jumps where it passes odd
        multiples of the crossing time. Then the errors are those of a choice between two.

    """

    time: Value
    speed: Value
    peak_plate_speed: Value
    energy_transfer: Value
    is_near_jump: bool = False


def analyse_throw(
    tracks: ThrowTracks, *, gravity: float, plate: PlateFit | None = None
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
    plate : PlateFit, optional
        Of this throw, if there is one already.

    Raises
    ------
    FitError
        If the tracks do not show it, saying what is missing.

    Notes
    -----
    Running averages take a sixteenth of a plate period. :math:`V_p^*` is the top of a parabola
    through the plate's speeds beside the largest. In flight the speed falls with gravity alone;
    before, it falls short of that by :math:`k (t_e - t)^2 / 2`, since the contact force vanishes
    at :math:`t_e`. That is fitted where it falls short by less than 16 %, and :math:`V_e` is the
    speed of the flight, taken back to :math:`t_e`; if the projectile was caught up in between, it
    is that of the last release. Both plate and flight are smoothed once more to see what
    smoothing does, and that is taken back (twicing [1]_).

    Errors are the spread of results with other noise, half of what was taken back, and for
    :math:`t_e` the difference between fitting 12 % and 24 %.

    References
    ----------
    .. [1] J. W. Tukey, "Exploratory Data Analysis", Addison-Wesley (1977), ch. 16.

    """
    if tracks.projectile is None:
        raise FitError(f'{tracks.name}: there is no track of the projectile')
    plate = plate or fit_plate(tracks.plate)
    period = 1.0 / plate.motion.frequency
    width = max(3, 2 * round(0.5 * _WINDOW * period / tracks.plate.interval) + 1)
    if tracks.plate.interval * _RATE > period:
        raise FitError(
            f'{tracks.name}: running averages need at least {_RATE} samples per plate period '
            f'({period:.3g} s), got one every {tracks.plate.interval:.3g} s'
        )
    try:
        found, given_back = _twice(tracks.plate, tracks.projectile, width, period, gravity)
        others = [
            _measure(tracks.plate, tracks.projectile, width, period, gravity, approach)[0]
            for approach in _APPROACHES
        ]
    except FitError as error:
        raise FitError(f'{tracks.name}: {error}') from None
    spread = _spread(tracks.plate, tracks.projectile, width, period, gravity)
    errors = np.hypot(spread, 0.5 * given_back)
    doubt = others[1] - others[0]
    errors[0] = math.hypot(errors[0], doubt, plate.fit['start_time'].error)
    errors[1] = math.hypot(errors[1], gravity * doubt)
    found[0] -= plate.start_time
    time, speed, plate_speed = (Value(*pair) for pair in zip(found, errors, strict=True))
    alpha = (speed.value / plate_speed.value) ** 2
    relative = math.hypot(speed.error / speed.value, plate_speed.error / plate_speed.value)
    return Ejection(
        time=time,
        speed=speed,
        peak_plate_speed=plate_speed,
        energy_transfer=Value(alpha, 2.0 * alpha * relative),
    )


def _twice(
    plate: Track, projectile: Track, width: int, period: float, gravity: float
) -> tuple[Floats, Floats]:
    """Measure after smoothing once, less what smoothing once more does; and that alone."""
    once = _measure(plate, projectile, width, period, gravity, _APPROACH)
    again = _measure(
        _smooth(plate, width), _smooth(projectile, width), width, period, gravity, _APPROACH
    )
    return 2.0 * once - again, once - again


def _spread(plate: Track, projectile: Track, width: int, period: float, gravity: float) -> Floats:
    """Measure how results vary with noise, by giving the smoothed tracks another one."""
    rng = np.random.default_rng(0)
    results = []
    smooth = _smooth(plate, width), _smooth(projectile, width)

    def noisy(track: Track) -> Track:
        noise = rng.normal(0.0, track.noise, track.time.size)
        return replace(track, position=track.position + noise)

    for _ in range(_REPEATS):
        try:
            results.append(_twice(noisy(smooth[0]), noisy(smooth[1]), width, period, gravity)[0])
        except FitError:
            continue  # with this noise the ejection is not to be seen
    if len(results) < 0.5 * _REPEATS:
        return np.full(3, math.inf)
    return np.asarray(np.std(results, axis=0, ddof=1))


def _measure(
    plate: Track, projectile: Track, width: int, period: float, gravity: float, approach: float
) -> Floats:
    """Measure ejection time on the clock of the track, ejection speed and plate speed."""
    time, speed = _speeds(_smooth(plate, width))
    fastest = time[np.argmax(speed)]
    near = np.abs(time - fastest) <= _PEAK * period
    if near.sum() < 4:
        raise FitError('the plate is not seen where it is fastest')
    bend, slope, level = np.polyfit(time[near] - fastest, speed[near], 2)
    if bend >= 0.0:
        raise FitError('the speed of the plate is lost in noise')
    plate_speed = level - 0.25 * slope**2 / bend

    smooth = _smooth(projectile, width)
    time, speed = _speeds(smooth)
    height = smooth.position[1:-1]
    fastest = int(np.argmax(speed >= _FULL * speed.max()))
    is_flight = time > time[fastest] + period / 8.0
    fallen = np.flatnonzero(is_flight & (height < height[fastest]))
    is_flight[fallen[0] if fallen.size else time.size :] = False
    if is_flight.sum() < _FEWEST:
        raise FitError(
            f'the projectile is seen flying at {is_flight.sum()} moments, where at least '
            f'{_FEWEST} are needed'
        )
    level = float(np.mean((speed + gravity * time)[is_flight]))
    short = level - gravity * time - speed  # of the speed of the flight
    slow = np.flatnonzero(
        (short > approach * (level - gravity * time[fastest])) & (time < time[is_flight][0])
    )
    if not slow.size:
        raise FitError('the projectile is not seen gathering speed')
    part = (time > time[slow[-1]]) & (time < time[slow[-1]] + 0.25 * period)
    if part.sum() < 4:
        raise FitError('the projectile is not seen as it leaves')
    ejection = _hinge(time[part], short[part])
    return np.array([ejection, level - gravity * ejection, plate_speed])


def _hinge(time: Floats, values: Floats) -> float:
    """Find when a parabola falls to 0, to stay there: the best of many by least squares."""
    times = np.linspace(time[0], time[-1], 40 * time.size)
    shapes = np.maximum(times[:, None] - time, 0.0) ** 2
    weights = np.maximum(shapes @ values, 0.0)
    gains = weights**2 / np.maximum(np.sum(shapes**2, axis=1), 1e-300)
    return float(times[np.argmax(gains)])


def _smooth(track: Track, width: int) -> Track:
    """Average over so many samples at a time."""
    kernel = np.full(width, 1.0 / width)
    if track.time.size < 4 * width:
        raise FitError(f'{track.time.size} samples are too few to average over {width} at a time')
    return Track(
        time=np.convolve(track.time, kernel, 'valid'),
        position=np.convolve(track.position, kernel, 'valid'),
        known_noise=track.noise,
    )


def _speeds(track: Track) -> tuple[Floats, Floats]:
    """Differentiate, by centred differences."""
    time, position = track.time, track.position
    return time[1:-1], (position[2:] - position[:-2]) / (time[2:] - time[:-2])


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
    :math:`t_e` and :math:`\alpha` jump and have no derivative there.

    """
    rigs = [found.rig, *_rigs_like(found)]
    results, intervals = _releases(rigs)
    if np.isnan(results[0, 0]):
        raise FitError('the projectile of the rig that was fitted does not leave the layer')
    seen = ~np.isnan(results[:, 0])
    errors = np.std(results[seen], axis=0, ddof=1) if seen.sum() > 1 else np.zeros(4)
    values = (Value(*pair) for pair in zip(results[0].tolist(), errors.tolist(), strict=True))
    time, speed, plate_speed, energy_transfer = values
    return Ejection(
        time=time,
        speed=speed,
        peak_plate_speed=plate_speed,
        energy_transfer=energy_transfer,
        is_near_jump=bool(np.ptp(intervals[seen]) > 0),
    )


def _rigs_like(found: RigFit) -> Iterator[Rig]:
    """Draw rigs that may be as well as the one that was fitted."""
    names = [name for name in PARAMETERS if name in found.fit]
    places = [found.fit.names.index(name) for name in names]
    values, errors = found.fit.values[places], found.fit.errors[places]
    powers, axes = np.linalg.eigh(found.fit.correlation[np.ix_(places, places)])
    steps = np.random.default_rng(0).normal(size=(_DRAWS, len(places)))
    for step in (steps * np.sqrt(np.maximum(powers, 0.0))) @ axes.T:
        try:
            yield changed_rig(
                found.rig, dict(zip(names, (values + errors * step).tolist(), strict=True))
            )
        except ValueError:
            continue  # beyond what is physical


def _releases(rigs: list[Rig]) -> tuple[Floats, NDArray[np.int64]]:
    """Compute time, speed, plate speed and energy transfer, and the wave interval, of each."""
    ratios: dict[str, Any] = {
        'mass_ratio': np.array([rig.mass_ratio for rig in rigs]),
        'speed_ratio': np.array([rig.speed_ratio for rig in rigs]),
        'damping_ratio': np.array([rig.engine.damping_ratio for rig in rigs]),
        'gravity_ratio': np.array([rig.gravity_ratio for rig in rigs]),
    }
    loss = np.array([rig.layer.loss_tangent for rig in rigs])
    if loss.any():
        release = normal_modes.first_releases(
            **ratios, loss_tangent=np.maximum(loss, _LEAST_LOSS), unresolved='nan'
        )
    else:
        release = travelling_wave.first_releases(**ratios, unresolved='nan')
    phase = np.asarray(release.ejection_phase)
    scale = np.array([rig.engine.speed_scale for rig in rigs])
    plate_speed = scale * [peak_velocity_ratio(rig.engine.damping_ratio) for rig in rigs]
    period = np.array([1.0 / rig.engine.frequency for rig in rigs])
    results = np.stack(
        [phase * period, release.speed * scale, plate_speed, release.energy_transfer], axis=1
    )
    crossings = np.nan_to_num(phase * ratios['speed_ratio'])
    return results, ((crossings - 1.0) // 2.0).astype(np.int64)
