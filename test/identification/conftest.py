# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tracks with known truth."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from reference.method_of_steps import follow
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import FitDescription
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.identification.plate_fit import fit_plate
from soft_throw_ros.identification.rig_model import RigModel
from soft_throw_ros.identification.track_csv import read_csv
from soft_throw_ros.identification.tracks import ThrowTracks, Track

DATA = Path(__file__).parents[1] / 'data'


def _measure(time, plate, projectile, *, noise=2e-5, seed=0) -> ThrowTracks:
    """Return tracks of two bodies: their heights with noise."""
    rng = np.random.default_rng(seed)
    tracks = [
        Track(time=time, position=height + noise * rng.normal(size=time.size))
        for height in (plate, projectile)
    ]
    return ThrowTracks(name='simulated', plate=tracks[0], projectile=tracks[1])


def _make_throw(
    rig: Rig, *, rate=5000.0, duration=0.1, start=0.0153, zeros=(0.0, 0.0), **options
) -> ThrowTracks:
    """Return the tracks of an exact throw, measured from given zeros of height."""
    time = np.arange(0.0, duration, 1.0 / rate)
    since = time - start
    plate = Underdamped.of(rig.engine).position(since)
    projectile = follow(rig, until=since[-1]).projectile_position(since)
    return _measure(time, plate - zeros[0], projectile - zeros[1], **options)


def _make_model(rig: Rig, throws: list[ThrowTracks], description: FitDescription) -> RigModel:
    """Return the model of throws around a rig, with the fits of the plates alone."""
    plates = tuple(fit_plate(throw.plate) for throw in throws)
    return RigModel(tuple(throws), rig, description, ThrowSimulator(), plates)


@pytest.fixture
def see() -> Callable[..., ThrowTracks]:
    return _measure


@pytest.fixture(scope='session')
def make_throw() -> Callable[..., ThrowTracks]:
    return _make_throw


@pytest.fixture(scope='session')
def make_model() -> Callable[..., RigModel]:
    return _make_model


@pytest.fixture(scope='session')
def reference_throw() -> ThrowTracks:
    """Return the 5 kHz reference tracks with 20 um of noise, whose best fits are known."""
    with (DATA / 'reference_tracks.csv').open() as file:
        return ThrowTracks(
            name='reference', **read_csv(file, 'reference', ('plate', 'projectile'))
        )
