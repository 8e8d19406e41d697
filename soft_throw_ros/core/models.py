# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
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
