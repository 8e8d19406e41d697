# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Names and abilities of the models of the layer; importing them compiles nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

_ALL = frozenset({'damping', 'gravity', 'loss', 'large_strain', 'stack', 'motion', 'last_release'})


@dataclass(frozen=True, kw_only=True)
class LayerModel:
    """
    Abilities of a model of the layer.

    Parameters
    ----------
    batch : {'cells', 'waves', 'spring'} or None
        Method that computes first releases of many throws, see `throws`; None if there is none.
    knows : frozenset of str
        Influences that this method takes into account: `damping` of the plate, `gravity`, `loss`,
        `large_strain`, a `stack` of sheets, a sampled `motion` of the plate, and the
        `last_release`.
    fallback : str
        Name of the model that takes over the layers which only cells can follow; empty if this
        model follows all, or refuses them.
    has_elastic_projectile : bool
        Whether the projectile has cells, too.
    is_on_projectile : bool
        Whether the layer is glued to the projectile and leaves the plate with it.

    """

    batch: Literal['cells', 'waves', 'spring'] | None
    knows: frozenset[str] = _ALL
    fallback: str = ''
    has_elastic_projectile: bool = False
    is_on_projectile: bool = False


MODELS: Mapping[str, LayerModel] = {
    'travelling_wave': LayerModel(
        batch='waves', knows=_ALL - {'loss', 'large_strain', 'stack'}, fallback='cells'
    ),
    'cells': LayerModel(batch='cells'),
    'cells_elastic': LayerModel(batch='cells', has_elastic_projectile=True),
    'cells_glued': LayerModel(batch='cells', is_on_projectile=True),
    'spring_mass': LayerModel(batch='spring', knows=frozenset()),
}
"""Models that `throw.simulate` knows, and that the twin can follow in real time."""

STRESS_STRAIN_LAWS = ('linear', 'neo_hookean')
"""Laws of stress over strain of a layer."""

LOSSES = ('kelvin_voigt', 'constant')
"""Frequency dependence of the loss tangent: in proportion to the frequency, or constant."""


def model_of(name: str) -> LayerModel:
    """
    Return a model by its name.

    Raises
    ------
    ValueError
        If there is no such model.

    """
    if name not in MODELS:
        raise ValueError(f'model must be one of {", ".join(MODELS)}, got {name!r}')
    return MODELS[name]
