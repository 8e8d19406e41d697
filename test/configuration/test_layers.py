# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The library of layers: its installed entries, and the refusals of bad library files."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest
from soft_throw_ros.configuration import ParameterError
from soft_throw_ros.configuration.layers import CUSTOM, library, Material

INSTALLED = library()
SPEED, LOSS = 'wave_speed: {value: 20.0, range: [18.0, 23.0]}', 'loss_tangent: 0.1'
FOAM = f'foam:\n  description: A foam\n  source: measured\n  density: 120.0\n  {SPEED}\n  {LOSS}\n'


def test_gelatins_of_the_paper_are_installed_in_six_thicknesses() -> None:
    names = [name for name in INSTALLED.layers if re.fullmatch(r'gelatin_[\d.]+mm', name)]
    assert names == [f'gelatin_{size}mm' for size in ('2.0', '5.6', '9.5', '16.8', '23.4', '29.1')]


def test_user_material_is_a_layer_of_each_thickness_and_its_modulus_a_speed(write: Any) -> None:
    mine = library(write(FOAM))
    foam = Material(name='foam', density=120.0, wave_speed=20.0, loss_tangent=0.1)
    assert mine.materials == {**INSTALLED.materials, 'foam': foam}
    assert mine.layers == {**INSTALLED.layers, 'foam': foam.settings}
    text = FOAM.replace(SPEED, 'youngs_modulus: {value: 4.8e4, range: [1.2e4, 1.2e5]}')
    layers = library(write(text + '  thicknesses: [5e-3, 6.35e-3]\n  diameter: 0.02\n')).layers
    sizes = {'foam_5.0mm': 5e-3, 'foam_6.35mm': 6.35e-3}
    assert layers.keys() - INSTALLED.layers.keys() == sizes.keys()
    for name, thickness in sizes.items():
        assert layers[name] == {
            'layer.thickness': thickness, 'layer.diameter': 0.02, 'layer.stack': '',
            'layer.wave_speed': pytest.approx(math.sqrt(4.8e4 / 120.0)),
            'layer.density': 120.0, 'layer.loss_tangent': 0.1,
        }


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('  density', '  densty', "'foam': density must be given"),
        (LOSS, f'{LOSS}\n  colour: red', "'foam': a property must be one of .* got 'colour'"),
        (LOSS, f'{LOSS}\n  youngs_modulus: 5e4', 'wave_speed or youngs_modulus'),
        (SPEED, 'youngs_modulus: 60.0', 'wave_speed must be .* 1 to 200 m/s, got 0.7'),
        (LOSS, f'{LOSS}\n  thicknesses: 0.01', 'thicknesses must be a list, got 0.01'),
        ('foam:', 'gelatin:', "'gelatin': .* already"),
        ('foam:', 'custom:', f"'custom': .*and not {CUSTOM!r}"),
        (FOAM, '', 'has no material'),
        (FOAM, 'foam: soft\n', "'foam': must be PROPERTY: VALUE, got 'soft'"),
    ],
)
def test_error_is_quoted_with_file_and_material(write: Any, old, new, message) -> None:
    assert FOAM.count(old) == 1
    path = write(FOAM.replace(old, new))
    with pytest.raises(ParameterError, match=rf'^{re.escape(str(path))}: .*{message}') as refused:
        library(path)
    assert refused.value.names == ('layer.library',)
