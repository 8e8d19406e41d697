# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Compute the energy transfer of 100 x 100 layers, and print the best one."""

import numpy as np
from soft_throw_ros.core import Rig, throw_many

thickness = np.linspace(5e-3, 50e-3, 100)[:, None]  # [m]
wave_speed = np.linspace(5.0, 30.0, 100)  # [m/s]
throws = throw_many(Rig(), {'thickness': thickness, 'wave_speed': wave_speed})
row, column = np.unravel_index(np.nanargmax(throws.energy_transfer), (100, 100))
print(f'{1e3 * thickness[row, 0]:.1f} mm, {wave_speed[column]:.1f} m/s: '
      f'alpha {throws.energy_transfer[row, column]:.2f}')
