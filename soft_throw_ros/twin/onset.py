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
"""The onset of a throw of a measured plate: the rest before it, and the time of its start."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from soft_throw_ros.core.smoothing import FEWEST
from soft_throw_ros.twin.plate_estimator import PlateEstimator, REST_WINDOWS
from soft_throw_ros.twin.sample_buffer import Sample


@dataclass(frozen=True, kw_only=True)
class RestBaseline:
    """Heights of plate and projectile at rest before a throw."""

    plate: float  # mean heights; that of the projectile is NaN if it was not measured [m]
    projectile: float
    noise: float  # standard deviation of the plate's samples [m]
    error: float  # standard error of its mean [m]

    @classmethod
    def before(cls, estimator: PlateEstimator, end_ns: float) -> RestBaseline | None:
        """Return the rest of some windows before a time; None if there are too few samples."""
        window_ns = estimator.config.smoothing_window_ns
        samples = estimator.samples(end_ns - (REST_WINDOWS - 1) * window_ns, end_ns)
        if len(samples) < FEWEST:
            return None
        plate, projectile = samples['plate'], samples['projectile']
        measured = projectile[np.isfinite(projectile)]
        # rounded samples at rest are all the same, so that their scatter underestimates the noise
        noise = max(estimator.config.position_noise, float(plate.std()))
        return cls(
            plate=float(plate.mean()),
            projectile=float(measured.mean()) if measured.size else math.nan,
            noise=noise,
            error=noise / math.sqrt(plate.size),
        )


@dataclass(frozen=True, kw_only=True)
class Onset:
    """The start of the plate's motion, and so of a throw."""

    onset_ns: int  # time of the start [ns]
    rest: RestBaseline
    samples: tuple[Sample, ...]  # sorted, from a window before the start on
    engine_is_nominal: bool = True  # whether the last motion was that of the engine
    stamp_scatter: float = 0.0  # standard deviation of stamps about an even rate [s]
    stamp_error: float = 0.0  # standard deviation of stamps in the last throw [s]
