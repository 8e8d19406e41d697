# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tracks with known truth."""

from collections.abc import Callable
from dataclasses import replace
import itertools
from pathlib import Path

import numpy as np
import pytest
from reference.method_of_steps import follow
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.identification.rig_fit import fit_rig, RigFit
from soft_throw_ros.identification.track_csv import read_csv
from soft_throw_ros.identification.tracks import ThrowTracks, Track

DATA = Path(__file__).parents[1] / 'data'


@pytest.fixture(scope='session')
def see() -> Callable[..., ThrowTracks]:
    """Return a function that measures heights of two bodies with noise."""

    def see(time, plate, projectile, *, noise=2e-5, seed=0):
        heights = np.stack([plate, projectile])
        heights += noise * np.random.default_rng(seed).normal(size=heights.shape)
        below, above = (Track(time=time, position=height) for height in heights)
        return ThrowTracks(name='simulated', plate=below, projectile=above)

    return see


@pytest.fixture(scope='session')
def make_throw(see) -> Callable[..., ThrowTracks]:
    """Return a function that measures an exact throw from given zeros of height."""

    def make_throw(rig, *, rate=5000.0, duration=0.1, start=0.0153, zeros=(0.0, 0.0), **options):
        time = np.arange(0.0, duration, 1.0 / rate)
        plate = Underdamped.of(rig.engine).position(time - start)
        projectile = follow(rig, until=time[-1] - start).projectile_position(time - start)
        return see(time, plate - zeros[0], projectile - zeros[1], **options)

    return make_throw


RIGS = {
    'usual': Rig(),
    'caught up': Rig(layer=Layer(thickness=5.6e-3, wave_speed=15.0)),
    'thick': Rig(engine=Engine(frequency=40.0), layer=Layer(thickness=29.1e-3, wave_speed=5.0)),
}


@pytest.fixture(scope='session')
def fits(make_throw) -> dict[tuple[str, float], tuple[Rig, RigFit]]:
    """Return rigs and their fits to one throw, whose layer and engine start far away."""
    found = {}
    for (name, rig), noise in itertools.product(RIGS.items(), (5e-6, 2e-5)):
        throw = make_throw(
            rig, rate=3000.0, duration=0.02 + 3.5 / rig.engine.frequency, noise=noise,
            zeros=(0.3, -0.2),
        )
        far = Engine(frequency=10.0, amplitude=1.0, damping_ratio=0.5)
        known = replace(rig, engine=far, layer=replace(rig.layer, wave_speed=50.0))
        found[name, noise] = rig, fit_rig([throw], known)
    return found


@pytest.fixture(scope='session')
def reference_throw() -> ThrowTracks:
    """Return the 5 kHz reference tracks with 20 um of noise, whose best fits are known."""
    with (DATA / 'reference_tracks.csv').open() as file:
        tracks = read_csv(file, 'reference', ('plate', 'projectile'))
    return ThrowTracks(name='reference', **tracks)
