# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sentences on the sensors of a measured plate for the log."""

from __future__ import annotations

from soft_throw_ros.core.smoothing import FEWEST
from soft_throw_ros.twin.plate_estimator import PER_CROSSING, PER_PERIOD, SampledSpan
from soft_throw_ros.twin.sensor_checks import (
    HighNoise,
    LowRate,
    SensorFault,
    WrongDirection,
    WrongUnit,
)

_REQUIRED_SAMPLES = {
    SampledSpan.CROSSING: f'{PER_CROSSING} in a crossing of the wave',
    SampledSpan.PERIOD: f'{PER_PERIOD} in a period of the plate',
    SampledSpan.WINDOW: f'{FEWEST} in measured.smoothing_window',
}


def sensor_text(fault: SensorFault) -> str:
    """Return a fault of the sensors with its numbers and the remedy."""
    match fault:
        case LowRate(rate, least, span):
            return (
                f'the plate is measured at {rate:.0f} Hz, which must be at least {least:.0f} Hz, '
                f'{_REQUIRED_SAMPLES[span]}: no throw is followed'
            )
        case HighNoise(noise, expected):
            return (
                f'the plate at rest scatters by {1e6 * noise:.3g} um, {noise / expected:.1f} '
                f'times measured.position_noise {1e6 * expected:.3g} um: set it, without which '
                'the plate may never seem at rest and no throw is followed'
            )
        case WrongUnit(rise, amplitude):
            return (
                f'the plate moves by {rise:.3g} m, {rise / amplitude:.0f} times '
                'engine.amplitude: if heights are in millimetres, divide them by 1000'
            )
        case WrongDirection(speed):
            return (
                f'the plate has jumped down, at {speed:.3g} m/s: if heights count '
                'downwards, change their sign; no throw is followed'
            )
        case _:
            return (
                'the projectile has moved before the plate: if the names of the two joints are '
                'swapped in ~/measured_joint_states, swap them; no throw is followed'
            )
