# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The library of layers: its installed entries, and the refusals of bad library files."""

from __future__ import annotations

import math
from pathlib import Path
import re
from typing import Any

import pytest
from soft_throw_ros.configuration import ParameterError
from soft_throw_ros.configuration.layers import (
    BOUNDS,
    CUSTOM,
    library,
    Material,
    MaterialProperty,
)

INSTALLED = library()

FOAM = """\
foam:
  description: A foam
  source: measured
  density: 120.0
  wave_speed: {value: 20.0, range: [18.0, 23.0]}
  loss_tangent: 0.1
"""
SPEED, LOSS = 'wave_speed: {value: 20.0, range: [18.0, 23.0]}', 'loss_tangent: 0.1'


def refused(path: Path) -> str:
    with pytest.raises(ParameterError) as error:
        library(path)
    assert error.value.names == ('layer.library',)
    message = str(error.value)
    assert '\n' not in message
    return message


# installed layers


def test_gelatins_of_the_paper_are_installed_in_six_thicknesses() -> None:
    gelatins = {name: values for name, values in INSTALLED.layers.items() if name.endswith('mm')}
    gelatins = {name: values for name, values in gelatins.items() if name.startswith('gelatin_')}
    assert gelatins == {
        f'gelatin_{millimetres}mm': {
            'layer.stack': '',
            'layer.thickness': float(f'{millimetres}e-3'),
            'layer.wave_speed': 7.8,
            'layer.density': 1000.0,
            'layer.loss_tangent': 0.0,
            'layer.diameter': 0.012,
        }
        for millimetres in ('2.0', '5.6', '9.5', '16.8', '23.4', '29.1')
    }
    speed = INSTALLED.materials['gelatin'].wave_speed
    assert (speed.low, speed.value, speed.high) == (7.5, 7.8, 8.1)


@pytest.mark.parametrize('material', INSTALLED.materials.values(), ids=lambda item: item.name)
def test_installed_material_is_described_sourced_and_within_bounds(material: Material) -> None:
    assert len(material.description) > 10
    assert re.search(r'\((19|20)\d\d\)|\barXiv:|Data sheet of|MatWeb', material.source)
    for name in ('density', 'wave_speed', 'loss_tangent'):
        quantity = getattr(material, name)
        _, lowest, highest = BOUNDS[name]
        assert lowest <= quantity.low <= quantity.value <= quantity.high <= highest
    assert list(material.thicknesses) == sorted(set(material.thicknesses))


# a file of one's own


def test_user_materials_extend_the_installed_ones(write: Any) -> None:
    mine = library(write(FOAM))
    assert mine.materials.keys() == {*INSTALLED.materials, 'foam'}
    assert mine.materials['foam'] == Material(
        name='foam',
        description='A foam',
        source='measured',
        density=MaterialProperty(value=120.0, low=120.0, high=120.0),
        wave_speed=MaterialProperty(value=20.0, low=18.0, high=23.0),
        loss_tangent=MaterialProperty(value=0.1, low=0.1, high=0.1),
    )
    assert mine.layers['foam'] == {
        'layer.stack': '',
        'layer.wave_speed': 20.0,
        'layer.density': 120.0,
        'layer.loss_tangent': 0.1,
    }
    assert library() == INSTALLED


def test_user_stack_is_a_layer_and_no_material(write: Any) -> None:
    text = FOAM + 'both:\n  description: d\n  source: s\n  stack: 8e-3 gelatin, 2e-3 foam\n'
    mine = library(write(text))
    assert 'both' not in mine.materials
    assert mine.layers['both']['layer.stack'] == '0.008 7.8 1000.0 0.0, 0.002 20.0 120.0 0.1'
    assert mine.layers['both']['layer.thickness'] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ('line', 'complaint'),
    [
        ('stack: 8e-3 jelly', "no material is named 'jelly'"),
        ('stack: 8e-3 gelatin\n  density: 1000', 'a stack has no density'),
        ('stack: 3', 'stack must be a text, got 3'),
    ],
)
def test_bad_stacks_are_refused_by_line(write: Any, line: str, complaint: str) -> None:
    with pytest.raises(ParameterError, match=rf'file:\d+: .*{complaint}'):
        library(write(f'both:\n  description: d\n  source: s\n  {line}\n'))


def test_modulus_and_its_range_become_wave_speeds(write: Any) -> None:
    text = FOAM.replace(SPEED, 'youngs_modulus: {value: 4.8e4, range: [1.2e4, 1.2e5]}')
    speed = library(write(text)).materials['foam'].wave_speed
    expected = [math.sqrt(modulus / 120.0) for modulus in (1.2e4, 4.8e4, 1.2e5)]
    assert [speed.low, speed.value, speed.high] == pytest.approx(expected, rel=1e-15)


def test_material_makes_a_layer_of_each_thickness(write: Any) -> None:
    layers = library(write(FOAM + '  thicknesses: [5e-3, 6.35e-3]\n  diameter: 0.02\n')).layers
    mine = {name: values for name, values in layers.items() if name.startswith('foam')}
    assert {name: values['layer.thickness'] for name, values in mine.items()} == {
        'foam_5.0mm': 5e-3,
        'foam_6.35mm': 6.35e-3,
    }
    assert all(values['layer.diameter'] == 0.02 for values in mine.values())


@pytest.mark.parametrize(
    ('old', 'new', 'line', 'message'),
    [
        ('  density', '  densty', 4, "'densty'; did you mean density?"),
        ('120.0', '-120.0', 4, 'density must be a number .* got -120.0'),
        ('source: measured', 'source: [a, b]', 3, r"source must be a text, got \['a', 'b'\]"),
        (LOSS, f'{LOSS}\n  density: 5', 7, 'density is given twice'),
        ('120.0', '[120.0]', 4, r'density must be a number .* got \[120.0\]'),
        ('[18.0, 23.0]', '[21.0, 23.0]', 5, r'range of wave_speed .* 20, got \[21.0, 23.0\]'),
        ('[18.0, 23.0]', '18.0', 5, 'must be two numbers around 20, got 18.0'),
        ('[18.0, 23.0]', '[18.0, 2300.0]', 5, 'wave_speed must be .* m/s, got 2300.0'),
        (SPEED, 'wave_speed: {value: 20.0}', 5, 'wave_speed must be .*range: .*, got value'),
        ('20.0, range', '20.0, value', 5, 'value is given twice'),
        (LOSS, f'{LOSS}\n  youngs_modulus: 5e4', 2, 'wave_speed or youngs_modulus, got both'),
        (SPEED, 'thicknesses: [0.01]', 2, 'wave_speed or youngs_modulus, got neither'),
        (SPEED, 'youngs_modulus: 60.0', 5, 'wave_speed must be .* 1 to 200 m/s, got 0.7'),
        (LOSS, 'diameter: 0.02', 2, 'foam has no loss_tangent'),
        (LOSS, f'{LOSS}\n  thicknesses: 0.01', 7, 'thicknesses must be a list .* got 0.01'),
        (LOSS, f'{LOSS}\n  thicknesses: [5.0]', 7, r'thicknesses .* 0.1 m, got \[5.0\]'),
        (LOSS, f'{LOSS}\n  diameter: 12', 7, 'diameter .* from 0.001 to 0.2 m, got 12'),
        ('foam:', 'gelatin:', 2, 'there is a material named gelatin already'),
        ('foam:', 'custom:', 2, f"and not {CUSTOM!r}, got 'custom'"),
        ('foam:', 'my foam:', 2, "letters, digits, .* got 'my foam'"),
    ],
)
def test_error_is_quoted_with_file_and_line(
    write: Any, old: str, new: str, line: int, message: str
) -> None:
    assert FOAM.count(old) == 1
    path = write(FOAM.replace(old, new))
    reason = refused(path)
    assert re.match(rf'{re.escape(str(path))}:{line}: ', reason), reason
    assert re.search(message, reason), reason


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'has no material'),
        ('- foam\n', r":1: expected NAME: {density: ..., ...}, got \['foam'\]"),
        ('foam: soft\n', ":1: expected PROPERTY: VALUE, got 'soft'"),
        (FOAM + FOAM, ':8: foam is given twice'),
        ('a: &a {}\nb: *a\n', r':2: .*alias, got \*a'),
    ],
)
def test_file_without_materials_is_refused(write: Any, text: str, message: str) -> None:
    path = write(text)
    assert re.match(rf'{re.escape(str(path))}.*{message}', refused(path))


def test_unreadable_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / 'binary.yaml'
    path.write_bytes(b'\xff\xfe')
    for unreadable in (tmp_path / 'no.yaml', tmp_path, path):
        assert refused(unreadable).startswith(f'{unreadable}: ')
