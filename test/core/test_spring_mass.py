# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
import math

import pytest
from scipy.integrate import solve_ivp
from soft_throw_ros.core import spring_mass


def release_by_integration(q):
    """Integrate a mass on a spring on a harmonic plate, time in periods, until the force is 0."""
    omega = 2.0 * math.pi

    def motion(t, state):
        height, speed = state
        return speed, (q * omega) ** 2 * (1.0 - math.cos(omega * t) - height)

    def force(t, state):
        return 1.0 - math.cos(omega * t) - state[0]

    force.terminal = True
    force.direction = -1.0
    start = 1e-3 / (1.0 + q)  # z ~ (q w)^2 w^2 t^4 / 24 there, and the force is positive
    height = (q * omega * omega) ** 2 * start**4 / 24.0
    done = solve_ivp(
        motion, (start, 2.0), (height, 4.0 * height / start), 'DOP853', events=force,
        rtol=1e-11, atol=1e-13,
    )
    return done.t_events[0][0], done.y_events[0][0][1] / omega


@pytest.mark.parametrize('q', [0.2, 0.7, 0.999, 1.0, 1.001, 1.62, 3.0, 9.0])
def test_release_agrees_with_an_integration_of_the_motion(q):
    release = spring_mass.first_release(frequency_ratio=q)
    time, speed = release_by_integration(q)
    assert release.ejection_phase == pytest.approx(time, abs=1e-7)
    assert release.speed == pytest.approx(speed, abs=1e-7)
    assert release.energy_transfer == pytest.approx(speed**2, abs=1e-6)
