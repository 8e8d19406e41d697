# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Ranges of layers that a search may choose from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from soft_throw_ros.configuration.layers import Material
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import require_uniform, STRONG_GRAVITY
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.optimise import LayerRange, Optimum


class SearchSpace(NamedTuple):
    """A rig whose layer may vary within a range, and the name of a layer of the library."""

    rig: Rig
    layers: LayerRange
    name: str = ''

    @property
    def is_single(self) -> bool:
        """Whether there is but one layer to choose."""
        return all(low == high for low, high in self.layers)

    def grid_step(self, *, loads: bool, throws: int = 1) -> float:
        """
        Return the step of the initial grid of a search, in logarithms [-].

        Grids with a stepper, which takes thirty times as long as the closed form, are coarser,
        most of all with several throws per layer, and grids along one axis are finer. Under
        strong gravity the maxima are too narrow for a coarser grid, with limits of loads or not.

        Parameters
        ----------
        loads : bool
            Whether the score needs the loads of the throws, and with them a stepper.
        throws : int
            Number of throws that make the score of a layer.

        """
        gravity, step = self.rig.gravity_ratio, 0.06
        if STRONG_GRAVITY < gravity < 1.0 and not self.rig.layer.needs_cells:
            step = 0.09
        elif gravity < 1.0 and (self.rig.layer.needs_cells or loads):
            step = 0.18 if throws > 1 else 0.12
        has_one_axis = any(low == high for low, high in self.layers)
        return 0.3 * step if has_one_axis else step

    def rig_with(self, best: Optimum) -> Rig:
        """Return the rig with another layer of this space."""
        layer = replace(self.rig.layer, thickness=best.thickness, wave_speed=best.wave_speed)
        return replace(self.rig, layer=layer)


def search_spaces(
    rig: Rig, vary: str, limits: Limits, materials: Mapping[str, Material]
) -> list[SearchSpace]:
    """
    List the search spaces of a request.

    Parameters
    ----------
    rig : Rig
        Rig with the present layer.
    vary : {'thickness', 'wave_speed', 'both', 'library'}
        Part of the layer that may vary.
    limits : Limits
        Limits of the parameters that may vary.
    materials : mapping of str to Material
        If `vary` is 'library', there is a space for each, or for each of its sheets.

    Raises
    ------
    ValueError
        If the rig's layer is not of one material.

    """
    layer = require_uniform(rig).layer
    if vary != 'library':
        thickness = limits.thickness if vary in ('thickness', 'both') else (layer.thickness,) * 2
        speeds = limits.wave_speed if vary in ('wave_speed', 'both') else (layer.wave_speed,) * 2
        return [SearchSpace(rig, LayerRange(thickness, speeds))]
    spaces = []
    for material in materials.values():
        speed = material.wave_speed
        if not limits.wave_speed_min <= speed <= limits.wave_speed_max:
            continue
        smallest, largest = limits.thickness
        sheets = [(item, item) for item in material.thicknesses if smallest <= item <= largest]
        for low, high in sheets if material.thicknesses else [limits.thickness]:
            sheet = replace(
                layer,
                thickness=low if low == high else layer.thickness,
                wave_speed=speed,
                density=material.density,
                loss_tangent=material.loss_tangent,
                diameter=material.diameter or layer.diameter,
            )
            spaces.append(
                SearchSpace(
                    replace(rig, layer=sheet),
                    LayerRange((low, high), (speed, speed)),
                    material.layer_name(low),
                )
            )
    return spaces
