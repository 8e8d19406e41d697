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
    (0.23423068535205, 8.2422098072057, 0.0, 0.3994399384513045, 4.123214640552163),  # largest
    (0.29513187784084, 9.2434758430532, 0.2, 0.3633656659293691, 4.185169858004478),
    (0.01, 0.2, 0.0, 5.298054795009286, 3.6462835911068816),  # hardly a projectile
    (0.02, 7.91921471164, 0.0, 0.3788004377616592, 3.9989930540910823),  # t_e below 3 t_s
    (0.02, 7.92079871298, 0.0, 0.38180935858819204, 4.019621366767697),  # and above
    (0.01, 0.25, 0.0, 4.28907615997982, 3.7636806662064886),  # t_e > 1 / f
    (50.0, 60.0, 0.0, 0.4266129421799032, 3.037440451346464),  # almost a spring
    (10.0, 1.0, 0.0, 1.4950567137012314, 0.003857550297589455),
    # the paper's rig: layers of 2 and 16.8 mm
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


def make_paper_rig(thickness):
    """Make the paper's rig with its longer projectile, without damping and gravity."""
    projectile = Projectile(mass=1300.0 * 16.3e-3 * math.pi * 6e-3**2)
    engine, layer = Engine(damping_ratio=0.0), Layer(thickness=thickness)
    return Rig(engine=engine, layer=layer, projectile=projectile, gravity=0.0)


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
