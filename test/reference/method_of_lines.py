# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""First releases and heat by SciPy: springs and masses in a row, with elements that relax."""

import numpy as np
from scipy.integrate import solve_ivp
from soft_throw_ros.core.material import Relaxation, relaxation, RELAXATION_RATES
from soft_throw_ros.core.plate import Underdamped


def _links(layer, cells):
    """Cut sheets into cells of about one crossing time: their lengths, and the sheet of each."""
    step = layer.crossing_time / cells
    lengths, sheets = [], []
    for sheet in layer.sheets:
        count = max(1, round(sheet.crossing_time / step))
        lengths += [sheet.thickness / count] * count
        sheets += [sheet] * count
    return np.array(lengths), sheets


def first_release(rig, *, cells):
    """Return time [s] and speed [m/s] of the first release, and the heat until then [J]."""
    lengths, sheets = _links(rig.layer, cells)
    fits = [
        relaxation(sheet.loss_tangent) if sheet.loss == 'constant' else Relaxation()
        for sheet in sheets
    ]
    section = rig.layer.section
    modulus = np.array([sheet.youngs_modulus for sheet in sheets]) * section
    spring = modulus * [fit.relaxed for fit in fits]
    strengths = modulus * np.array([fit.strengths for fit in fits]).T
    omega = rig.engine.angular_frequency
    rates = np.array(RELAXATION_RATES)[:, None] * omega
    viscosity = (
        np.array(
            [0.0 if sheet.loss == 'constant' else sheet.loss_tangent / omega for sheet in sheets]
        )
        * modulus
    )
    is_curved = np.array([sheet.stress_strain_law == 'neo_hookean' for sheet in sheets])
    half = 0.5 * lengths * section * [sheet.density for sheet in sheets]
    mass = half + np.append(half[1:], rig.projectile.mass)
    plate, weight, n = Underdamped.of(rig.engine), rig.projectile.mass * rig.gravity, len(sheets)

    def tension(strain):
        ratio = 1.0 + strain
        return spring * np.where(is_curved, (ratio - ratio**-2) / 3.0, strain)

    rest_strain = -weight / spring  # Newton, in each cell
    for _ in range(20):
        slope = np.where(is_curved, (1.0 + 2.0 / (1.0 + rest_strain) ** 3) / 3.0, 1.0) * spring
        rest_strain = rest_strain - (tension(rest_strain) + weight) / slope

    def forces(time, state):
        u, v = state[:n], state[n:2 * n]
        memory = state[2 * n:5 * n].reshape(3, n)
        strain = np.diff(u, prepend=float(plate.position(time))) / lengths
        rate = np.diff(v, prepend=float(plate.velocity(time))) / lengths
        pull = tension(rest_strain + strain) + weight + viscosity * rate
        return pull + (strengths * memory).sum(axis=0), rate, memory

    def derivative(time, state):
        pull, rate, memory = forces(time, state)
        acceleration = (np.append(pull[1:], 0.0) - pull) / mass
        heat = lengths @ (viscosity * rate**2 + (strengths * rates * memory**2).sum(axis=0))
        change = (rate - rates * memory).ravel()
        return np.concatenate([state[n:2 * n], acceleration, change, [heat]])

    def contact(time, state):
        acceleration = derivative(time, state)[2 * n - 1]
        return rig.projectile.mass * (acceleration + rig.gravity) if time > 1e-4 else 1.0

    contact.terminal, contact.direction = True, -1.0
    done = solve_ivp(
        derivative,
        (0.0, 0.02),
        np.zeros(5 * n + 1),
        'RK45',
        events=contact,
        rtol=1e-7,
        atol=1e-9,
        max_step=5e-5,
    )
    last = done.y_events[0][0]
    return float(done.t_events[0][0]), float(last[2 * n - 1]), float(last[-1])
