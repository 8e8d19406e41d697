# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
The scheme of the paper (Sec. II B), which confirms its figures and the models of the package.

Layer and elastic projectile are a row of nodes. Eq. (2), rho u_tt = (E u_y)_y, is integrated by
Eq. (3), semi-implicit Euler: v += h a, u += h v. The projectile leaves when the tension at y_c
becomes positive, and is in contact again when the gap closes. A layer on the projectile instead of
the plate (ref. 27) leaves the plate in the same way.

`python docs/paper/scheme.py` prints the comparisons, and returns 1 if one of them fails.
"""

from __future__ import annotations

from collections.abc import Iterator
import math
import sys
from typing import NamedTuple

from models import releases_at, SERIES, THICKNESSES
import numba as nb
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig

Floats = NDArray[np.float64]

MODULUS = 3.6e9  # Young's modulus of the projectile, E_r [Pa]

# Exact throws of an elastic projectile of 16.3 mm at 63.2 Hz, with a harmonic plate: thickness of
# the layer [m], t_e f, and the speeds of its centre of mass and of its lower face over A omega
EXACT = (
    (2.0e-3, 0.25234398637936983, 1.5146422569913178, 1.514621268422948),
    (5.6e-3, 0.3689758829724327, 1.809256199489624, 1.8092403238788732),
)


class Release(NamedTuple):
    """A release: t_e f, and speeds over A omega of the centre of mass and of the lower end."""

    phase: float
    speed: float
    face_speed: float


@nb.njit(error_model='numpy')
def _march(mass, spring, link, h, plate, weight, out):
    """Integrate Eq. (3) on nodes, write the releases to `out`, and return their number."""
    size = mass.size
    u, v, tension = np.zeros(size), np.zeros(size), np.zeros(size)
    in_contact, count, pull, a = True, 0, 0.0, 0.0
    for i in range(plate.size - 1):
        for j in range(size - 1):
            tension[j] = spring[j] * (u[j + 1] - u[j])  # E u_y; none above the last node
        v_plate = (plate[i + 1] - plate[i]) / h
        tension[link] = weight  # of a contact without force, from the static equilibrium
        if in_contact:
            before = pull
            if link > 0:  # both nodes of the contact have the same acceleration
                a = (tension[link + 1] - tension[link - 1]) / (mass[link] + mass[link + 1])
            else:
                a = (v_plate - v[0]) / h
            pull = tension[link + 1] - mass[link + 1] * a
            if pull > weight:
                # The tension at y_c changes its sign after the middle of the last step by r
                r = (weight - before) / (pull - before) - 0.5
                momentum, thrown = -r * h * (before + 0.5 * (1.0 + r) * (pull - before)), 0.0
                for j in range(link + 1, size):
                    momentum += mass[j] * v[j]
                    thrown += mass[j]
                out[count, 0], out[count, 1] = (i - 0.5 + r) * h, momentum / thrown
                out[count, 2] = v[link + 1] + r * h * a
                in_contact, count = False, count + 1
                if count == out.shape[0]:
                    break
            else:
                tension[link] = pull
        v[0], u[0] = v_plate, plate[i + 1]
        for j in range(1, size):
            v[j] += h * (tension[j] - tension[j - 1]) / mass[j]
            u[j] += h * v[j]
        if not in_contact and u[link + 1] < u[link]:  # the gap has closed: the nodes are one
            below = mass[link] / (mass[link] + mass[link + 1])
            u[link] = u[link + 1] = below * u[link] + (1.0 - below) * u[link + 1]
            v[link] = v[link + 1] = below * v[link] + (1.0 - below) * v[link + 1]
            in_contact, pull = True, weight
    return count


def releases(
    rig: Rig, *, cells: int, is_glued: bool = False, periods: float = 2.0, limit: int = 1
) -> list[Release]:
    """
    Follow a throw of an elastic projectile for some periods, or up to a number of releases.

    The layer has at least so many cells, the projectile at least 2 of the same crossing time. If
    it `is_glued`, the layer is on the projectile (ref. 27) instead of the plate.
    """
    layer, projectile, engine = rig.layer, rig.projectile, rig.engine
    stiffness = MODULUS * layer.section / projectile.length
    crossing = math.sqrt(projectile.mass / stiffness)
    cells = max(cells, math.ceil(2.0 * rig.crossing_time / crossing))
    step = rig.crossing_time / cells  # the longest that is stable, without dispersion
    others = math.floor(crossing / step)
    first, contact = (1, 0) if is_glued else (0, cells)
    mass, spring = np.zeros((2, cells + others + 2))
    for start, count, whole, elastic in (
        (first, cells, layer.mass, layer.stiffness),
        (cells + 1, others, projectile.mass, stiffness),
    ):
        mass[start:start + count] += 0.5 * whole / count
        mass[start + 1:start + count + 1] += 0.5 * whole / count
        spring[start:start + count] = elastic * count
    times = step * np.arange(math.ceil(periods / (engine.frequency * step)))
    plate, out = Underdamped.of(engine).position(times), np.empty((limit, 3))
    weight = mass[contact + 1:].sum() * rig.gravity
    found = _march(mass, spring, contact, step, plate, weight, out)
    out *= engine.frequency, 1.0 / engine.speed_scale, 1.0 / engine.speed_scale
    return [Release(*row) for row in out[:found].tolist()]


def _of_the_map(x: float, c: float, *, is_glued: bool = False) -> tuple[float, float]:
    """Return t_e f and alpha at a point of the paper's map, whose densities are equal."""
    projectile = Projectile(mass=Layer().density * Layer().section * 8.2e-3, length=8.2e-3)
    layer = Layer(thickness=projectile.length * x / (1.0 - x))
    engine = Engine(frequency=x * layer.wave_speed / (c * layer.thickness), damping_ratio=0.0)
    rig = Rig(engine=engine, layer=layer, projectile=projectile, gravity=0.0)
    (release,) = releases(rig, cells=200, is_glued=is_glued, periods=8.0)
    return release.phase, release.speed**2


def _comparisons() -> Iterator[tuple[str, float, float, float]]:
    """Yield quantities with their values by the scheme, expected values and tolerances."""
    x, c = np.meshgrid(np.linspace(0.05, 0.95, 13), np.linspace(1.0, 13.0, 13))
    exact = releases_at(x, c)
    points = np.array([_of_the_map(*point) for point in zip(x.flat, c.flat, strict=True)])
    for number, name in enumerate(('ejection_phase', 'energy_transfer')):
        errors = np.abs(points[:, number] - np.ravel(getattr(exact, name)))
        yield f'Fig. 3: error of {name}, 95 % of the map', np.quantile(errors, 0.95), 0.0, 1e-4
    for x_best, c_best, alpha in ((0.01, 1.02, 3.13), (0.8, 6.7, 4.12)):  # as printed
        speeds = np.linspace(0.8, 1.2, 41) * c_best
        alphas = [_of_the_map(x_best, speed)[1] for speed in speeds.tolist()]
        transfers = np.asarray(releases_at(x_best, speeds).energy_transfer)
        yield f'Fig. 4: largest alpha at x = {x_best}', max(alphas), alpha, 5e-3
        yield 'the same by the closed form', max(alphas), transfers.max(), 1e-4
        yield 'best C', speeds[np.argmax(alphas)], c_best, 0.011 * c_best
    yield 'Fig. 4: alpha at x = 0.98, C = 6', _of_the_map(0.98, 6.0)[1], 4.0, 5e-3
    for number, series in enumerate(SERIES, 1):
        rigid, changes = series.throws(damping_ratio=0.0), []
        for n, thickness in enumerate(THICKNESSES.tolist()):
            (elastic,) = releases(series.rig(thickness, damping_ratio=0.0), cells=1000)
            changes.append(elastic.phase / (rigid.ejection_time[n] * series.frequency) - 1.0)
            changes.append(elastic.speed * series.engine_speed / rigid.ejection_speed[n] - 1.0)
        change = max(map(abs, changes))
        yield f'Fig. 5: change by elasticity, series {number}', change, 1e-5, 2e-6
    thin = SERIES[2].rig(THICKNESSES[0], damping_ratio=0.0)
    *_, last = releases(thin, cells=400, limit=100)
    yield 'Fig. 5: alpha of the last release, series 3, 2 mm', last.speed**2, 1.241, 1e-3
    for thickness, *values in EXACT:
        (release,) = releases(SERIES[0].rig(thickness, damping_ratio=0.0), cells=1000)
        for name, ours, value in zip(Release._fields, release, values, strict=True):
            yield f'exact elastic projectile, {1e3 * thickness:g} mm: {name}', ours, value, 1e-6
    (glued,) = releases(Rig(), cells=200, is_glued=True)
    peak = Underdamped.of(Rig().engine).peak_velocity / Rig().engine.speed_scale
    yield 'alpha of the default rig, layer glued on', (glued.speed / peak) ** 2, 2.175, 1e-3
    glued_on = [_of_the_map(0.01, c, is_glued=True)[1] for c in np.linspace(1.0, 1.05, 21)]
    yield 'largest alpha at x = 0.01, layer glued on', max(glued_on), 3.114, 1e-3


def main() -> int:
    """Print all comparisons; return 1 if the scheme misses a value."""
    is_confirmed = True
    for name, ours, expected, tolerance in _comparisons():
        is_met = abs(ours - expected) <= tolerance
        is_confirmed = is_confirmed and is_met
        print(f'{name:55} {ours:<14.9g} {expected:<14.9g} {"" if is_met else "missed"}')
    return 0 if is_confirmed else 1


if __name__ == '__main__':
    sys.exit(main())
