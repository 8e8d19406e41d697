# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Print the energy transfer of the default rig for several loss tangents of its layer."""

import numpy as np
from soft_throw_ros.core import Rig, throw_many

loss_tangent = np.array([0.0, 0.02, 0.05, 0.1, 0.2])
throws = throw_many(Rig(), {'loss_tangent': loss_tangent})
for loss, alpha in zip(loss_tangent, throws.energy_transfer, strict=True):
    print(f'loss tangent {loss:.2f}: alpha {alpha:.3f}')
