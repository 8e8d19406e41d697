# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""
Ejection phase and energy transfer of first releases over any two parameters of a rig.

Notes
-----
A few ratios determine a throw, and every axis is a curve in their space. The axes of [1]_ are
functions of two ratios, the mass ratio :math:`\mu` and the speed ratio :math:`\kappa`:

.. math::

    x = \frac{L_s}{L_s + L_r}, \quad C = \frac{c_s}{(L_s + L_r) f}: \qquad
    \mu = \frac{\rho_r}{\rho_s} \frac{1 - x}{x}, \quad \kappa = \frac{C}{x},

and depend on the density ratio of projectile and layer as well, here that of the rig. The maps of
[1]_ use equal densities, though its rig has a ratio of 1.3.

References
----------
.. [1] "Use of compliant actuators for throwing rigid projectiles", Phys. Rev. E (2022).

"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
import functools
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.io import netcdf_file
import soft_throw_ros
from soft_throw_ros.configuration import rig_values, TWIN
from soft_throw_ros.core import checks
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import throw_many

Floats = NDArray[np.float64]


class QuantityLabel(NamedTuple):
    """Symbol, unit (SI, empty if none) and meaning of numbers."""

    symbol: str
    unit: str
    meaning: str


_SYMBOLS = {
    'engine.frequency': 'f',
    'engine.amplitude': 'A',
    'engine.damping_ratio': 'ζ',
    'layer.thickness': 'Lₛ',
    'layer.wave_speed': 'cₛ',
    'layer.density': '\N{GREEK SMALL LETTER RHO}ₛ',
    'layer.diameter': 'D',
    'layer.loss_tangent': 'tan δ',
    'projectile.mass': 'm',
    'gravity': 'g',
}

AXES: Mapping[str, QuantityLabel] = {
    'x': QuantityLabel('x = Lₛ/(Lₛ + Lᵣ)', '', 'Layer over total length'),
    'C': QuantityLabel('C = cₛ/(Lₛ + Lᵣ)f', '', 'Crossings of the total length per plate period'),
    'mu': QuantityLabel('μ = m/ρₛSLₛ', '', 'Projectile over layer mass'),
    'kappa': QuantityLabel('κ = cₛ/Lₛf', '', 'Crossings of the layer per plate period'),
    **{
        name: QuantityLabel(symbol, TWIN.by_name[name].unit, TWIN.by_name[name].meaning)
        for name, symbol in _SYMBOLS.items()
    },
}
"""Axes: those of the paper, the ratios behind them, and parameters of the rig."""

RESULTS: Mapping[str, QuantityLabel] = {
    'ejection_phase': QuantityLabel('tₑ f', '', 'Ejection time in plate periods'),
    'energy_transfer': QuantityLabel('α', '', 'Energy transfer factor'),
}
"""Results at every point of a landscape, by the names of its arrays."""

_BESIDE_RATIOS = (
    'x', 'C', 'mu', 'kappa', 'engine.damping_ratio', 'engine.amplitude', 'gravity',
    'layer.loss_tangent',
)
"""Axes that may be combined with one of the first four, the ratios."""


class HighestPoint(NamedTuple):
    """The best point of a landscape: its position on each axis, and the results there."""

    coordinates: tuple[float, float]
    ejection_phase: float
    energy_transfer: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Landscape:
    """Ejection phase and energy transfer over two axes. Made by `compute_landscape`."""

    rig: Rig  # the rig of all throws, apart from the axes
    axes: Mapping[str, Floats]  # values of the two axes, of shapes (n,) and (m,) [SI]
    ejection_phase: Floats  # shape (n, m); NaN where the projectile does not leave [-]
    energy_transfer: Floats  # likewise [-]

    @property
    def optimum(self) -> HighestPoint | None:
        """Where the energy transfer is largest; None if all is NaN."""
        if np.isnan(self.energy_transfer).all():
            return None
        i, j = np.unravel_index(np.nanargmax(self.energy_transfer), self.energy_transfer.shape)
        x, y = self.axes.values()
        results = float(self.ejection_phase[i, j]), float(self.energy_transfer[i, j])
        return HighestPoint((float(x[i]), float(y[j])), *results)

    def coordinates_of(self, rig: Rig) -> tuple[float, float]:
        """Return the position of a rig on the axes, with the density ratio of the landscape."""
        density_ratio = _density_ratio(self.rig)
        x = density_ratio / (density_ratio + rig.mass_ratio)
        ratios = {'x': x, 'C': x * rig.speed_ratio, 'mu': rig.mass_ratio, 'kappa': rig.speed_ratio}
        values = rig_values(rig) | ratios
        first, second = (float(values[name]) for name in self.axes)
        return first, second

    def save(self, path: Path) -> None:
        """Write NetCDF 3, which xarray and MATLAB read."""
        names = [name.replace('.', '_') for name in self.axes]
        labels = [*(AXES[name] for name in self.axes), *RESULTS.values()]
        arrays = [*self.axes.values(), *(getattr(self, name) for name in RESULTS)]
        with netcdf_file(path, 'w', mmap=False, version=2) as data:
            data.source = f'soft_throw_ros {soft_throw_ros.__version__}'
            for name, value in rig_values(self.rig).items():
                setattr(data, name.replace('.', '_'), value)
            for name, values in zip(names, arrays, strict=False):
                data.createDimension(name, values.size)
            for name, label, values in zip([*names, *RESULTS], labels, arrays, strict=True):
                variable = data.createVariable(name, 'f8', [name] if values.ndim == 1 else names)
                variable[:] = values
                variable.long_name, variable.units = label.meaning, label.unit or '1'


def compute_landscape(
    rig: Rig,
    axes: Mapping[str, ArrayLike],
    *,
    run: Callable[..., Iterable[Floats]] = map,
) -> Landscape:
    r"""
    Compute a landscape over two of `AXES`, of which the ratios replace values of the rig.

    `run` maps a function over blocks of throws, as `Executor.map` does.

    Notes
    -----
    First releases are exact to 1e-9 from a lossless layer, and to 1e-4 from others.

    Examples
    --------
    >>> landscape = compute_landscape(
    ...     Rig(), {'layer.thickness': [0.01, 0.015, 0.02], 'layer.wave_speed': [6.0, 9.0]}
    ... )
    >>> landscape.energy_transfer.round(2)
    array([[3.61, 3.45],
           [3.04, 3.92],
           [2.8 , 3.67]])
    >>> landscape.optimum.coordinates
    (0.015, 9.0)

    """
    checked = _check(rig, axes)
    grid = np.meshgrid(*checked.values(), indexing='ij')
    changes = _changes(rig, dict(zip(checked, grid, strict=True)))
    cases = np.stack(np.broadcast_arrays(*changes.values())).reshape(len(changes), -1)
    compute = functools.partial(_compute, rig, tuple(changes))
    has_cells = rig.layer.needs_cells or 'layer.loss_tangent' in axes
    size = 256 if rig.engine.motion or has_cells else 1 << 16
    blocks = [cases[:, start:start + size] for start in range(0, cases.shape[1], size)]
    phase, transfer = np.hstack(list(run(compute, blocks))).reshape(len(RESULTS), *grid[0].shape)
    return Landscape(rig=rig, axes=checked, ejection_phase=phase, energy_transfer=transfer)


def _check(rig: Rig, axes: Mapping[str, ArrayLike]) -> dict[str, Floats]:
    """Return the values of two axes of a rig, or refuse them."""
    if len(axes) != 2:
        raise ValueError(f'a landscape has two axes, got {", ".join(axes) or "none"}')
    if unknown := [name for name in axes if name not in AXES]:
        raise ValueError(f'unknown axis {unknown[0]!r}; choose from {", ".join(AXES)}')
    if {*axes} in ({'x', 'mu'}, {'C', 'kappa'}):
        raise ValueError(f'the axes {" and ".join(axes)} are not independent; choose others')
    if {*axes} & {*_BESIDE_RATIOS[:4]} and not {*axes} <= {*_BESIDE_RATIOS}:
        names = ', '.join(_BESIDE_RATIOS)
        raise ValueError(f'a ratio can be combined with {names}, got {" and ".join(axes)}')
    if rig.engine.motion and 'engine.damping_ratio' in axes:
        raise ValueError('engine.damping_ratio is an axis, but the plate moves by a file')
    checked = {}
    for name, values in axes.items():
        is_parameter = name in TWIN.by_name
        array = checks.require_all(name, values, 'not_negative' if is_parameter else 'positive')
        if array.ndim != 1 or not array.size or (np.diff(array) <= 0.0).any():
            raise ValueError(f'{name} must be increasing numbers, got {array}')
        for value in array[[0, -1]].tolist() * is_parameter:
            TWIN.check_value(name, value)
        if name == 'x':
            checks.require_all(name, array[-1], 'in_unit_interval')
        checked[name] = array
    return checked


def _density_ratio(rig: Rig) -> float:
    """Return the density of the projectile over that of the layer [-]."""
    volume = rig.layer.section * rig.projectile.length
    return rig.projectile.mass / (volume * rig.layer.density)


def _changes(rig: Rig, along: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return the changes of the rig along the axes, for `rig_with`."""
    changes = {name.rpartition('.')[2]: along[name] for name in along if name in TWIN.by_name}
    if len(changes) == len(along):
        return changes
    density_ratio = _density_ratio(rig)
    mu = along.get('mu', np.asarray(rig.mass_ratio))
    if 'x' in along:
        mu = density_ratio * (1.0 - along['x']) / along['x']
    kappa = along.get('kappa', np.asarray(rig.speed_ratio))
    if 'C' in along:
        kappa = along['C'] / along.get('x', density_ratio / (density_ratio + mu))
    # A layer with the given ratios and the present wave speed
    thickness = rig.layer.wave_speed / (kappa * rig.engine.frequency)
    density = rig.projectile.mass / (mu * rig.layer.section * thickness)
    return {**changes, 'thickness': thickness, 'density': density}


def _compute(rig: Rig, names: tuple[str, ...], cases: Floats) -> Floats:
    """Compute a block of throws; on its own, so that other processes find it by name."""
    changes = dict(zip(names, cases, strict=True))
    throws = throw_many(rig, changes)
    frequency = changes.get('frequency', rig.engine.frequency)
    return np.stack([throws.ejection_time * frequency, throws.energy_transfer])
