# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The speed of a projectile in flight."""

import numpy as np
from soft_throw_ros.identification.flight import flight_speed
from soft_throw_ros.identification.tracks import Track


def test_error_of_the_speed_agrees_with_its_scatter():
    time, random = np.linspace(0.0, 0.016, 40), np.random.default_rng(0)
    height = 1.4 * time - 0.5 * 9.81 * time**2
    tracks = [
        Track(time=time, position=height + 2e-5 * random.normal(size=time.size))
        for _ in range(200)
    ]
    values, errors = np.transpose([flight_speed(track, gravity=9.81) for track in tracks])
    scatter = np.std(values)
    assert abs(np.mean(values) - 1.4) < 3.0 * scatter / 200**0.5
    assert 0.8 * scatter < np.mean(errors) < 1.25 * scatter
