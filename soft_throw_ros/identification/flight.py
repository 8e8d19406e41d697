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
"""The ejection speed of a projectile, measured in flight."""

from __future__ import annotations

from scipy.stats import theilslopes
from soft_throw_ros.identification.tracks import Track


def flight_speed(track: Track, *, gravity: float) -> float:
    """
    Return the speed of the projectile at the start of its flight.

    Parameters
    ----------
    track : Track
        Heights during the flight, from the release on.
    gravity : float
        Acceleration of gravity. [m/s2]

    Returns
    -------
    float
        Median slope of the heights without the fall by gravity, which tolerates outliers in up to
        29 % of the samples (Theil-Sen). [m/s]

    Examples
    --------
    >>> import numpy as np
    >>> time = np.linspace(0.0, 0.02, 50)
    >>> height = 1.5 * time - 0.5 * 9.81 * time**2
    >>> height[7] = 1.0  # an outlier
    >>> round(flight_speed(Track(time=time, position=height), gravity=9.81), 9)
    1.5

    """
    time = track.time - track.time[0]
    height = track.position + 0.5 * gravity * time**2
    return float(theilslopes(height, time).slope)
