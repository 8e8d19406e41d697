# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Measured throws, simulated by the model of travelling waves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import PLATE_POSITION, PROJECTILE_POSITION
from soft_throw_ros.core.throw import make_stepper
from soft_throw_ros.twin.sample_buffer import Sample
from soft_throw_ros.twin.tick_schedule import SECOND

PLATE_ZERO, PROJECTILE_ZERO = 0.3, -0.2
"""Readings of the sensors at height 0. [m]"""


def states_at(rig: Rig, times: Iterable[float]) -> NDArray[np.float64]:
    """Return the states of a throw at increasing times since its start, before which it rests."""
    model, states = make_stepper(rig), []
    for time in times:
        model.advance_to(max(time, 0.0))
        states.append(model.state.copy())
    return np.array(states)


def measured_throw(
    rig: Rig,
    *,
    begin_ns: int,
    onset: float = 0.05,
    duration: float = 0.12,
    rate: float = 5000.0,
    noise: float = 0.0,
    jitter: float = 0.0,
    seed: int = 0,
) -> list[Sample]:
    """Return the samples of a throw that starts at `onset` [s]; `jitter` is in intervals."""
    random = np.random.default_rng(seed)
    count = round(duration * rate)
    since = (np.arange(count) + jitter * random.uniform(-1.0, 1.0, count)) / rate
    stamps = begin_ns + np.round(since * SECOND).astype(np.int64)
    states = states_at(rig, ((stamps - begin_ns) / SECOND - onset).tolist())
    rows = states[:, [PLATE_POSITION, PROJECTILE_POSITION]]
    rows += [PLATE_ZERO, PROJECTILE_ZERO]
    rows += noise * random.standard_normal(rows.shape)
    return [
        Sample(stamp, plate, projectile)
        for stamp, (plate, projectile) in zip(stamps.tolist(), rows.tolist(), strict=True)
    ]


def aged(rig: Rig, factor: float) -> Rig:
    """Return a rig with the wave speed of its layer multiplied by a factor."""
    return replace(rig, layer=replace(rig.layer, wave_speed=factor * rig.layer.wave_speed))
