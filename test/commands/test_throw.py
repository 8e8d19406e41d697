# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `throw`, and the options of a rig."""

import argparse
from pathlib import Path
import re

import pytest
from soft_throw_ros.commands import throw
from soft_throw_ros.commands.options import add_rig_options, read_settings, stated_parameters
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.configuration.layers import default_file, library
from soft_throw_ros.core.closed_form import spring_release
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate

ROOT = Path(__file__).parents[2]

COMMAND = (throw.main,)


def test_json_has_the_throw_and_the_spring_to_the_last_digit(command):
    printed = command.json('--thickness', 0.01)
    assert tuple(printed['notes']) == ('throw', 'spring', 'uncertainty')
    rig = Rig(layer=Layer(thickness=0.01))
    expected = simulate(rig)
    assert printed['parameters']['layer.thickness'] == 0.01
    assert printed['parameters']['layer.name'] == 'custom'
    assert printed['rig']['mass_ratio'] == rig.mass_ratio
    for name in ('ejection_time', 'ejection_speed', 'energy_transfer', 'apex_height'):
        assert printed['throw'][name] == getattr(expected, name)
    throw_ = command.json('-p', 'layer.loss_tangent:=0.05')['throw']
    parts = throw_['layer_energy'] + throw_['projectile_energy'] + throw_['heat']
    assert parts == pytest.approx(throw_['plate_work'], rel=1e-3)
    assert throw_['heat'] > 0.0
    assert printed['leaves_linear_range'] is False
    ratio = rig.natural_frequency / rig.engine.frequency
    assert printed['spring']['energy_transfer'] == pytest.approx(
        spring_release(frequency_ratio=ratio).energy_transfer, rel=1e-14
    )


def test_answer_comes_first_and_the_table_on_request(command):
    printed, table = command.json(), command.run('--verbose')
    assert table.startswith(command.run().partition('\n')[0])
    assert 'ejection_time' not in command.run()
    for name, scale in (('energy_transfer', 1.0), ('ejection_time', 1e3)):
        expected = [scale * printed[column][name] for column in ('throw', 'spring')]
        assert list(map(float, command.row(table, name))) == pytest.approx(expected, rel=5e-6)


def test_options_replace_values_of_the_file(command, write):
    path = write('twin: {ros__parameters: {gravity: 0.0, layer.name: gelatin_2.0mm}}', 'a.yaml')
    printed = command.json('--config', path)['parameters']
    assert printed['gravity'] == 0.0
    assert printed['layer.thickness'] == library().layers['gelatin_2.0mm']['layer.thickness']
    printed = command.json('--config', path, '--thickness', 0.01)['parameters']
    assert (printed['layer.name'], printed['layer.thickness']) == ('custom', 0.01)
    defaults = default_file().with_name('twin.yaml')
    assert command.run('--config', defaults) == command.run()


def test_plate_that_gravity_holds_is_explained_with_exit_code_1(command):
    assert command.json('--amplitude', 1e-5, code=1)['throw'] is None
    printed = command.run('--amplitude', 1e-5, code=1)
    assert re.match('no throw: .*acceleration.* below gravity', printed)


@pytest.mark.parametrize(
    ('amplitude', 'texts'), [(2e-3, []), (5e-3, ['linear range']), (0.03, ['impossible'])]
)
def test_strain_that_no_layer_can_bear_is_called_impossible(command, amplitude, texts):
    printed = command.run('--amplitude', amplitude)
    assert re.findall('linear range|impossible', printed) == texts


LAYER = set(TWIN.names_in('layer'))


@pytest.mark.parametrize(
    ('words', 'text', 'stated'),
    [
        ((), '', set()),
        (('-p', 'layer.density:=900'), '', {'layer.density'}),
        (('--mass', '0.002'), '', {'projectile.mass'}),
        (('--layer', 'gelatin_16.8mm'), '', LAYER),
        (('--stack', '8e-3 7 1000'), '', LAYER),
        (('--layer', 'custom'), '', {'layer.name'}),
        ((), 'layer: {name: gelatin_16.8mm}', LAYER),
        (('-p', 'gravity:=0'), 'projectile: {mass: 0.002}', {'projectile.mass', 'gravity'}),
        (('--mass=0.01', '-p', 'projectile.mass:=2e-3'), '', {'projectile.mass'}),
    ],
)
def test_options_and_file_state_parameters(write, words, text, stated):
    parser = argparse.ArgumentParser()
    add_rig_options(parser)
    if text:
        words += ('--config', str(write(f'twin: {{ros__parameters: {{{text}}}}}')))
    arguments = parser.parse_args(words)
    assert stated_parameters(arguments) == stated
    mass = read_settings(arguments)['projectile.mass']
    assert mass == (0.002 if 'projectile.mass' in stated else TWIN.defaults()['projectile.mass'])
