# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The gain in ejection speed by a commanded motion of the plate, from tracks of the projectile."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
from soft_throw_ros.identification.flight import flight_speed
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.tracks import Track
from soft_throw_ros.twin.results import ThrowResult

_RELEASE_TIME_ERROR = 1e-4  # standard error of the release, by delays of the sensors [s]


class MeasuredThrow(NamedTuple):
    """A throw whose projectile was measured in flight."""

    speed: Estimate  # at the release, with the error by the scatter of the heights [m/s]
    common_error: float  # of the speeds of all such throws [m/s]
    peak_plate_speed: float  # [m/s]

    @classmethod
    def from_track(cls, result: ThrowResult, projectile: Track) -> MeasuredThrow:
        """Measure a throw by the track of its flight."""
        gravity = result.rig.gravity
        speed = flight_speed(projectile, gravity=gravity)
        return cls(speed, gravity * _RELEASE_TIME_ERROR, result.peak_plate_speed)


def describe_gain(
    by_engine: Sequence[MeasuredThrow], commanded: Sequence[MeasuredThrow]
) -> tuple[str, dict[str, str]]:
    """Return the gain of the commanded motion as a sentence, and its values."""
    values = _means('engine', by_engine) | _means('commanded', commanded)
    message = (
        f'measured gain by the commanded motion: ejection speed '
        f'{values["engine.ejection_speed"]} -> {values["commanded.ejection_speed"]} m/s, '
        f'energy transfer {values["engine.energy_transfer"]} -> '
        f'{values["commanded.energy_transfer"]}'
    )
    return message, values


def _means(prefix: str, throws: Sequence[MeasuredThrow]) -> dict[str, str]:
    """
    Return the mean results of throws.

    The standard errors contain the scatter among the throws or within them, whichever is larger,
    and the error of the release.
    """
    speeds, errors = np.transpose([throw.speed for throw in throws])
    plate_speed = float(np.mean([throw.peak_plate_speed for throw in throws]))
    speed = float(speeds.mean())
    scatter = math.sqrt(float(np.mean(errors**2)))
    if speeds.size > 1:
        scatter = max(scatter, float(speeds.std(ddof=1)))
    error = math.hypot(scatter / math.sqrt(speeds.size), throws[0].common_error)
    energy_transfer = (speed / plate_speed) ** 2
    return {
        f'{prefix}.ejection_speed': str(Estimate(speed, error)),
        f'{prefix}.energy_transfer': str(
            Estimate(energy_transfer, 2.0 * energy_transfer * error / speed)
        ),
        f'{prefix}.throws': str(speeds.size),
    }
