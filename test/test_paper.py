# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Results of the paper, to the printed digits, and its figures.

"Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022). Its maps have a
projectile as dense as the layer: kappa = C / x, mu = (1 - x) / x.
"""

import math
from pathlib import Path
import sys

import numpy as np
import pytest
from soft_throw_ros.core.closed_form import first_releases
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.wave_stepper import WaveStepper

pytest.importorskip('matplotlib', reason='the extra [plot]')

sys.path.append(str(Path(__file__).parents[1] / 'docs' / 'paper'))  # it is not installed

import comparison  # noqa: E402, I100
from models import SERIES  # noqa: E402


def test_nothing_in_the_map_is_above_the_optimum_of_section_3():
    # The whole of Fig. 3
    x, c = np.meshgrid(np.linspace(0.005, 0.995, 199), np.linspace(0.1, 14.0, 279))
    alphas = first_releases(mass_ratio=(1.0 - x) / x, speed_ratio=c / x).energy_transfer
    highest = np.argmax(alphas)
    assert 4.12 < alphas.flat[highest] < 4.123215
    assert (x.flat[highest], c.flat[highest]) == pytest.approx((0.8102, 6.678), abs=0.05)


def test_without_a_layer_the_plate_throws_alone():
    # Fig. 5: t_e f = 0.25, alpha = 1. Stiff layers approach these values after hundreds of
    # re-contacts; their number depends on the step size
    errors = []
    engine = Engine(damping_ratio=0.0)
    for wave_speed in (20.0, 80.0, 320.0):
        rig = Rig(engine=engine, layer=Layer(thickness=2e-3, wave_speed=wave_speed), gravity=0.0)
        stepper = WaveStepper(rig, field_points=2)
        stepper.advance_to(5.0 / engine.frequency)
        last = stepper.events()[-1]
        alpha = (last.velocity / engine.speed_scale) ** 2
        errors.append((abs(last.time * engine.frequency - 0.25), abs(alpha - 1.0)))
    assert sorted(errors, reverse=True) == errors
    assert max(errors[-1]) < 0.015


def test_contact_strain_rises_through_zero_at_the_release():
    # A sentence of the paper states the opposite
    throw = simulate(SERIES[1].rig(16.8e-3, damping_ratio=0.064))
    before = throw.ejection_time - 1e-3 * throw.rig.crossing_time * np.arange(50.0, -1.0, -1.0)
    strain = throw.trajectory(before)[1][:, 3, -1]
    assert (np.diff(strain) > 0.0).all()
    assert strain[-1] == pytest.approx(0.0, abs=1e-5)


# Numbers of the table in docs/paper.md, from computations with 40 digits, and their tolerances
TABLE = {
    'largest alpha': (4.123214640552163, 1e-9),
    'its t_e/t_s': (0.3994399384513 * 8.2422098072, 1e-4),
    'its m/(rho_s S L_s)': (0.23423068535205, 1e-5),
    'its c_s/(L_s f)': (8.2422098072057, 1e-4),
    'alpha at these two, (0.32, 8.4)': (4.1101, 5e-5),
    'ridge for small x: C/sqrt(x)': (2.0 * math.pi * 1.619874, 2e-3),
    'alpha on it': (3.127442, 1e-4),
    'best f0/f of a massless spring': (1.619874, 1e-6),
    'period of a free layer, T_0 c_s/L_s': (2.0, 1e-5),
    '(4 - alpha)/(omega tau)^2 for small omega tau': (4.0, 1e-3),
    'factor of e^(-pi/(2 omega tau)) in omega (t_e - t_s)': (-math.exp(-1.0), 1e-3),
    'alpha (omega tau)^2 for large omega tau': (16.0, 1e-3),
    'omega (t_e - t_s) for omega tau = 100': (math.pi - 0.02 + math.pi * 1e-4, 1e-5),
    'largest strain at 63.2 Hz (%)': ((11.819685, 20.455695), 5e-3),
    'largest strain at 31.1 Hz (%)': ((3.050406, 5.814709), 3e-3),
    'change of alpha by the damping of 0.064 (%)': ((-0.753070, 12.777207), 1e-5),
}


def test_table_has_our_numbers():
    rows = {row.quantity: row for row in comparison.published()}
    for name, (ours, tolerance) in TABLE.items():
        assert rows[name].ours == pytest.approx(ours, abs=tolerance), name
