# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A throw with a commanded motion: the speed in flight, and the delay of the plate."""

from __future__ import annotations

import numpy as np
from scipy.stats import theilslopes
from soft_throw_ros.core.plate import PlateMotion
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.tracks import Track, TrackError

_STANDARD = 0.683  # probability of the interval between one standard error below and above a value
_FAST = 0.5  # smallest speed of the plate that shows its delay, relative to its peak speed
_FOLLOWED = 0.1  # largest median distance of a plate from its command, over its range of heights


def flight_speed(track: Track, *, gravity: float) -> Estimate:
    """
    Return the speed of a projectile at its release, time 0 of its track in flight [m/s].

    It is the median slope of the heights without the fall by gravity, which tolerates outliers in
    up to 29 % of the samples (Theil-Sen), with an error by the scatter of the heights.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.linspace(0.0, 0.02, 50)
    >>> height = 1.5 * time - 0.5 * 9.81 * time**2
    >>> height[7] = 1.0  # an outlier
    >>> round(flight_speed(Track(time=time, position=height), gravity=9.81).value, 9)
    1.5

    """
    height = track.position + 0.5 * gravity * track.time**2
    slope, _, low, high = theilslopes(height, track.time, alpha=_STANDARD)
    return Estimate(float(slope), 0.5 * float(high - low))


def motion_delay(track: Track, motion: PlateMotion) -> float:
    """
    Return the delay of a plate behind its commanded motion, to first order [s].

    Time 0 of the track is the commanded start. The delay is the median of the differences of
    height over the velocity, where the plate is fast. Raise TrackError if the plate did not follow
    the motion.

    Examples
    --------
    >>> from soft_throw_ros.core.plate import motion_of
    >>> from soft_throw_ros.core.rig import Engine
    >>> time, motion = np.linspace(1e-3, 0.02, 200), motion_of(Engine())
    >>> late = Track(time=time, position=motion.position(time - 1e-4))
    >>> f'{motion_delay(late, motion):.1e}'
    '1.0e-04'

    """
    velocity = motion.velocity(track.time)
    is_fast = np.abs(velocity) > _FAST * np.abs(velocity).max()
    height = motion.position(track.time)
    delay = float(np.median((height - track.position)[is_fast] / velocity[is_fast]))
    distance = float(np.median(np.abs(motion.position(track.time - delay) - track.position)))
    if distance > _FOLLOWED * np.ptp(height):
        raise TrackError(
            f'the plate was {1e3 * distance:.3g} mm from its command; the rig was not ready'
        )
    return delay
