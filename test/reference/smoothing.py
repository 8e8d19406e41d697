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
"""Local fits of cubics to samples, given as lists or arrays."""

from typing import NamedTuple

import numpy as np
from soft_throw_ros.core.smoothing import fit_cubics


class Smoothed(NamedTuple):
    """States by rows, and standard errors of the velocity [m/s]."""

    states: np.ndarray
    errors: np.ndarray


def smooth(
    at, times, positions, velocities=None, *, window, position_noise, velocity_noise=1.0
):
    """Fit a cubic around each time, with standard deviations of positions and velocities."""
    series = [at, times, positions, np.full(len(times), np.nan)]
    if velocities is not None:
        series[3] = velocities
    series = [np.ascontiguousarray(values, dtype=np.float64) for values in series]
    count = series[0].size
    states, errors, misfits = np.empty((count, 3)), np.empty(count), np.empty((count, 2))
    ratio = position_noise / velocity_noise
    fit_cubics(*series, 0.5 * window, ratio, states, errors, misfits)
    return Smoothed(states, position_noise * errors)
