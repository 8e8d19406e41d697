# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rigs made from dimensionless ratios, and throws with exactly known results."""

import math

from hypothesis import strategies as st
import numpy as np
from soft_throw_ros.core.closed_form import first_releases, FirstRelease
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig

FREQUENCY = 63.2

# Computed with 40-digit closed forms, checked by a second method, as are the other numbers
# here: mu, kappa, zeta, t_e f, alpha
EXACT = [
    # largest alpha
    (0.23423068535205, 8.2422098072057, 0.0, 0.3994399384513045, 4.123214640552163),
    (0.25539654358484, 8.57592101835, 0.064, 0.3866752089467103, 4.1428974402270375),
    (0.29513187784084, 9.2434758430532, 0.2, 0.3633656659293691, 4.185169858004478),
    # the optimum as the paper quotes it
    (0.32, 8.4, 0.0, 0.40509068548650023, 4.1101349744268205),
    (0.325, 8.375, 0.0, 0.4067066018914044, 4.108539651810315),
    # hardly a projectile (x to 1)
    (0.01, 0.2, 0.0, 5.298054795009286, 3.6462835911068816),
    (0.01, 9.0, 0.0, 0.33515423912780706, 3.893042670333522),
    # on both sides of t_e = 3 t_s
    (0.02, 7.91921471164, 0.0, 0.3788004377616592, 3.9989930540910823),
    (0.02, 7.92079871298, 0.0, 0.38180935858819204, 4.019621366767697),
    # t_e > 1 / f
    (0.01, 0.25, 0.0, 4.28907615997982, 3.7636806662064886),
    # almost a spring
    (50.0, 60.0, 0.0, 0.4266129421799032, 3.037440451346464),
    (0.05, 1.0, 0.0, 1.2980547950092867, 3.6462835911068816),
    (1.0, 1.0, 0.0, 1.4590473863951916, 0.25904598562307973),
    (10.0, 1.0, 0.0, 1.4950567137012314, 0.003857550297589455),
    (0.01, 4.0, 0.064, 0.4928020665289209, 3.9990119588094664),
    (0.01, 4.0, 0.2, 0.4749549179660803, 3.9990091315319924),
    # the paper's rig: layers of 2 and 16.8 mm
    (10.594999999999999, 61.70886075949366, 0.0, 0.2523422936190782, 2.2940927492481684),
    (0.6345238095238095, 7.34629294755877, 0.0, 0.4853576867943659, 3.661689320772207),
    (10.594999999999999, 61.70886075949366, 0.064, 0.24693846205383488, 2.4035890540886395),
    (0.6345238095238095, 7.34629294755877, 0.064, 0.48150827831570486, 3.63734724564707),
]

# Of the paper's rig without damping and gravity: thickness [m], largest strain, that at the top
STRAINS = [
    (0.002, 0.20455695136726773, 0.1929978563882354),
    (0.0056, 0.18543981232911014, 0.15991912482862805),
]


def make_rig(
    mass_ratio, speed_ratio, damping_ratio=0.0, gravity_ratio=0.0, *, gravity=None, **layer
):
    """Make a rig with the paper's frequency, amplitude and wave speed."""
    engine = Engine(frequency=FREQUENCY, damping_ratio=damping_ratio)
    layer = Layer(thickness=7.8 / (speed_ratio * FREQUENCY), **layer)
    if gravity is None:
        gravity = gravity_ratio * engine.speed_scale * engine.angular_frequency
    projectile = Projectile(mass=mass_ratio * layer.mass)
    return Rig(engine=engine, layer=layer, projectile=projectile, gravity=gravity)


def make_paper_rig(thickness, *, gravity=0.0, damping_ratio=0.0):
    """Make the paper's rig with its longer projectile."""
    return Rig(
        engine=Engine(damping_ratio=damping_ratio),
        layer=Layer(thickness=thickness),
        projectile=Projectile(mass=1300.0 * 16.3e-3 * math.pi * 6e-3**2, length=16.3e-3),
        gravity=gravity,
    )


def exact_release(rig):
    """Compute the first release of a rig by the closed form, as floats."""
    release = first_releases(
        mass_ratio=rig.mass_ratio, speed_ratio=rig.speed_ratio,
        damping_ratio=rig.engine.damping_ratio, gravity_ratio=rig.gravity_ratio,
    )
    return FirstRelease(*map(float, release))


def released(stepper, periods=12.0):
    """Advance a stepper until the projectile has left, and return it."""
    period = 1.0 / stepper.rig.engine.frequency
    assert stepper.advance_to_release(latest=periods * period), 'no release'
    return stepper


def log_uniform(low, high):
    """Draw from a range of several magnitudes."""
    return st.floats(math.log(low), math.log(high)).map(math.exp)


def order(counts, errors):
    """Return the order of convergence of errors with the number of cells or steps."""
    return -np.polyfit(np.log(counts), np.log(np.abs(errors)), 1)[0]
