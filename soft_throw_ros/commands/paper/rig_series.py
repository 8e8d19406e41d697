# SPDX-License-Identifier: Apache-2.0
"""
The three series of throws of the paper: two projectiles, two frequencies, six layers.

Without gravity, as all figures of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.peak import first_peaks
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.core.travelling_wave import first_releases, FirstRelease
from soft_throw_ros.design.landscape import compute_landscape, Landscape

Floats = NDArray[np.float64]

THICKNESSES: Floats = np.array(library().materials['gelatin'].thicknesses)
"""Of the paper's layers. [m]"""

DAMPING_RATIO = Engine().damping_ratio
"""Of the paper's plate (App. D). [-]"""

PROJECTILE_DENSITY = 1300.0
"""Of the paper's projectiles. [kg/m3]"""

WAVE_SPEED_ERROR = 0.3  # [m/s]
THICKNESS_ERROR = 0.1e-3  # [m]
FREQUENCY_ERROR = 0.1  # [Hz]
DAMPING_ERROR = 0.003

_DRAWS = 2000


@dataclass(frozen=True, kw_only=True)
class Errors:
    """How far a value may be below and above the predicted one: shape (2, n), as error bars."""

    x: Floats
    ejection_phase: Floats
    energy_transfer: Floats


@dataclass(frozen=True, kw_only=True)
class Series:
    """
    One projectile on one engine, thrown from layers of one material.

    Parameters
    ----------
    frequency : float
        Of the plate. [Hz]
    projectile_length : float
        [m]

    """

    frequency: float
    projectile_length: float

    @property
    def speed(self) -> float:
        """:math:`c_s / (L_r f)`, by which the paper tells its series apart. [-]"""
        return Layer().wave_speed / (self.projectile_length * self.frequency)

    def place(self, thickness: ArrayLike) -> Floats:
        """Tell where layers are on the paper's axis :math:`x = L_s / (L_s + L_r)`. [-]"""
        thickness = np.asarray(thickness, dtype=np.float64)
        return np.asarray(thickness / (thickness + self.projectile_length))

    def thickness(self, x: ArrayLike) -> Floats:
        """Tell how thick a layer at x is. [m]"""
        x = np.asarray(x, dtype=np.float64)
        return np.asarray(self.projectile_length * x / (1.0 - x))

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

    def ratios(self, thickness: ArrayLike) -> dict[str, Any]:
        """Return mass and speed ratio, as the models call them."""
        thickness = np.asarray(thickness, dtype=np.float64)
        density_ratio = PROJECTILE_DENSITY / Layer().density
        return {
            'mass_ratio': np.asarray(density_ratio * self.projectile_length / thickness),
            'speed_ratio': np.asarray(Layer().wave_speed / (thickness * self.frequency)),
        }

    def releases(self, thickness: ArrayLike, *, damping_ratio: float) -> FirstRelease:
        """Compute first releases of the rigid projectile, exactly."""
        return first_releases(**self.ratios(thickness), damping_ratio=damping_ratio)

    def elastic_releases(self, *, damping_ratio: float) -> Landscape:
        """Compute those from the six layers as the paper's simulation does, Eqs. (2)-(3)."""
        return compute_landscape(
            self.rig(THICKNESSES[0], damping_ratio=damping_ratio),
            {'layer.thickness': THICKNESSES, 'engine.frequency': [self.frequency]},
            model='finite_difference_elastic',
        )

    def last_releases(self, thickness: ArrayLike, *, damping_ratio: float) -> Landscape:
        """Compute releases after all re-contacts."""
        return compute_landscape(
            self.rig(THICKNESSES[0], damping_ratio=damping_ratio),
            {'layer.thickness': thickness, 'engine.frequency': [self.frequency]},
            release='last',
        )

    def peak_strains(self, *, damping_ratio: float) -> Floats:
        """Compute the largest strains in the six layers up to the first release. [-]"""
        rigs = [self.rig(thickness, damping_ratio=damping_ratio) for thickness in THICKNESSES]
        scale = rigs[0].engine.speed_scale / rigs[0].layer.wave_speed
        return np.array(
            [
                scale
                * first_peaks(
                    mass_ratio=rig.mass_ratio,
                    speed_ratio=rig.speed_ratio,
                    damping_ratio=damping_ratio,
                ).strain
                for rig in rigs
            ]
        )

    def errors(self, *, damping_ratio: float) -> Errors:
        """
        Compute what the uncertainties of the rig make of the throws from the six layers.

        Notes
        -----
        Of wave speed, thickness, frequency and, if there is any, damping, with the standard
        deviations that the paper gives. Where times jump, errors do not simply add up; so this
        takes random rigs, always the same ones, and the 16 % and 84 % quantiles.

        """
        drawn = np.random.default_rng(0).standard_normal((4, _DRAWS, 1))
        thickness = THICKNESSES + THICKNESS_ERROR * drawn[0]
        ratios = self.ratios(thickness)
        ratios['speed_ratio'] *= 1.0 + WAVE_SPEED_ERROR / Layer().wave_speed * drawn[1]
        ratios['speed_ratio'] /= 1.0 + FREQUENCY_ERROR / self.frequency * drawn[2]
        damping_ratios = damping_ratio + (DAMPING_ERROR * drawn[3] if damping_ratio else 0.0)
        thrown = first_releases(**ratios, damping_ratio=damping_ratios)
        expected = self.releases(THICKNESSES, damping_ratio=damping_ratio)

        def around(values: ArrayLike, middle: ArrayLike) -> Floats:
            low, high = np.quantile(np.asarray(values), (0.16, 0.84), axis=0)
            return np.maximum([middle - low, high - middle], 0.0)

        return Errors(
            x=around(self.place(thickness), self.place(THICKNESSES)),
            ejection_phase=around(thrown.ejection_phase, expected.ejection_phase),
            energy_transfer=around(thrown.energy_transfer, expected.energy_transfer),
        )


SERIES = (
    Series(frequency=63.2, projectile_length=16.3e-3),
    Series(frequency=63.2, projectile_length=8.2e-3),
    Series(frequency=31.1, projectile_length=8.2e-3),
)
"""Those of the paper; the last is its third set."""
