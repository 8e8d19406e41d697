# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The rig of the paper and its throws, without gravity as in all figures of the paper."""

from __future__ import annotations

from dataclasses import dataclass
import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigvalsh_tridiagonal
from scipy.optimize import minimize, minimize_scalar
from soft_throw_ros.core.closed_form import first_releases, FirstRelease, spring_release
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.throw import throw_many, Throws
from soft_throw_ros.core.wave_stepper import WaveStepper

Floats = NDArray[np.float64]

THICKNESSES: Floats = np.array([2.0, 5.6, 9.5, 16.8, 23.4, 29.1]) * 1e-3  # of the layers [m]
DAMPING_RATIO = 0.064  # of the plate (App. D) [-]
PROJECTILE_DENSITY = 1300.0  # [kg/m3]


def releases_at(x: ArrayLike, c: ArrayLike, *, damping_ratio: float = 0.0) -> FirstRelease:
    """Compute first releases over the axes of the paper, with equal densities."""
    x, c = np.broadcast_arrays(np.asarray(x, dtype=np.float64), c)
    return first_releases(mass_ratio=(1.0 - x) / x, speed_ratio=c / x, damping_ratio=damping_ratio)


def releases_of(rig: Rig, *, periods: float) -> list[tuple[float, float]]:
    """Return phase t_e f and speed over A omega of all releases within a number of periods."""
    stepper = WaveStepper(rig, field_points=2)
    stepper.advance_to(periods / rig.engine.frequency + 4.0 * rig.crossing_time)
    return [
        (event.time * rig.engine.frequency, event.velocity / rig.engine.speed_scale)
        for event in stepper.events()
        if event.kind == 'release'
    ]


class BestRatios(NamedTuple):
    """Mass ratio, speed ratio and their release: t_e f and energy transfer factor [-]."""

    mass_ratio: float
    speed_ratio: float
    ejection_phase: float
    energy_transfer: float


@functools.lru_cache(maxsize=64)
def best_ratios(damping_ratio: float) -> BestRatios:
    """Find the ratios that transfer the most energy without limits, gravity and loss."""

    def loss(logs: Floats) -> float:
        mu, kappa = np.exp(logs)
        release = first_releases(mass_ratio=mu, speed_ratio=kappa, damping_ratio=damping_ratio)
        return -float(release.energy_transfer)

    found = minimize(loss, np.log([0.26, 8.5]), method='Nelder-Mead', tol=1e-10)
    mu, kappa = np.exp(found.x).tolist()
    release = first_releases(mass_ratio=mu, speed_ratio=kappa, damping_ratio=damping_ratio)
    return BestRatios(mu, kappa, float(release.ejection_phase), -found.fun)


@dataclass(frozen=True, kw_only=True)
class Series:
    """One projectile on one engine, thrown from layers of one material."""

    frequency: float  # of the plate [Hz]
    projectile_length: float  # [m]
    printed: str  # value of `speed` in the paper

    @property
    def speed(self) -> float:
        """:math:`c_s / (L_r f)`, which identifies the series in the paper [-]."""
        return Layer().wave_speed / (self.projectile_length * self.frequency)

    @property
    def engine_speed(self) -> float:
        """Largest speed of the plate without damping, A omega [m/s]."""
        return Engine(frequency=self.frequency).speed_scale

    def x_of(self, thickness: ArrayLike) -> Floats:
        """Return :math:`x = L_s / (L_s + L_r)`, the axis of the paper [-]."""
        thickness = np.asarray(thickness, dtype=np.float64)
        return np.asarray(thickness / (thickness + self.projectile_length))

    def rig(self, thickness: float, *, damping_ratio: float) -> Rig:
        """Return the rig with one of the layers."""
        layer = Layer(thickness=thickness)
        return Rig(
            engine=Engine(frequency=self.frequency, damping_ratio=damping_ratio),
            layer=layer,
            projectile=Projectile(
                mass=PROJECTILE_DENSITY * layer.section * self.projectile_length,
                length=self.projectile_length,
            ),
            gravity=0.0,
        )

    def throws(
        self, thickness: ArrayLike = THICKNESSES, *, damping_ratio: float, loads: bool = False
    ) -> Throws:
        """Compute first releases; the arguments are those of `throw_many`."""
        rig = self.rig(THICKNESSES[0], damping_ratio=damping_ratio)
        return throw_many(rig, {'thickness': thickness}, loads=loads)


SERIES = (
    Series(frequency=63.2, projectile_length=16.3e-3, printed='7.57'),
    Series(frequency=63.2, projectile_length=8.2e-3, printed='15.1'),
    Series(frequency=31.1, projectile_length=8.2e-3, printed='34.5'),
)
"""The series of the paper, in its order."""


def period_of_free_layer(cells: int) -> float:
    """Return the longest period of a row of masses that is free at both ends, in crossings."""
    stiffness = np.full(cells, 2.0)
    stiffness[[0, -1]] = 1.0
    _, lowest = eigvalsh_tridiagonal(
        stiffness, -np.ones(cells - 1), select='i', select_range=(0, 1)
    )
    return 2.0 * math.pi / (math.sqrt(lowest) * cells)


def best_frequency_ratio() -> float:
    """Return the frequency ratio f_0 / f of the massless spring that transfers most energy."""

    def loss(ratio: float) -> float:
        return -float(spring_release(frequency_ratio=ratio).energy_transfer)

    result = minimize_scalar(loss, bounds=(1.1, 2.9), method='bounded', options={'xatol': 1e-9})
    return float(result.x)


def thick_layer(omega_tau: float) -> tuple[float, float]:
    r"""Return :math:`\omega (t_e - t_s)` [rad] and energy transfer of a thick layer (App. C)."""
    speed_ratio = 1.0  # any value below 4: the wave returns after half a plate period
    mass_ratio = omega_tau * speed_ratio / (2.0 * math.pi)
    release = first_releases(mass_ratio=mass_ratio, speed_ratio=speed_ratio)
    angle = 2.0 * math.pi * (float(release.ejection_phase) - 1.0 / speed_ratio)
    return angle, float(release.energy_transfer)
