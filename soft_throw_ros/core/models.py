# SPDX-License-Identifier: Apache-2.0
"""What the models of a throw are called."""

ON_GRIDS = (
    'finite_difference',
    'finite_difference_elastic',
    'finite_difference_glued',
    'spring_mass',
)
"""Finite differences: of the layer, of the projectile too, of a layer on it, of neither."""

MODELS = ('travelling_wave', *ON_GRIDS)
"""All that `throw.simulate` knows, and that the twin can follow in real time."""
