# SPDX-License-Identifier: Apache-2.0
"""Rigs by the numbers that decide a throw."""

import math

import pytest
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig

FREQUENCY = 63.2


def make_rig(mass_ratio, speed_ratio, damping_ratio=0.0, gravity_ratio=0.0):
    """Make a rig with the paper's frequency, amplitude and wave speed."""
    engine = Engine(frequency=FREQUENCY, damping_ratio=damping_ratio)
    layer = Layer(thickness=7.8 / (speed_ratio * FREQUENCY), wave_speed=7.8)
    return Rig(
        engine=engine,
        layer=layer,
        projectile=Projectile(mass=mass_ratio * layer.mass),
        gravity=gravity_ratio * engine.speed_scale * engine.angular_frequency,
    )


def make_paper_rig(thickness, *, gravity=9.81, damping_ratio=0.064):
    """Make the paper's rig with its longer projectile."""
    return Rig(
        engine=Engine(frequency=FREQUENCY, amplitude=2e-3, damping_ratio=damping_ratio),
        layer=Layer(thickness=thickness),
        projectile=Projectile(mass=1300.0 * 16.3e-3 * math.pi * 6e-3**2),
        gravity=gravity,
    )


@pytest.fixture(name='make_rig')
def _make_rig():
    return make_rig


@pytest.fixture(name='make_paper_rig')
def _make_paper_rig():
    return make_paper_rig
