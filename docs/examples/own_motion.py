# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Throw with an own motion of the plate, from a function of its speed V(t)."""

import numpy as np
from scipy.integrate import cumulative_trapezoid
from soft_throw_ros.core import Engine, Rig, SampledMotion, simulate

t = np.linspace(0.0, 16e-3, 161)  # [s]
speed = 0.4 * (1.0 - np.cos(2.0 * np.pi * t / t[-1]))  # up to 0.8 m/s and back to 0
height = cumulative_trapezoid(speed, t, initial=0.0)
motion = SampledMotion(t, np.column_stack([height, speed, np.gradient(speed, t)]))
throw = simulate(Rig(engine=Engine(motion=motion)))
print(f'{throw.ejection_speed:.3f} m/s, alpha {throw.energy_transfer:.2f}')
