# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The gain in ejection speed by a commanded motion, from simulated flights."""

from types import SimpleNamespace

import numpy as np
import pytest
from soft_throw_ros.core.plate import motion_of
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.identification.flight import motion_delay
from soft_throw_ros.identification.least_squares import Estimate
from soft_throw_ros.identification.tracks import Track, TrackError
from soft_throw_ros.nodes.motion_gain import describe_gain, MeasuredThrow
from soft_throw_ros.twin.results import Release


def result(speed=1.5, gravity=9.81):
    """Return the values of a result that a measurement needs."""
    first = Release(ejection_time=8e-3, ejection_speed=speed, energy_transfer=4.0, release_ns=0)
    rig = Rig(engine=Engine(frequency=50.0), gravity=gravity)
    return SimpleNamespace(rig=rig, first=first, peak_plate_speed=0.75)


def flight(speed, noise=0.0):
    time = np.linspace(0.0, 0.02, 50)
    random = np.random.default_rng(0)
    height = speed * time - 0.5 * 9.81 * time**2 + noise * random.normal(size=time.size)
    return Track(time=time, position=height)


def values(throws):
    _, found = describe_gain(throws, throws)
    number, _, error = found['engine.ejection_speed'].partition(' +- ')
    return float(number), float(error)


def test_speed_is_measured_at_the_release():
    throw = MeasuredThrow.from_track(result(), flight(1.47))
    assert throw.speed == pytest.approx((1.47, 0.0), abs=1e-9)
    assert throw.common_error == pytest.approx(9.81e-4)
    assert throw.peak_plate_speed == 0.75


def test_plate_that_did_not_follow_its_command_is_refused():
    time, motion = np.linspace(1e-3, 0.02, 200), motion_of(Engine())
    still = Track(time=time, position=np.zeros_like(time))
    with pytest.raises(TrackError, match=r'the plate was .+ mm from'):
        motion_delay(still, motion)


@pytest.mark.parametrize(
    ('speeds', 'error', 'expected'),
    [
        ([1.5, 1.5, 1.5, 1.5], 4e-3, 2e-3),  # the scatter within the throws
        ([1.49, 1.51], 1e-4, 1e-2),  # the scatter among them: sqrt(2) 0.01 / sqrt(2)
        ([1.5], 0.0, 1e-3),  # the common error alone
    ],
)
def test_error_has_the_larger_scatter_and_the_common_error(speeds, error, expected):
    throws = [MeasuredThrow(Estimate(speed, error), 1e-3, 0.75) for speed in speeds]
    value, total = values(throws)
    assert value == pytest.approx(1.5, abs=1e-3)
    assert total == pytest.approx(np.hypot(expected if error else 0.0, 1e-3), rel=0.06)
