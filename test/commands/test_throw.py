# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `throw`."""

from pathlib import Path
import re
import subprocess
import sys

import pytest
from soft_throw_ros.commands import throw
from soft_throw_ros.configuration.layers import default_file, library
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties

ROOT = Path(__file__).parents[2]

COMMAND = (throw.main,)
EXACT = ('--model', 'travelling_wave')


def test_json_has_the_models_to_the_last_digit(command):
    printed = command.json('--thickness', 0.01)
    assert tuple(printed['models']) == tuple(throw.MODEL_NOTES)
    assert tuple(printed['notes']) == (*throw.MODEL_NOTES, 'uncertainty')
    rig = Rig(layer=Layer(thickness=0.01))
    expected = simulate(rig)
    model = printed['models']['travelling_wave']
    assert printed['parameters']['layer.thickness'] == 0.01
    assert printed['parameters']['layer.name'] == 'custom'
    assert printed['rig']['mass_ratio'] == rig.mass_ratio
    for name in ('ejection_time', 'ejection_speed', 'energy_transfer', 'apex_height'):
        assert model[name] == getattr(expected, name)
    assert printed['leaves_linear_range'] is expected.leaves_linear_range is False
    ratio = rig.natural_frequency / rig.engine.frequency
    assert printed['models']['spring_mass']['energy_transfer'] == pytest.approx(
        spring_mass.first_release(frequency_ratio=ratio).energy_transfer, rel=1e-14
    )


def test_models_of_one_throw_agree_on_every_line(command):
    rig = ('--layer', 'gelatin_2.0mm', '--frequency', 31.1)  # with re-contacts, and then a fall
    names = ('travelling_wave', 'cells', 'cells_elastic', 'closed_form')
    options = [word for name in names for word in ('--model', name)]
    models = command.json(*options, *rig)['models']
    first = models['closed_form']
    for name in names[:3]:
        assert models[name].keys() == models['travelling_wave'].keys()
        assert models[name] == pytest.approx(models['travelling_wave'], rel=5e-4), name
        assert {key: models[name][key] for key in first} == pytest.approx(first, rel=3e-4)


def test_internal_loss_requires_cells_and_shows_its_heat(command):
    models = command.json('-p', 'layer.loss_tangent:=0.05')
    for name in ('closed_form', 'travelling_wave'):
        assert models['models'][name] is None
        assert '0.05' in models['notes'][name]
    cells = models['models']['cells']
    parts = cells['layer_energy'] + cells['projectile_energy'] + cells['heat']
    assert parts == pytest.approx(cells['plate_work'], rel=1e-3)
    assert cells['heat'] > 0.0


@pytest.mark.parametrize(
    ('thickness', 'speed', 'is_late'), [(0.0168, 7.8, False), (0.1, 3.16, True)]
)
def test_shocks_before_the_release_are_a_note(command, thickness, speed, is_late):
    rig = ('--thickness', thickness, '--wave-speed', speed, '-p',
           'layer.stress_strain_law:=neo_hookean')
    printed = command.json(*rig, '--model', 'cells')
    layer = Layer(thickness=thickness, wave_speed=speed, stress_strain_law='neo_hookean')
    shock_time = Rig(layer=layer).shock_time
    released = printed['models']['cells']['ejection_time']
    assert (released > shock_time) is is_late
    assert ('shocks' in printed['notes']) is is_late
    assert not is_late or f'{1e3 * shock_time:.3g} ms' in printed['notes']['shocks']


def test_table_has_the_models_side_by_side_as_in_the_json(command):
    lines = command.run().splitlines()
    models = command.json()['models']
    assert max(map(len, lines)) <= 100
    head = [line.ljust(100) for line in lines[2:4]]
    columns = [28 + 12 * n for n in range(len(models))]
    words = ['_'.join(line[start:start + 12].strip() for line in head) for start in columns]
    assert [word.strip('_') for word in words] == list(models)
    for title, name, scale in (
        ('energy transfer alpha', 'energy_transfer', 1.0),
        ('ejection time t_e', 'ejection_time', 1e3),
    ):
        (shown,) = [line for line in lines if line.startswith(title)]
        numbers = [float(shown[start:start + 12]) for start in columns]
        expected = [scale * model[name] for model in models.values()]
        assert numbers == pytest.approx(expected, rel=5e-6)


def test_uncertainty_of_the_rig_is_shown(command):
    options = [*EXACT, '-p', 'uncertainty.thickness:=1e-3', '-p', 'uncertainty.mass:=0']
    printed = command.json(*options)
    expected = prediction_uncertainty(Rig(), Uncertainties(thickness=1e-3, mass=0.0))
    assert printed['uncertainty'] == expected.values()
    assert printed['notes']['uncertainty'] in command.run(*options)


def test_options_replace_values_of_the_file(command, write):
    path = write('twin: {ros__parameters: {gravity: 0.0, layer.name: gelatin_2.0mm}}', 'a.yaml')
    printed = command.json('--config', path, *EXACT)['parameters']
    assert printed['gravity'] == 0.0
    assert printed['layer.thickness'] == library().layers['gelatin_2.0mm']['layer.thickness']
    printed = command.json('--config', path, '--thickness', 0.01, *EXACT)['parameters']
    assert (printed['layer.name'], printed['layer.thickness']) == ('custom', 0.01)
    defaults = default_file().with_name('twin.yaml')
    assert command.run('--config', defaults, *EXACT) == command.run(*EXACT)


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        (('--thickness', '16.8'), 'argument --thickness: layer.thickness .* m, got 16.8'),
        (('--thickness', 'soft'), "argument --thickness: .* got 'soft'"),
        (('--layer', 'jelly'), "argument --layer: .* got 'jelly'"),
        (('--motion', 'measured'), "argument --motion: .*'measured'"),
        (('--model', 'magic'), "argument --model: .* 'magic'"),
        (('-p', 'max_strain:=0'), 'argument -p: max_strain must be .* got 0'),
        (('--layer', 'gelatin_2.0mm', '--thickness', '0.01'), 'is 0.002, got 0.01'),
        (('--thicknes', '0.01'), '--thicknes 0.01'),
        (('--config', 'no_such.yaml'), 'no_such.yaml: '),
    ],
)
def test_refused_arguments_are_quoted(command, args, message):
    assert re.search(message, command.refused(*args))


def test_bad_file_is_named_with_its_line(command, write):
    path = write('twin:\n  ros__parameters:\n    gravity: -1\n', 'bad.yaml')
    assert command.refused('--config', path).startswith(f'{path}:3: gravity must be')


def test_closed_output_pipe_gives_no_traceback():
    """A pipe is closed before anything is read, as `| head` may do."""
    with subprocess.Popen(
        [sys.executable, '-m', 'soft_throw_ros', 'throw', '--json', '--model', 'closed_form'],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        process.stdout.close()
        errors = process.stderr.read()
        assert process.wait(timeout=100) == 0
    assert 'rror' not in errors
