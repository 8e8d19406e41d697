# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `free_layers`."""

import re

import numpy as np
import pytest
from soft_throw_ros.commands import free_layers
from soft_throw_ros.configuration import files

COMMAND = (free_layers.main,)


def ringing(folder, thickness, period):
    """Write the track of the ends of a free layer [mm]."""
    time, path = np.arange(0.0, 0.05, 2e-4), folder / f'{thickness}.csv'
    ends = 1e-5 * np.random.default_rng(1).normal(size=(2, time.size)) + 0.1
    ends[1] += thickness + 5e-4 * np.exp(-30.0 * time) * np.cos(2.0 * np.pi / period * time)
    rows = np.column_stack([time, *(1e3 * ends)])
    np.savetxt(path, rows, '%.4f', ';', header='t;bottom;top', comments='')
    return thickness, path


def test_free_layers_give_the_wave_speed(command, tmp_path):
    truth = {size: 2.0 * size / 7.8 for size in (5.6e-3, 16.8e-3, 29.1e-3)}
    args = [word for size, period in truth.items() for word in ringing(tmp_path, size, period)]
    args += ['--unit', 'mm', '--output', tmp_path / 'rig.yaml', '--thickness-error', 2e-5]
    result = command.json(*args)
    (row,) = (row for row in result['rows'] if row['name'] == 'layer.wave_speed')
    speed, error = row['value'], row['error']
    assert speed == pytest.approx(7.8, abs=4.0 * error)
    assert error < 0.03
    periods = [layer['period']['value'] for layer in result['layers']]
    assert periods == pytest.approx([*truth.values()], rel=5e-3)
    settings = files.read(tmp_path / 'rig.yaml')
    assert settings['layer.wave_speed'] == pytest.approx(speed, rel=1e-4)
    assert settings['uncertainty.wave_speed'] == pytest.approx(3.0**0.5 * error, rel=1e-2)
    assert 'mass: 0.0012' not in re.sub('#.*', '', (tmp_path / 'rig.yaml').read_text())
    rows = [line.split() for line in command.run(*args).splitlines() if ' mm: ' in line]
    assert [float(row[3]) for row in rows] == pytest.approx(1e3 * np.array(periods), rel=1e-3)


def test_free_layers_of_two_materials_give_a_warning(command, tmp_path):
    layers = ringing(tmp_path, 0.01, 2.6e-3), ringing(tmp_path, 0.02, 6.2e-3)
    command.run(*layers[0], *layers[1], '--unit', 'mm')
    assert 'not proportional to the thicknesses' in command.err
