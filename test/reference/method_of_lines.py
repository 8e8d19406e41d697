# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""First releases and heat by SciPy: springs and masses in a row, with elements that relax."""

import numpy as np
from scipy.integrate import solve_ivp
from soft_throw_ros.core.material import relaxation, RELAXATION_RATES
from soft_throw_ros.core.plate import Underdamped


def first_release(rig, *, cells):
    """Return time [s] and speed [m/s] of the first release, and the heat until then [J]."""
    layer, omega = rig.layer, rig.engine.angular_frequency
    weight, step = rig.projectile.mass * rig.gravity, layer.crossing_time / cells
    is_curved = layer.stress_strain_law == 'neo_hookean'
    columns = []
    for sheet in layer.sheets:  # into cells of about one crossing time
        count = max(1, round(sheet.crossing_time / step))
        is_constant = sheet.loss == 'constant'
        relaxed, *fit = relaxation(sheet.loss_tangent if is_constant else 0.0)
        lag = 0.0 if is_constant else sheet.loss_tangent / omega
        moduli = [relaxed, lag, *fit]
        column = sheet.thickness / count, sheet.mass / count, -sheet.static_strain(weight)
        columns += [(*column, *(sheet.youngs_modulus * sheet.section * x for x in moduli))] * count
    lengths, masses, rest_strain, spring, viscosity, *strengths = np.array(columns).T
    mass = 0.5 * (masses + np.append(masses[1:], 2.0 * rig.projectile.mass))
    rates = np.array(RELAXATION_RATES)[:, None] * omega
    plate, n = Underdamped.of(rig.engine), lengths.size

    def derivative(time, state):
        u, v = state[:n], state[n:2 * n]
        memory = state[2 * n:5 * n].reshape(3, n)
        strain = rest_strain + np.diff(u, prepend=float(plate.position(time))) / lengths
        rate = np.diff(v, prepend=float(plate.velocity(time))) / lengths
        stress = (1.0 + strain - (1.0 + strain) ** -2) / 3.0 if is_curved else strain
        pull = weight + spring * stress + viscosity * rate + (strengths * memory).sum(axis=0)
        acceleration = (np.append(pull[1:], 0.0) - pull) / mass
        heat = lengths @ (viscosity * rate**2 + (strengths * rates * memory**2).sum(axis=0))
        return np.concatenate([v, acceleration, (rate - rates * memory).ravel(), [heat]])

    def contact(time, state):
        return derivative(time, state)[2 * n - 1] + rig.gravity if time > 1e-4 else 1.0

    contact.terminal, contact.direction = True, -1.0
    done = solve_ivp(
        derivative, (0.0, 0.02), np.zeros(5 * n + 1), 'RK45', events=contact, rtol=1e-7,
        atol=1e-9, max_step=5e-5,
    )
    last = done.y_events[0][0]
    return float(done.t_events[0][0]), float(last[2 * n - 1]), float(last[-1])
