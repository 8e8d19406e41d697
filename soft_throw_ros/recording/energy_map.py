# SPDX-License-Identifier: Apache-2.0
"""Energy transfer of a rig with any layer, and where its own and the recommended layer are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import time

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.configuration import Settings
from soft_throw_ros.core.closed_form import first_releases
from soft_throw_ros.core.rig import Rig

Floats = NDArray[np.float64]

_SHAPE = (160, 100)
"""Thicknesses and wave speeds."""

_COARSENESSES = (8, 4, 2, 1)
_TIME_BUDGET = 1.0
"""The finest map is taken that needs no longer: too heavy a projectile takes minutes. [s]"""

_SMALLEST, _LARGEST = 1e-6, 1e6
"""Of a thickness and a wave speed that may be recommended, in SI units."""

_SAME = 0.01
"""Layers that differ by no more than this part are one mark."""


@dataclass(frozen=True, kw_only=True)
class EnergyMap:
    """Energy transfer over all layers that are considered."""

    # From each to the next by the same factor. [m], [m/s]
    thickness: Floats
    wave_speed: Floats
    # A row for each wave speed; NaN where nothing is thrown. [-]
    energy_transfer: Floats
    # Thickness [m], wave speed [m/s] and text: the layer of the rig, and maybe a recommended one
    marks: tuple[tuple[float, float, str], ...]
    title: str  # Of the colours


def energy_transfer(rig: Rig, thickness: Floats, wave_speed: Floats) -> Floats:
    """
    Compute alpha of a rig with other layers, without loss.

    Parameters
    ----------
    rig : Rig
        All but thickness and wave speed of the layer stay.
    thickness, wave_speed : ndarray
        Broadcast against each other. [m], [m/s]

    Returns
    -------
    ndarray
        NaN where it cannot be told, or the projectile does not leave. [-]

    """
    layer_mass = rig.layer.density * rig.layer.section * thickness
    releases = first_releases(
        mass_ratio=rig.projectile.mass / layer_mass,
        speed_ratio=wave_speed / (thickness * rig.engine.frequency),
        damping_ratio=rig.engine.damping_ratio,
        gravity_ratio=rig.gravity_ratio,
        unresolved='nan',
    )
    return np.asarray(releases.energy_transfer)


def compute_energy_map(
    rig: Rig, settings: Settings, recommendation: Mapping[str, float | str]
) -> EnergyMap:
    """
    Compute the map for a rig.

    Parameters
    ----------
    rig : Rig
        The rig, with the layer that is there now.
    settings : mapping of str to value
        Of the twin: which layers are considered.
    recommendation : mapping of str to float or str
        Values of `~/recommendation` for this rig; what it says of a layer is not computed again,
        so that marks and table agree. Empty if there is none.

    Returns
    -------
    EnergyMap
        Its marks are within it.

    """
    now = rig.layer.thickness, rig.layer.wave_speed
    said_now = _layer_of(recommendation, 'now.')
    best = _layer_of(recommendation, '')
    is_same = best is not None and np.allclose(now, best, rtol=_SAME)
    layers = [now] if best is None or is_same else [now, best]
    sources = ['now.' if said_now and np.allclose(now, said_now, rtol=1e-6) else None, '']
    names = ['now, as recommended' if is_same else 'now', 'recommended']
    marks = []
    for layer, source, name in zip(layers, sources, names, strict=False):
        said = None if source is None else recommendation.get(f'{source}energy_transfer')
        alpha = said if isinstance(said, float) else float(energy_transfer(rig, *np.array(layer)))
        text = f'{name}: α {alpha:.3f}' if alpha > 0.0 else f'{name}: no release'
        marks.append((*layer, text))
    bounds = [
        (
            min(settings[f'recommendation.{name}_min'], *values),
            max(settings[f'recommendation.{name}_max'], *values),
        )
        for name, values in zip(
            ('thickness', 'wave_speed'), zip(*layers, strict=True), strict=True
        )
    ]
    for coarseness in _COARSENESSES:
        begin = time.monotonic()
        thickness, wave_speed = (
            np.geomspace(low, high, count // coarseness)
            for (low, high), count in zip(bounds, _SHAPE, strict=True)
        )
        values = energy_transfer(rig, thickness[None], wave_speed[:, None])
        if 4.0 * (time.monotonic() - begin) > _TIME_BUDGET:  # what the next one takes
            break
    return EnergyMap(
        thickness=thickness,
        wave_speed=wave_speed,
        energy_transfer=values,
        marks=tuple(marks),
        title='α, lossless' if rig.layer.loss_tangent else 'α',
    )


def _layer_of(values: Mapping[str, float | str], prefix: str) -> tuple[float, float] | None:
    """Return thickness and wave speed if they could be those of a layer."""
    match values.get(f'{prefix}thickness'), values.get(f'{prefix}wave_speed'):
        case float(thickness), float(wave_speed):
            if all(_SMALLEST < value < _LARGEST for value in (thickness, wave_speed)):
                return thickness, wave_speed
    return None
