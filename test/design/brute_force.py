# SPDX-License-Identifier: Apache-2.0
"""Random requests for a layer, and the best layer of a fine grid to compare with."""

from dataclasses import replace
import math

import numpy as np
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.design.objective import LayerScore, Limits, Peak, Robust, Versatile
from soft_throw_ros.design.recommendation import search_spaces

MATERIALS = library().materials
KINDS = ('peak', 'robust', 'quantile', 'versatile', 'limits', 'library')


def random_rig(random, *, loss_tangent=0.0):
    """Return a rig of the size of the paper's, with or without gravity."""
    return Rig(
        engine=Engine(
            frequency=random.uniform(15.0, 200.0),
            amplitude=random.uniform(1e-3, 4e-3),
            damping_ratio=random.uniform(0.0, 0.3),
        ),
        layer=Layer(
            thickness=random.uniform(2e-3, 0.04),
            wave_speed=random.uniform(4.0, 40.0),
            loss_tangent=loss_tangent,
        ),
        projectile=Projectile(mass=math.exp(random.uniform(math.log(2e-4), math.log(5e-3)))),
        gravity=random.choice([0.0, 9.81]),
    )


def random_request(kind, random, *, loss_tangent=0.0):
    """Return a rig, and what is asked of its layer, as keyword arguments of `recommend`."""
    rig = random_rig(random, loss_tangent=loss_tangent)
    request = {
        'vary': 'library' if kind == 'library' else str(random.choice(['both', 'thickness'])),
        'objective': Peak(),
        'limits': Limits(
            thickness_min=random.uniform(1e-3, 3e-3), thickness_max=random.uniform(0.01, 0.05),
            wave_speed_min=random.uniform(1.0, 4.0), wave_speed_max=random.uniform(15.0, 50.0),
        ),
    }  # fmt: skip
    if kind == 'robust':
        request['objective'] = Robust()
    elif kind == 'quantile':
        request['objective'] = Robust(quantile=0.05)
    elif kind == 'versatile':
        masses = rig.projectile.mass * random.uniform(0.5, 2.0, 2)
        frequencies = rig.engine.frequency * random.uniform(0.7, 1.4, 2)
        request['objective'] = Versatile(masses=tuple(masses), frequencies=tuple(frequencies))
    elif kind == 'limits':
        request['limits'] = replace(
            request['limits'],
            max_strain=random.uniform(0.03, 0.2),
            max_acceleration=random.uniform(0.5, 2.0) * 1e-3 * (2.0 * math.pi * 63.0) ** 2,
        )
    elif kind == 'library':
        few = ('gelatin', 'ecoflex_00-30', 'sorbothane_30')
        request['materials'] = {name: MATERIALS[name] for name in few}
    return rig, request


def best_of_a_grid(rig, request, *, size):
    """Return the highest score of `size` thicknesses and wave speeds, or as many of a library."""
    best = 0.0
    for space in search_spaces(
        rig, request['vary'], request['limits'], request.get('materials', {})
    ):
        thicknesses, wave_speeds = (
            np.geomspace(low, high, size if low < high else 1) for low, high in space.layers
        )
        if 1 in (thicknesses.size, wave_speeds.size) and thicknesses.size * wave_speeds.size > 1:
            thicknesses, wave_speeds = (
                np.geomspace(low, high, 20 * size if low < high else 1)
                for low, high in space.layers
            )
        score = LayerScore(space.rig, request['objective'], request['limits'])
        for thickness in thicknesses:
            # what is below the best so far need not be known
            scores = score(np.full(wave_speeds.size, thickness), wave_speeds, least=best)
            best = max(best, scores.max())
    return best
