# SPDX-License-Identifier: Apache-2.0
"""The numbers that the paper prints beside those that come out here, and some that it does not."""

from __future__ import annotations

from dataclasses import dataclass
import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh_tridiagonal
from scipy.optimize import minimize_scalar
from soft_throw_ros.commands.paper import limits
from soft_throw_ros.commands.paper.rig_series import (
    DAMPING_RATIO,
    PROJECTILE_DENSITY,
    SERIES,
    Series,
    THICKNESSES,
)
from soft_throw_ros.core import normal_modes, spring_mass
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, STANDARD_GRAVITY
from soft_throw_ros.core.travelling_wave import first_release, first_releases, FirstRelease
from soft_throw_ros.design.recommendation import best_ratios, BestRatios, PAPER_RATIOS

Floats = NDArray[np.float64]

_LOSS_TANGENT = 0.02


class Published(NamedTuple):
    """What is printed, the least and the largest value that it allows, and it if it is one."""

    text: str
    low: float
    high: float
    value: float | None = None


def printed(digits: str) -> Published:
    """Read a number as it is printed: it may be off by half a unit of its last digit."""
    value, half = float(digits), 0.5 * 10.0 ** -len(digits.partition('.')[2])
    return Published(digits, value - half, value + half, value)


@dataclass(frozen=True, kw_only=True)
class Row:
    """
    A quantity of the paper.

    Parameters
    ----------
    quantity, where : str
        What it is, and where in the paper.
    paper : Published
        What is printed there.
    ours : float or tuple of float
        One value, or the least and the largest.
    digits : int
        Decimals of ours that are shown.
    why : str
        Why the two differ, or what is to be known about it.

    """

    quantity: str
    where: str
    paper: Published
    ours: float | tuple[float, float]
    digits: int
    why: str = ''

    @property
    def agrees(self) -> bool:
        """Whether all of ours is within what the paper says."""
        return bool(self.paper.low <= np.min(self.ours) and np.max(self.ours) <= self.paper.high)

    @property
    def difference(self) -> float | None:
        """Ours less the paper's, if it is one number there and here."""
        if isinstance(self.ours, tuple) or self.paper.value is None:
            return None
        return self.ours - self.paper.value


class Fact(NamedTuple):
    """Something that the paper does not say, with our value as text."""

    quantity: str
    ours: str


@functools.lru_cache(maxsize=1)
def published() -> tuple[Row, ...]:
    """Compute everything that the paper prints a number for."""
    return (*_optimum(), *_limits(), *_rig())


def _optimum() -> tuple[Row, ...]:
    """Secs. III and IV: the best layer, with projectile and layer equally dense."""
    best = best_ratios(0.0)
    x = 1.0 / (1.0 + best.mass_ratio)
    mu, kappa = PAPER_RATIOS
    quoted = BestRatios.at(mass_ratio=mu, speed_ratio=kappa, damping_ratio=0.0)
    light = 1e-6
    plateau = first_release(mass_ratio=light, speed_ratio=4.0).energy_transfer
    edge = _end_of_plateau(light)
    near = 0.99
    before = near * _end_of_plateau(1.0 / near - 1.0)
    factor, ridge = _ridge(1e-4)
    mixed = f'{kappa:g} = 6.7/0.8 is of equal densities, {mu:g} = 1.3 x 0.25 of a ratio of 1.3'
    return (
        Row(
            quantity='best x = L_s/(L_s + L_r)',
            where='Sec. III, Fig. 4',
            paper=printed('0.8'),
            ours=x,
            digits=4,
            why=f'equal densities; {_best_place(1.3)[0]:.4f} for the 1.3 of the rig',
        ),
        Row(
            quantity='best C = c_s/(L_s + L_r)f',
            where='Sec. III, Fig. 4',
            paper=printed('6.7'),
            ours=x * best.speed_ratio,
            digits=3,
            why=f'equal densities; {_best_place(1.3)[1]:.3f} for the 1.3 of the rig',
        ),
        Row(
            quantity='largest alpha',
            where='Sec. III, Fig. 4',
            paper=printed('4.12'),
            ours=best.energy_transfer,
            digits=4,
        ),
        Row(
            quantity='its t_e/t_s',
            where='Sec. IV B',
            paper=Published('between 3 and 5', 3.0, 5.0),
            ours=best.ejection_phase * best.speed_ratio,
            digits=4,
        ),
        Row(
            quantity='its m/(rho_s S L_s)',
            where='Sec. III',
            paper=printed(f'{mu:g}'),
            ours=best.mass_ratio,
            digits=4,
            why=mixed,
        ),
        Row(
            quantity='its c_s/(L_s f)',
            where='Sec. III',
            paper=printed(f'{kappa:g}'),
            ours=best.speed_ratio,
            digits=4,
            why=mixed,
        ),
        Row(
            quantity=f'alpha at these two, ({mu:g}, {kappa:g})',
            where='Sec. III',
            paper=printed('4.12'),
            ours=quoted.energy_transfer,
            digits=4,
            why='as they do not belong together, they are not quite the optimum',
        ),
        Row(
            quantity='alpha of a thick soft layer, x = 1',
            where='Secs. III, IV A',
            paper=printed('4'),
            ours=float(plateau),
            digits=4,
        ),
        Row(
            quantity='largest C for that',
            where='Sec. III',
            paper=printed('7.9'),
            ours=edge,
            digits=3,
            why=f'exactly 8 at x = 1; {before:.2f} at x = {near:g}',
        ),
        Row(
            quantity='the same by the analysis',
            where='Sec. IV A',
            paper=printed('8'),
            ours=edge,
            digits=3,
        ),
        Row(
            quantity='ridge for small x: C/sqrt(x)',
            where='Fig. 4',
            paper=printed('10.2'),
            ours=factor,
            digits=2,
            why=f'equal densities; {math.sqrt(1.3) * factor:.2f} for the 1.3 of the rig',
        ),
        Row(
            quantity='alpha on it',
            where='Fig. 4',
            paper=printed('3.13'),
            ours=ridge,
            digits=4,
        ),
        Row(
            quantity='alpha on the axes, C = 0 or x = 0',
            where='Fig. 4',
            paper=printed('0'),
            ours=_alpha_at_axes(),
            digits=4,
            why='of the first release; the last one tends to 1 for x = 0',
        ),
        Row(
            quantity='t_e f without a layer',
            where='Fig. 3',
            paper=printed('0.25'),
            ours=_harmonic().peak_velocity_time * Engine().frequency,
            digits=4,
            why='of the last release; the first one tends to 0',
        ),
        Row(
            quantity='alpha without a layer',
            where='Fig. 3',
            paper=printed('1'),
            ours=_bare_transfer(),
            digits=4,
            why='of the last release; the first one tends to 0',
        ),
    )


def _limits() -> tuple[Row, ...]:
    """Apps. A to C: the massless spring, the free layer, and thick layers."""
    ratio = spring_mass.best_frequency_ratio()
    spring = spring_mass.first_release(frequency_ratio=ratio)
    small, medium, large = 0.01, 0.1, 1e5
    light, lighter = limits.exact(medium), limits.exact(small)
    rest = light.angle - 0.5 * math.pi - math.atan(medium)
    return (
        Row(
            quantity='best f0/f of a massless spring',
            where='App. A, Fig. 7',
            paper=printed('1.62'),
            ours=ratio,
            digits=4,
        ),
        Row(
            quantity='its alpha',
            where='App. A, Fig. 7',
            paper=printed('3.13'),
            ours=float(spring.energy_transfer),
            digits=4,
        ),
        Row(
            quantity='period of a free layer, T_0 c_s/L_s',
            where='App. B',
            paper=printed('2'),
            ours=_free_period(1000),
            digits=4,
            why='free at both ends; a layer that is glued to the plate rings with twice that',
        ),
        Row(
            quantity='(4 - alpha)/(omega tau)^2 for small omega tau',
            where='App. C(i)',
            paper=printed('2'),
            ours=float((4.0 - lighter.energy_transfer) / small**2),
            digits=3,
            why='misprint: alpha -> 4 - 4 (omega tau - e^(-1 - pi/(2 omega tau)))^2',
        ),
        Row(
            quantity='factor of e^(-pi/(2 omega tau)) in omega (t_e - t_s)',
            where='App. C(i)',
            paper=printed('1'),
            ours=float(rest * math.exp(math.pi / (2.0 * medium))),
            digits=3,
            why='misprint: it is -1/e, beside pi/2 + omega tau - ...',
        ),
        Row(
            quantity='alpha (omega tau)^2 for large omega tau',
            where='App. C(ii)',
            paper=printed('16'),
            ours=float(limits.exact(large).energy_transfer * large**2),
            digits=2,
        ),
    )


def _rig() -> tuple[Row, ...]:
    """Secs. II and III, App. D: what holds for the paper's rig."""
    third = SERIES[2]
    change = np.concatenate([_change_by_damping(series) for series in SERIES])
    strains = {
        frequency: np.concatenate(
            [
                100.0 * series.peak_strains(damping_ratio=0.0)
                for series in SERIES
                if series.frequency == frequency
            ]
        )
        for frequency in _frequencies()
    }
    return (
        *(
            Row(
                quantity=f'largest strain at {frequency:g} Hz (%)',
                where='text',
                paper=Published('below 10', 0.0, 10.0),
                ours=_range(found),
                digits=1,
                why='with A = 2 mm and without damping; proportional to A',
            )
            for frequency, found in strains.items()
        ),
        Row(
            quantity='wave speed in the projectile, c_r (m/s)',
            where='text',
            paper=printed('1700'),
            ours=math.sqrt(Projectile().youngs_modulus / PROJECTILE_DENSITY),
            digits=0,
            why='E_r = 3.6 GPa and 1300 kg/m3, rounded to hundreds',
        ),
        Row(
            quantity='c_s/(L_r f) of the third series',
            where='text',
            paper=printed('34.5'),
            ours=third.speed,
            digits=1,
            why='misprint: 7.8 m/s, 8.2 mm and 31.1 Hz make 30.6',
        ),
        Row(
            quantity='lower frequency of the plate (Hz)',
            where='App. D',
            paper=Published('31.2 +- 0.1', 31.2 - 0.1, 31.2 + 0.1),
            ours=third.frequency,
            digits=1,
            why='31.1 in the text, which is taken here',
        ),
        Row(
            quantity='change of alpha by the damping of 0.064 (%)',
            where='App. D',
            paper=Published('a few', -5.0, 5.0),
            ours=_range(change),
            digits=1,
            why=f'half of the throws are within {np.median(np.abs(change)):.1f}; most is where a '
            'thin layer transfers little',
        ),
    )


@functools.lru_cache(maxsize=1)
def beyond() -> tuple[Fact, ...]:
    """Compute what the paper leaves out and a builder has to know."""
    best = best_ratios(0.0)
    lossy = normal_modes.first_release(
        mass_ratio=best.mass_ratio, speed_ratio=best.speed_ratio, loss_tangent=_LOSS_TANGENT
    )
    soft_ratio, soft = _best_with_loss(1e-4)
    third = SERIES[2]
    thin = THICKNESSES[:1]
    first = np.asarray(third.releases(thin, damping_ratio=0.0).energy_transfer)
    last = third.last_releases(thin, damping_ratio=0.0).energy_transfer
    elastic = max(_change_by_elasticity(series) for series in SERIES)
    optima = (
        Fact(
            f'best layer for zeta = {zeta:g}, any density',
            f'mu = {found.mass_ratio:.4f}, kappa = {found.speed_ratio:.4f}: '
            f't_e f = {found.ejection_phase:.4f}, alpha = {found.energy_transfer:.4f}',
        )
        for zeta in (0.0, DAMPING_RATIO, 0.2)
        for found in [best_ratios(zeta)]
    )
    return (
        *optima,
        Fact(
            f'alpha of the first of these with a loss tangent of {_LOSS_TANGENT:g} at f',
            f'{lossy.energy_transfer:.3f}',
        ),
        Fact(
            'best layer with that loss',
            f'thick and soft: mu -> 0, kappa = {soft_ratio:.1f}, alpha = {soft:.3f}',
        ),
        Fact(
            f'alpha of the third series with {1e3 * thin[0]:.1f} mm',
            f'{first[0]:.3f} at the first release, {last[0, 0]:.3f} at the last',
        ),
        *(_fact_of_gravity(frequency) for frequency in _frequencies()),
        _fact_of_sag(),
        Fact(
            'an elastic projectile, E_r = 3.6 GPa, on the rig',
            f't_e and V_e change by at most {100.0 * elastic:.4f} %: it may be taken as rigid',
        ),
    )


def _frequencies() -> list[float]:
    return sorted({series.frequency for series in SERIES}, reverse=True)


def _fact_of_gravity(frequency: float) -> Fact:
    changes = [_change_by_gravity(series) for series in SERIES if series.frequency == frequency]
    later, slower = (_range(np.concatenate(found)) for found in zip(*changes, strict=True))
    return Fact(
        f'gravity of {STANDARD_GRAVITY:g} m/s2 on the rig at {frequency:g} Hz',
        f't_e later by {later[0]:.1f} to {later[1]:.1f} %, V_e lower by up to {-slower[0]:.2f} %',
    )


def _fact_of_sag() -> Fact:
    """Tell how far gravity presses the thickest layer down, by the projectile and by itself."""
    layer = Layer(thickness=THICKNESSES[-1])
    longest = max(series.projectile_length for series in SERIES)
    per_length = STANDARD_GRAVITY * layer.thickness / layer.youngs_modulus
    by_projectile = 1e3 * PROJECTILE_DENSITY * longest * per_length
    by_itself = 1e3 * 0.5 * layer.density * layer.thickness * per_length
    return Fact(
        'its static sag of the thickest layer',
        f'{by_projectile:.2f} mm by the projectile, {by_itself:.2f} mm by the layer, which the '
        'models leave out',
    )


def _range(values: Floats) -> tuple[float, float]:
    return float(np.min(values)), float(np.max(values))


def _best_place(density_ratio: float) -> tuple[float, float]:
    """Tell where the optimum is on the axes x and C."""
    best = best_ratios(0.0)
    x = density_ratio / (density_ratio + best.mass_ratio)
    return x, x * best.speed_ratio


def _end_of_plateau(mass_ratio: float) -> float:
    """Find the speed ratio at which the release stops being one before the wave's return."""
    low, high = 7.0, 9.0
    while (middle := 0.5 * (low + high)) not in (low, high):
        found = first_release(mass_ratio=mass_ratio, speed_ratio=middle)
        low, high = (middle, high) if found.ejection_phase * middle <= 3.0 else (low, middle)
    return low


def _ridge(x: float) -> tuple[float, float]:
    """Find C / sqrt(x) of the largest energy transfer at a small x, and that."""

    def loss(factor: float) -> float:
        speed_ratio = factor * math.sqrt(x) / x
        found = first_release(mass_ratio=(1.0 - x) / x, speed_ratio=speed_ratio)
        return -float(found.energy_transfer)

    found = minimize_scalar(loss, bounds=(9.0, 12.0), method='bounded', options={'xatol': 1e-5})
    return float(found.x), -float(found.fun)


def _alpha_at_axes() -> float:
    """Compute the largest energy transfer close to C = 0 and close to x = 0."""
    x = np.array([0.2, 0.5, 0.8, 1e-5, 1e-5])
    c = np.array([0.01, 0.01, 0.01, 3.0, 10.0])
    return float(np.max(_at(x, c).energy_transfer))


def _at(x: Floats, c: Floats) -> FirstRelease:
    """Compute releases at places of Fig. 4."""
    return first_releases(mass_ratio=(1.0 - x) / x, speed_ratio=c / x)


def _harmonic() -> Underdamped:
    return Underdamped.of(Engine(damping_ratio=0.0))


def _bare_transfer() -> float:
    """Compute the energy transfer of a projectile that leaves the plate when that brakes."""
    plate = _harmonic()
    return float((plate.velocity(plate.peak_velocity_time) / plate.peak_velocity) ** 2)


def _free_period(cells: int) -> float:
    """Compute the longest period of a bar that is free at both ends, in crossings."""
    # Masses at the ends are half a cell's; scaled so that the matrix is symmetric
    mass = np.ones(cells + 1)
    mass[[0, -1]] = 0.5
    stiffness = np.full(cells + 1, 2.0)
    stiffness[[0, -1]] = 1.0
    coupling = -1.0 / np.sqrt(mass[:-1] * mass[1:])
    _, lowest = eigvalsh_tridiagonal(stiffness / mass, coupling, select='i', select_range=(0, 1))
    return 2.0 * math.pi / (math.sqrt(lowest) * cells)


def _change_by_damping(series: Series) -> Floats:
    """Compute by how much damping changes the energy transfer from the six layers. [%]"""
    harmonic, damped = (
        np.asarray(series.releases(THICKNESSES, damping_ratio=zeta).energy_transfer)
        for zeta in (0.0, DAMPING_RATIO)
    )
    return np.asarray(100.0 * (damped / harmonic - 1.0))


def _change_by_gravity(series: Series) -> tuple[Floats, Floats]:
    """Compute the changes of t_e and V_e from the six layers. [%]"""
    engine = Engine(frequency=series.frequency)
    ratio = STANDARD_GRAVITY / (engine.speed_scale * engine.angular_frequency)
    without, under = (
        first_releases(
            **series.ratios(THICKNESSES), damping_ratio=DAMPING_RATIO, gravity_ratio=gravity_ratio
        )
        for gravity_ratio in (0.0, ratio)
    )
    return (
        np.asarray(100.0 * (under.ejection_phase / without.ejection_phase - 1.0)),
        np.asarray(100.0 * (under.speed / without.speed - 1.0)),
    )


def _change_by_elasticity(series: Series) -> float:
    """Compute the largest relative change of t_e and V_e if the projectile is elastic."""
    rigid = series.releases(THICKNESSES, damping_ratio=0.0)
    elastic = series.elastic_releases(damping_ratio=0.0)
    later = elastic.ejection_phase[:, 0] / rigid.ejection_phase - 1.0
    faster = np.sqrt(elastic.energy_transfer[:, 0] / rigid.energy_transfer) - 1.0
    return float(np.max(np.abs([later, faster])))


def _best_with_loss(mass_ratio: float) -> tuple[float, float]:
    """Find the speed ratio of the largest energy transfer of a lossy layer, and that."""

    def loss(speed_ratio: float) -> float:
        found = normal_modes.first_release(
            mass_ratio=mass_ratio, speed_ratio=speed_ratio, loss_tangent=_LOSS_TANGENT
        )
        return -float(found.energy_transfer)

    found = minimize_scalar(loss, bounds=(4.0, 8.0), method='bounded', options={'xatol': 1e-3})
    return float(found.x), -float(found.fun)
