# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `throw`, and the options of a rig."""

import argparse
import re

import pytest
from soft_throw_ros.commands import throw
from soft_throw_ros.commands.options import add_rig_options, read_settings, stated_parameters
from soft_throw_ros.configuration import TWIN
from soft_throw_ros.configuration.layers import default_file, library
from soft_throw_ros.core.closed_form import spring_release
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate

COMMAND = (throw.main,)


def test_answer_comes_first_and_json_and_the_table_have_all_numbers(command):
    printed, table = command.json('--thickness', 0.01), command.run('--verbose')
    rig = Rig(layer=Layer(thickness=0.01))
    expected, ratio = simulate(rig), rig.natural_frequency / rig.engine.frequency
    assert tuple(printed['notes']) == ('throw', 'spring', 'uncertainty')
    assert printed['parameters']['layer.thickness'] == 0.01
    assert printed['parameters']['layer.name'] == 'custom'
    assert printed['rig']['mass_ratio'] == rig.mass_ratio
    for name in ('ejection_time', 'ejection_speed', 'energy_transfer', 'apex_height'):
        assert printed['throw'][name] == getattr(expected, name)
    assert printed['leaves_linear_range'] is False
    spring = spring_release(frequency_ratio=ratio).energy_transfer
    assert printed['spring']['energy_transfer'] == pytest.approx(spring, rel=1e-14)
    lossy = command.json('-p', 'layer.loss_tangent:=0.05')['throw']
    parts = lossy['layer_energy'] + lossy['projectile_energy'] + lossy['heat']
    assert parts == pytest.approx(lossy['plate_work'], rel=1e-3)
    assert lossy['heat'] > 0.0
    assert table.startswith(command.run().partition('\n')[0])
    assert 'ejection_time' not in command.run()
    printed = command.json()
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


@pytest.mark.parametrize(('amplitude', 'texts'), [
    (1e-5, ['below gravity']), (2e-3, []), (5e-3, ['linear range']), (0.03, ['impossible'])
])
def test_plate_that_cannot_throw_and_large_strain_are_explained(command, amplitude, texts):
    code = int(amplitude == 1e-5)
    words = '--amplitude', amplitude, *code * ('-p', 'engine.damping_ratio:=0.5')  # soon at rest
    printed = command.run(*words, code=code)
    assert re.findall('below gravity|linear range|impossible', printed) == texts
    assert printed.startswith('no throw: ') == code
    assert (command.json(*words, code=code)['throw'] is None) == code


LAYER = set(TWIN.names_in('layer'))


@pytest.mark.parametrize(('words', 'text', 'stated'), [
    ((), '', set()),
    (('-p', 'layer.density:=900'), '', {'layer.density'}),
    (('--mass', '0.002'), '', {'projectile.mass'}),
    (('--layer', 'gelatin_16.8mm'), '', LAYER),
    (('--stack', '8e-3 7 1000'), '', LAYER),
    (('--layer', 'custom'), '', {'layer.name'}),
    ((), 'layer: {name: gelatin_16.8mm}', LAYER),
    (('-p', 'gravity:=0'), 'projectile: {mass: 0.002}', {'projectile.mass', 'gravity'}),
    (('--mass=0.01', '-p', 'projectile.mass:=2e-3'), '', {'projectile.mass'}),
])
def test_options_and_file_state_parameters(write, words, text, stated):
    parser = argparse.ArgumentParser()
    add_rig_options(parser)
    if text:
        words += ('--config', str(write(f'twin: {{ros__parameters: {{{text}}}}}')))
    arguments = parser.parse_args(words)
    assert stated_parameters(arguments) == stated
    mass = read_settings(arguments)['projectile.mass']
    assert mass == (0.002 if 'projectile.mass' in stated else TWIN.defaults()['projectile.mass'])
