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
    layer = np.empty((3, stepper.field_points))
    for tick in range(500):
        stepper.advance_to(tick * 1e-3)
        stepper.read_layer(layer)
        energies = [stepper.stored_energy(), stepper.plate_work]
        digest.update(stepper.state.tobytes() + layer.tobytes() + np.array(energies).tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
def test_compiled_and_cached_kernels_agree_bit_by_bit(tmp_path) -> None:
    hashes = [
        subprocess.run(
            [sys.executable, '-c', HASH],
            check=True,
            stdout=subprocess.PIPE,
            env={**os.environ, 'NUMBA_CACHE_DIR': str(tmp_path)},
            timeout=300,
        ).stdout
        for _ in range(2)
    ]
    assert hashes[0] == hashes[1]
