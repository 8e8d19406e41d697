# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sentences on the sensors of a measured plate for the log."""

from __future__ import annotations

from soft_throw_ros.core.smoothing import FEWEST
from soft_throw_ros.twin.plate_estimator import PER_CROSSING, PER_PERIOD, SampledSpan
from soft_throw_ros.twin.sensor_checks import LowRate, SensorFault

_REQUIRED_SAMPLES = {
    SampledSpan.CROSSING: f'{PER_CROSSING} in a crossing of the wave',
    SampledSpan.PERIOD: f'{PER_PERIOD} in a period of the plate',
    SampledSpan.WINDOW: f'{FEWEST} in measured.smoothing_window',
}


def sensor_text(fault: SensorFault) -> str:
    """Return a fault of the sensors with its numbers and the remedy."""
    if isinstance(fault, LowRate):
        return (
            f'the plate is measured at {fault.rate:.0f} Hz, which must be at least '
            f'{fault.least_rate:.0f} Hz, {_REQUIRED_SAMPLES[fault.span]}: no throw is followed'
        )
    noise, expected = fault
    return (
        f'the plate at rest scatters by {1e6 * noise:.3g} um, {noise / expected:.1f} '
        f'times measured.position_noise {1e6 * expected:.3g} um: set it, or divide heights in '
        'millimetres by 1000; the plate may never seem at rest, and then no throw is followed'
    )
