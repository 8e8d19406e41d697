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
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.rig import Layer, Rig

RATIOS = st.floats(1e-3, 1e3)


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
    )  # fmt: skip
    return done.t_events[0][0], done.y_events[0][0][1] / omega


@pytest.mark.parametrize('q', [0.2, 0.7, 0.999, 1.0, 1.001, 1.62, 3.0, 9.0])
def test_release_agrees_with_an_integration_of_the_motion(q):
    release = spring_mass.first_release(frequency_ratio=q)
    time, speed = release_by_integration(q)
    assert release.ejection_phase == pytest.approx(time, abs=1e-7)
    assert release.speed == pytest.approx(speed, abs=1e-7)
    assert release.energy_transfer == pytest.approx(speed**2, abs=1e-6)


@given(q=RATIOS.filter(lambda q: abs(q - 1.0) > 1e-3))
def test_speed_is_that_of_the_paper(q):
    speed = q / (q - 1.0) * math.sin(2.0 * math.pi / (q + 1.0))  # (A4) as it is printed
    assert spring_mass.first_release(frequency_ratio=q).speed == pytest.approx(speed, abs=2e-12)


def test_speed_is_smooth_where_the_papers_form_is_0_over_0():
    q = 1.0 + np.linspace(-1e-6, 1e-6, 101)
    speed = spring_mass.first_release(frequency_ratio=q).speed
    assert speed[50] == 0.5 * math.pi
    # V = pi/2 (1 + (q - 1)/2 + ...): nothing but this line is left within 1e-6
    assert speed == pytest.approx(0.5 * math.pi * (1.0 + 0.5 * (q - 1.0)), rel=3e-12)


def test_neither_a_limp_nor_a_stiff_spring_throws():
    """One does not push; the other lets go at once, before the plate is fast."""
    release = spring_mass.first_release(frequency_ratio=np.array([1e-6, 1e6]))
    assert release.ejection_phase == pytest.approx([1.0, 0.0], abs=2e-6)
    assert release.energy_transfer == pytest.approx([0.0, 0.0], abs=1e-9)


def test_optimum_is_where_a_search_finds_it():
    found = minimize_scalar(
        lambda q: -spring_mass.first_release(frequency_ratio=q).energy_transfer,
        bounds=(0.1, 10.0),
        method='bounded',
        options={'xatol': 1e-9},
    )
    best = spring_mass.best_frequency_ratio()
    assert best == pytest.approx(found.x, abs=1e-6)  # a search knows a maximum to sqrt(eps)
    assert best == pytest.approx(1.619874, abs=5e-7)
    assert -found.fun <= spring_mass.first_release(frequency_ratio=best).energy_transfer + 1e-15


def test_frequency_ratio_is_that_of_the_rig():
    rig = Rig(layer=Layer(thickness=5.6e-3))
    ratio = spring_mass.frequency_ratio(mass_ratio=rig.mass_ratio, speed_ratio=rig.speed_ratio)
    assert isinstance(ratio, float)
    assert ratio == pytest.approx(rig.natural_frequency / rig.engine.frequency, rel=1e-14)


def test_arrays_keep_their_shape_and_scalars_are_floats():
    ratios = spring_mass.frequency_ratio(mass_ratio=[[0.5], [1.0]], speed_ratio=[1.0, 2.0, 3.0])
    assert ratios.shape == (2, 3)
    released = spring_mass.first_release(frequency_ratio=ratios)
    assert all(values.shape == (2, 3) for values in released)
    one = spring_mass.first_release(frequency_ratio=float(ratios[1, 2]))
    assert one == tuple(float(values[1, 2]) for values in released)
    assert all(isinstance(value, float) for value in one)


@pytest.mark.parametrize('value', [0.0, -1.0, math.nan, math.inf])
def test_bad_ratio_is_quoted(value):
    with pytest.raises(ValueError, match=rf'frequency_ratio must be .* got {value}'):
        spring_mass.first_release(frequency_ratio=value)
    with pytest.raises(ValueError, match=rf'mass_ratio must be .* got {value}'):
        spring_mass.frequency_ratio(mass_ratio=value, speed_ratio=1.0)
    with pytest.raises(ValueError, match=rf'speed_ratio must be .* got {value}'):
        spring_mass.frequency_ratio(mass_ratio=1.0, speed_ratio=[1.0, value])
