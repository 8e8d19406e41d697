# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `free_layers`."""

from pathlib import Path
import re

import numpy as np
import pytest
from soft_throw_ros.commands import free_layers
from soft_throw_ros.configuration import files

SAMPLE = Path(__file__).parents[1] / 'data' / 'synthetic_throw.csv'
COMMAND = (free_layers.main,)


def value(result, name):
    (row,) = (row for row in result['rows'] if row['name'] == name)
    return row['value'], row['error']


def ringing(thickness, seed):
    """Return the track of a free layer's ends as text [mm]."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 0.05, 2e-4)
    rings = np.exp(-30.0 * time) * np.cos(np.pi * 7.8 / thickness * time)
    noise = rng.normal(size=(2, time.size)) * 1e-5
    bottom, top = 0.1 + noise[0], 0.1 + thickness + 5e-4 * rings + noise[1]
    rows = zip(time, 1e3 * bottom, 1e3 * top, strict=True)
    return '\n'.join(['t;bottom;top', *(f'{t:.4f};{a:.4f};{b:.4f}' for t, a, b in rows)])


def test_free_layers_give_the_wave_speed(command, write, tmp_path):
    thicknesses = (5.6e-3, 16.8e-3, 29.1e-3)
    args = ['--unit', 'mm', '--output', tmp_path / 'rig.yaml', '--thickness-error', 2e-5]
    layers = []
    for thickness in thicknesses:
        path = write(ringing(thickness, seed=1), f'{thickness}.csv')
        layers += [thickness, path]
    args = [*layers, *args]
    result = command.json(*args)
    speed, error = value(result, 'layer.wave_speed')
    assert speed == pytest.approx(7.8, abs=4.0 * error)
    assert error < 0.03
    periods = [layer['period']['value'] for layer in result['layers']]
    assert periods == pytest.approx([2.0 * t / 7.8 for t in thicknesses], rel=5e-3)
    settings = files.read(tmp_path / 'rig.yaml')
    assert settings['layer.wave_speed'] == pytest.approx(speed, rel=1e-4)
    assert settings['uncertainty.wave_speed'] == pytest.approx(3.0**0.5 * error, rel=1e-2)
    assert 'mass: 0.0012' not in re.sub('#.*', '', (tmp_path / 'rig.yaml').read_text())
    rows = [line.split() for line in command.run(*args).splitlines() if ' mm: ' in line]
    assert [float(row[3]) for row in rows] == pytest.approx(1e3 * np.array(periods), rel=1e-3)


def test_free_layers_of_two_materials_give_a_warning(command, write):
    args = []
    for thickness, truth in ((10e-3, 10e-3), (20e-3, 24e-3)):
        args += [thickness, write(ringing(truth, seed=2), f'{thickness}.csv')]
    command.run(*args, '--unit', 'mm')
    assert 'not proportional to the thicknesses' in command.err
