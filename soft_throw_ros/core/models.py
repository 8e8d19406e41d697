# SPDX-License-Identifier: Apache-2.0
"""What models and materials are called; apart, so that to know them compiles nothing."""

CELL_MODELS = (
    'finite_difference',
    'finite_difference_elastic',
    'finite_difference_glued',
    'spring_mass',
)
"""Cells of the layer; of the projectile, too; of a layer on the projectile; a massless layer."""

MODELS = ('travelling_wave', *CELL_MODELS)
"""All that `throw.simulate` knows, and that the twin can follow in real time."""

ELASTICITIES = ('linear', 'neo_hookean')
"""How the stress of a layer follows strain."""

LOSSES = ('kelvin_voigt', 'constant')
"""How its loss tangent depends on frequency: in proportion to it, or not at all."""
