# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The throwing rig: an engine's plate, a soft layer on the plate, a projectile lying on the layer.

SI units throughout. Every constructor refuses values that are not physical, so that every `Rig`
can be simulated.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from typing import Any, TYPE_CHECKING

import numpy as np
from soft_throw_ros.core import checks, material

if TYPE_CHECKING:
    from soft_throw_ros.core.plate import SampledMotion

_LINEAR_STRAIN = 0.15
"""Strain at which results of a neo-Hookean layer begin to differ by more than 5 %. [-]"""

MAX_PERIODS = 16.0
"""Longest wait for a release, in periods of plate or projectile. [-]"""

RANGES = {
    **dict.fromkeys(('frequency', 'amplitude', 'thickness', 'wave_speed', 'density'), 'positive'),
    **dict.fromkeys(('diameter', 'mass', 'length'), 'positive'),
    **dict.fromkeys(('loss_tangent', 'gravity'), 'not_negative'),
    'damping_ratio': 'in_unit_interval',
}
"""Ranges of the numbers of a rig, see `checks.require_all`."""

_CHOICES = {'stress_strain_law': material.STRESS_STRAIN_LAWS, 'loss': material.LOSSES}


def check_fields(instance: object, prefix: str = '') -> None:
    """Check numbers and choices of a frozen dataclass."""
    for name, value in [*vars(instance).items()]:
        if name in RANGES:
            number = checks.require_all(prefix + name, value, RANGES[name])
            object.__setattr__(instance, name, number)
        elif name in _CHOICES and value not in _CHOICES[name]:
            raise ValueError(
                f'{prefix}{name} must be one of {", ".join(_CHOICES[name])}, got {value!r}'
            )


@dataclass(frozen=True, kw_only=True)
class Engine:
    r"""
    The ejection engine, whose plate jumps up once and settles at `amplitude`.

    Parameters
    ----------
    frequency : float
        Natural frequency :math:`f` of the plate. [Hz]
    amplitude : float
        Height :math:`A` at which the plate settles. [m]
    damping_ratio : float
        Damping ratio :math:`\zeta`, 0 for the harmonic motion of Eq. (1). [-]
    motion : SampledMotion, optional
        Recorded motion of the plate, which replaces the oscillation; its times count from its
        first state, the start of the throw. Frequency and amplitude are then only units of time
        and length; the loss tangent of a layer still refers to the frequency.

    Raises
    ------
    ValueError
        If a value is out of range.

    """

    frequency: float = 63.2
    amplitude: float = 2e-3
    damping_ratio: float = 0.064
    motion: SampledMotion | None = None

    def __post_init__(self) -> None:
        check_fields(self, 'engine.')
        if self.motion is not None and self.motion.times[0] != 0.0:
            since_start = self.motion.times - self.motion.times[0]
            object.__setattr__(self, 'motion', replace(self.motion, times=since_start))

    @property
    def angular_frequency(self) -> float:
        r""":math:`\omega = 2 \pi f` [rad/s]."""
        return 2.0 * math.pi * self.frequency

    @property
    def speed_scale(self) -> float:
        r""":math:`A \omega`, the largest plate speed without damping [m/s]."""
        return self.amplitude * self.angular_frequency


@dataclass(frozen=True, kw_only=True)
class Layer:
    r"""
    The soft layer: a cylinder of one material, or of several sheets, see `of_sheets`.

    The numbers of a layer of sheets are effective values of the whole; a change of one of them
    changes all sheets in proportion.

    Parameters
    ----------
    thickness : float
        Thickness :math:`L_s`. [m]
    wave_speed : float
        Speed of longitudinal waves :math:`c_s = \sqrt{E_s / \rho_s}`. [m/s]
    density : float
        Density :math:`\rho_s`. [kg/m3]
    diameter : float
        Diameter of the cross section :math:`S`. [m]
    loss_tangent : float
        Loss tangent at the engine's frequency; 0 for no loss. [-]
    stress_strain_law : {'linear', 'neo_hookean'}
        Law of stress over strain, see `material`.
    loss : {'kelvin_voigt', 'constant'}
        Law of loss: the loss tangent grows with frequency, or is constant over decades.
    parts : sequence of Layer
        Sheets from the plate upwards; none for a layer of one material.

    Raises
    ------
    ValueError
        If a value is out of range, or the loss tangent is above `material.LARGEST_CONSTANT_LOSS`
        where it is constant.

    Examples
    --------
    A stiff sheet of 2 mm on a soft one of 10 mm:

    >>> soft = Layer(thickness=10e-3, wave_speed=8.0)
    >>> layer = Layer.of_sheets([soft, Layer(thickness=2e-3, wave_speed=20.0)])
    >>> round(layer.thickness, 6), round(1e3 * layer.crossing_time, 6)
    (0.012, 1.35)

    """

    thickness: float = 16.8e-3
    wave_speed: float = 7.8
    density: float = 1000.0
    diameter: float = 12e-3
    loss_tangent: float = 0.0
    stress_strain_law: str = 'linear'
    loss: str = 'kelvin_voigt'
    parts: tuple[Layer, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, 'layer.')
        loss, limit = self.loss_tangent, material.LARGEST_CONSTANT_LOSS
        if self.loss == 'constant' and loss > limit:
            rule = f'at most {limit} if it is constant'
            raise ValueError(f'layer.loss_tangent must be {rule}, got {loss:g}')
        if self.parts:
            whole, new = _values_of_sheets(self.parts), vars(self)
            changes = {name: new[name] for name in whole if new[name] != whole[name]}
            sheets = (_changed_sheet(sheet, whole, changes) for sheet in self.parts)
            object.__setattr__(self, 'parts', tuple(sheets))

    @classmethod
    def of_sheets(cls, sheets: Iterable[Layer]) -> Layer:
        """
        Make a layer of one or more sheets on top of each other, from the plate upwards.

        Raises
        ------
        ValueError
            If the sheets differ in diameter, stress-strain law or kind of loss.

        """
        parts = tuple(sheet for layer in sheets for sheet in layer.sheets)
        for name, unit in (('diameter', ' m'), ('stress_strain_law', ''), ('loss', '')):
            first, *others = dict.fromkeys(getattr(sheet, name) for sheet in parts)
            if others:
                values = f'{first}{unit} and {others[0]}{unit}'
                raise ValueError(f'layer.sheets must be of one {name}, got {values}')
        return cls(**_values_of_sheets(parts), parts=parts) if len(parts) > 1 else parts[0]

    @property
    def section(self) -> float:
        """:math:`S` [m2]."""
        return 0.25 * math.pi * self.diameter**2

    @property
    def mass(self) -> float:
        r""":math:`\rho_s S L_s` [kg]."""
        return self.density * self.section * self.thickness

    @property
    def youngs_modulus(self) -> float:
        r""":math:`E_s = \rho_s c_s^2`; of sheets, that with the same compression at rest [Pa]."""
        if self.parts:
            compliance = sum(1.0 / sheet.stiffness for sheet in self.parts)
            return self.thickness / (compliance * self.section)
        return self.density * self.wave_speed**2

    @property
    def impedance(self) -> float:
        """:math:`E_s S / c_s` at the top, force over speed of a travelling wave [kg/s]."""
        top = self.sheets[-1]
        return top.density * top.wave_speed * top.section

    @property
    def stiffness(self) -> float:
        """:math:`E_s S / L_s`, force over change of thickness [N/m]."""
        return self.youngs_modulus * self.section / self.thickness

    @property
    def crossing_time(self) -> float:
        """:math:`t_s = L_s / c_s`, travel time of a wave from plate to top [s]."""
        return self.thickness / self.wave_speed

    def static_strain(self, force: float) -> float:
        """Return the compression under a steady force [N], by the relaxed modulus [-]."""
        if self.parts:
            sag = sum(sheet.thickness * sheet.static_strain(force) for sheet in self.parts)
            return sag / self.thickness
        load = force / (self.youngs_modulus * self.section)
        if self.loss == 'constant':
            load /= material.relaxation(self.loss_tangent)[0]
        if self.stress_strain_law == 'linear':
            return load
        return 1.0 - material.static_stretch(3.0 * load)

    @property
    def needs_cells(self) -> bool:
        """Whether only cells can follow it: sheets, a layer with loss, or one not linear."""
        return bool(self.parts) or self.loss_tangent > 0.0 or self.stress_strain_law != 'linear'

    @property
    def linear_range(self) -> float:
        """Largest strain with reliable results [-]."""
        return _LINEAR_STRAIN if self.stress_strain_law == 'linear' else material.LARGEST_STRAIN

    @property
    def sheets(self) -> tuple[Layer, ...]:
        """Sheets of the layer from the plate up, each of one material."""
        return self.parts or (self,)


def _values_of_sheets(sheets: Sequence[Layer]) -> dict[str, Any]:
    """Return the effective values of a layer of sheets."""
    thickness = sum(sheet.thickness for sheet in sheets)
    compliances = [1.0 / sheet.stiffness for sheet in sheets]
    losses = [sheet.loss_tangent * part for sheet, part in zip(sheets, compliances, strict=True)]
    return {
        'thickness': thickness,
        'wave_speed': thickness / sum(sheet.crossing_time for sheet in sheets),
        'density': sum(sheet.density * sheet.thickness for sheet in sheets) / thickness,
        'diameter': sheets[0].diameter,
        'loss_tangent': sum(losses) / sum(compliances),  # in slow compression
        'stress_strain_law': sheets[0].stress_strain_law,
        'loss': sheets[0].loss,
    }


def _changed_sheet(sheet: Layer, whole: Mapping[str, Any], changes: Mapping[str, Any]) -> Layer:
    """Return a sheet whose values change in proportion to those of the whole layer."""
    return replace(sheet, **{
        name: value * getattr(sheet, name) / whole[name]
        if isinstance(value, float) and whole[name] else value
        for name, value in changes.items()
    })


@dataclass(frozen=True, kw_only=True)
class Projectile:
    """
    The projectile, a cylinder as wide as the layer.

    Parameters
    ----------
    mass : float
        :math:`m`; the default is the paper's, 8.2 mm of 1300 kg/m3 and 12 mm diameter. [kg]
    length : float
        Height :math:`L_r` of the projectile, between its lower face and twice its centre. [m]

    Raises
    ------
    ValueError
        If a value is not finite and positive.

    """

    mass: float = 1300.0 * 8.2e-3 * math.pi * 6e-3**2
    length: float = 8.2e-3

    def __post_init__(self) -> None:
        check_fields(self, 'projectile.')


@dataclass(frozen=True, kw_only=True)
class Rig:
    """
    Engine, layer and projectile together, and the numbers that decide a throw.

    Without gravity and loss a throw depends on `mass_ratio`, `speed_ratio` and the engine's
    damping ratio alone; all else is a unit of time, length or force.

    Parameters
    ----------
    engine, layer, projectile
        Components of the rig; the defaults are those of the paper.
    gravity : float
        Towards the plate; 0 for the figures of the paper. [m/s2]

    Raises
    ------
    ValueError
        If `gravity` is negative or not finite, or a component is of another type.

    """

    engine: Engine = field(default_factory=Engine)
    layer: Layer = field(default_factory=Layer)
    projectile: Projectile = field(default_factory=Projectile)
    gravity: float = 9.81

    def __post_init__(self) -> None:
        check_fields(self)
        for name, kind in (('engine', Engine), ('layer', Layer), ('projectile', Projectile)):
            if not isinstance(value := getattr(self, name), kind):
                raise ValueError(f'{name} must be of type {kind.__name__}, got {value!r}')

    @property
    def mass_ratio(self) -> float:
        r""":math:`\mu = m / (\rho_s S L_s)`, projectile over layer [-]."""
        return self.projectile.mass / self.layer.mass

    @property
    def speed_ratio(self) -> float:
        r""":math:`\kappa = c_s / (L_s f)`, crossings of the wave per plate period [-]."""
        return 1.0 / (self.layer.crossing_time * self.engine.frequency)

    @property
    def crossing_time(self) -> float:
        """:math:`t_s = L_s / c_s` [s]."""
        return self.layer.crossing_time

    @property
    def relaxation_time(self) -> float:
        r""":math:`\tau = m c_s / (E_s S) = \mu t_s`, of the mass against the layer [s]."""
        return self.projectile.mass / self.layer.impedance

    @property
    def natural_frequency(self) -> float:
        """:math:`f_0` of the projectile on the layer as a massless spring (App. A) [Hz]."""
        return math.sqrt(self.layer.stiffness / self.projectile.mass) / (2.0 * math.pi)

    @property
    def rest_height(self) -> float:
        """Height of the lower face of the resting projectile, on a layer without weight [m]."""
        sag = self.layer.thickness * self.layer.static_strain(self.projectile.mass * self.gravity)
        return self.layer.thickness - sag

    @property
    def gravity_ratio(self) -> float:
        r""":math:`g / (A \omega^2)` [-]."""
        return self.gravity / (self.engine.speed_scale * self.engine.angular_frequency)

    @property
    def longest_wait(self) -> float:
        """Time until which steppers follow a throw without a release [s]."""
        end = self.engine.motion.end_time if self.engine.motion else 0.0
        own_period = 2.0 * math.pi * np.sqrt(self.projectile.mass / self.layer.stiffness)
        longest: float = np.maximum(1.0 / self.engine.frequency, own_period)
        return end + self.crossing_time + MAX_PERIODS * longest


def values_of(rig: Rig) -> dict[str, float]:
    """Return the numbers of engine and layer, the gravity, and the mass of the projectile."""
    values = {**vars(rig.engine), **vars(rig.layer), 'gravity': rig.gravity}
    values = {name: value for name, value in values.items() if isinstance(value, float)}
    return {**values, 'mass': rig.projectile.mass}


def scales_of(values: Mapping[str, Any]) -> Any:
    """Return a `Rig` of arrays of each of `values_of`, unchecked, for its properties."""
    rig = Rig()
    for part in (rig.engine, rig.layer, rig.projectile, rig):
        vars(part).update((name, values[name]) for name in vars(part).keys() & values.keys())
    return rig
