# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels and kernels from the cache agree to the last bit."""

import os
import subprocess
import sys

import pytest

HASH = """
import hashlib
import numpy as np
from soft_throw_ros.core.cell_stepper import CellStepper
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.wave_stepper import WaveStepper

digest = hashlib.sha256()
gels = [
    Rig(layer=Layer(stress_strain_law='neo_hookean', loss_tangent=0.05, loss=loss))
    for loss in ('kelvin_voigt', 'constant')
]
for stepper in (WaveStepper(Rig()), *map(CellStepper, gels), CellStepper(gels[0], cells=50)):
    for tick in range(500):
        stepper.advance_to(tick * 1e-3)
        layer = stepper.read_layer()
        energies = [stepper.stored_energy(), stepper.plate_work]
        digest.update(stepper.state.tobytes() + layer.tobytes() + np.array(energies).tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
def test_compiled_and_cached_kernels_agree_bit_by_bit(tmp_path) -> None:
    environment = {**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)}
    hashes = [
        subprocess.check_output([sys.executable, '-c', HASH], env=environment, timeout=300)
        for _ in range(2)
    ]
    assert hashes[0] == hashes[1]
