# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The commands `design recommend` and `design aim`."""

from functools import partial
import re

import pytest
from soft_throw_ros.commands import design
from soft_throw_ros.commands.design_texts import uncertainty_text
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.rig import Engine, Projectile, Rig
from soft_throw_ros.core.throws import last_release
from soft_throw_ros.design.aiming import aim
from soft_throw_ros.design.recommendation import predict, recommend
from soft_throw_ros.design.score import Limits, robust, versatile
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties

COMMAND = (design.main,)

MINE = """\
jelly:
  description: Firm jelly
  source: measured
  density: 1050.0
  wave_speed: {value: 18.0, range: [17.0, 19.0]}
  loss_tangent: 0.01
  thicknesses: [10e-3, 20e-3, 40e-3]
"""


@pytest.mark.parametrize(('law', 'is_warned'), [('linear', True), ('neo_hookean', False)])
def test_table_warns_beyond_the_linear_range_of_the_law_only(command, law, is_warned):
    args = ('--vary', 'thickness', '-p', f'layer.stress_strain_law:={law}', '--amplitude', 3e-3)
    printed = command.run('recommend', *args)
    assert ('leaves the linear range' in printed) is is_warned


def test_table_compares_the_recommended_and_the_present_layer(command):
    printed = command.run('recommend', '--vary', 'thickness')
    best, now = recommend(Rig(), vary='thickness'), predict(Rig())
    summary = command.json('recommend', '--vary', 'thickness')['recommendation']['summary']
    assert printed.startswith(f'{summary}\n\n')
    for title, name, scale in (
        ('thickness L_s', 'thickness', 1e3),
        ('wave speed c_s', 'wave_speed', 1.0),
        ('energy transfer alpha', 'energy_transfer', 1.0),
        ('peak strain', 'peak_strain', 1e2),
        ('work of the plate', 'plate_work', 1e3),
    ):
        expected = [getattr(each, name) for each in (now, best, best.by_wave_speed)]
        shown = list(map(float, command.row(printed, title)))
        assert shown == pytest.approx([scale * value for value in expected], rel=1e-5)
    assert uncertainty_text(prediction_uncertainty(best.rig).values()) in printed


def test_json_has_everything_to_the_last_digit(command):
    printed = command.json('recommend', '--mass', 2e-3, '--vary', 'wave_speed')
    rig = Rig(projectile=Projectile(mass=2e-3))
    best = recommend(rig, vary='wave_speed')
    result = printed['recommendation']
    assert result['wave_speed'] == best.wave_speed
    assert result['now']['energy_transfer'] == predict(rig).energy_transfer
    assert result['by_thickness']['thickness'] == best.by_thickness.thickness
    assert result['tolerances'] == best.tolerances
    assert printed['parameters']['recommendation.vary'] == 'wave_speed'
    assert printed['uncertainty'] == prediction_uncertainty(best.rig).values()


def test_layer_without_a_throw_is_null_in_json(command):
    request = ('--mass', 0.3, '--vary', 'thickness')
    result = command.json('recommend', *request)['recommendation']
    assert (result['now'], result['now_score']) == (None, 0.0)
    assert command.row(command.run('recommend', *request), 'energy transfer alpha')[0] == '-'


def test_options_define_the_request(command):
    settings = ('recommendation.thickness_max:=0.012', 'uncertainty.wave_speed:=6e-1',
                'uncertainty.mass:=0.05')
    args = ['--objective', 'robust', '--vary', 'thickness']
    args += [word for text in settings for word in ('-p', text)]
    best = recommend(
        Rig(),
        vary='thickness',
        objective=partial(robust, uncertainties=Uncertainties(wave_speed=0.6, mass=0.05)),
        limits=Limits(thickness_max=0.012),
    )
    result = command.json('recommend', *args)['recommendation']
    assert (result['thickness'], result['score']) == (best.thickness, best.score)
    args = ('--objective', 'versatile', '-p', 'recommendation.masses:=[1e-3, 3e-3, 6e-3]',
            '-p', 'recommendation.frequencies:=[50, 70]')
    objective = partial(versatile, masses=(1e-3, 3e-3, 6e-3), frequencies=(50.0, 70.0))
    result = command.json('recommend', *args)['recommendation']
    assert result['score'] == recommend(Rig(), objective=objective).score


def test_layer_is_chosen_from_a_user_library(command, write):
    mine = write(MINE)
    result = command.json('recommend', '--vary', 'library', '--library', mine)['recommendation']
    ranks = {item['layer']: item['score'] for item in result['candidates']}
    assert result['layer'] == 'jelly_40.0mm' == max(ranks, key=ranks.get)
    layers = library(mine).layers
    for name in ('jelly_20.0mm', 'jelly_40.0mm'):
        settings = {**TWIN.defaults(), 'layer.library': str(mine), **layers[name]}
        expected = predict(rig_of(settings)).energy_transfer
        assert ranks[name] == pytest.approx(expected, rel=1e-6)
    assert list(ranks.values()) == sorted(ranks.values(), reverse=True)
    printed = command.run('recommend', '--vary', 'library', '--library', mine)
    _, table = printed.split('from the library')
    assert re.search(rf'^jelly_40.0mm +40.0 +{result["score"]:.3f}$', table, re.MULTILINE)


def test_options_replace_the_request_of_a_twin_file(command, write):
    path = write(
        'twin: {ros__parameters: {engine.motion: measured, engine.frequency: 58.0,\n'
        '  recommendation: {vary: thickness, thickness_max: 0.03, max_strain: 0.12}}}\n'
    )
    result = command.json('recommend', '--config', path, '--max-strain', 0.11)['recommendation']
    best = recommend(
        Rig(engine=Engine(frequency=58.0)),
        vary='thickness',
        limits=Limits(thickness_max=0.03, max_strain=0.11),
    )
    assert result['thickness'] == best.thickness
    assert result['peak_strain'] <= 0.11 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        ('--objective best', "argument --objective: .*'best'"),
        ('--objective aim', "argument --objective: .*'aim'"),
        ('--vary amplitude', "argument --vary: .*'amplitude'"),
        ('--max-strain -1', r'argument --max-strain: .* or 0, got -1\.0'),
        ('-p recommendation.masses:=[0.001,x]', r"argument -p: .* got \[0.001, 'x'\]"),
        ('-p recommendation.masses:=[0.001', 'argument -p: recommendation.masses .* YAML'),
        ('-p gravitation:=3', r"argument -p: must be NAME:=VALUE .* 'gravitation:=3'"),
        ('-p gravity=3', "argument -p: must be NAME:=VALUE .* 'gravity=3'"),
        ('--objective robust -p uncertainty.wave_speed:=10', 'wave_speed .* 7.8, got 10'),
        ('--max-strain 0.001', 'no layer throws .* max_strain=0.001'),
        ('-p gravity:=30 --amplitude 1e-5', 'gravity is 19 of the largest'),
    ],
)
def test_refused_arguments_are_quoted(command, args, message):
    assert re.search(message, command.refused('recommend', *args.split()))


# aim


def test_table_has_the_present_throw_and_the_aim(command):
    printed = command.run('aim', '--target-height', 0.15)
    best = aim(Rig(), height=0.15)
    summary = command.json('aim', '--target-height', 0.15)['aim']['summary']
    assert printed.startswith(f'{summary}\n\n')
    columns = {
        'amplitude A': [2.0, 1e3 * best.amplitude],
        'rise above the layer': [1e3 * last_release(Rig()).height, 150.0],
        'peak strain': [1e2 * each.peak_strain for each in (predict(Rig()), best)],
    }
    for title, expected in columns.items():
        shown = list(map(float, command.row(printed, title)))
        assert shown == pytest.approx(expected, rel=1e-5)
    assert uncertainty_text(prediction_uncertainty(best.rig).values()) in printed


def test_file_that_aims_has_its_target_and_another_needs_one(command, write):
    rig = 'twin: {ros__parameters: {gravity: 5.0'
    aims = write(rig + ', recommendation: {objective: aim, target_speed: 1.5}}}', 'aims.yaml')
    assert command.json('aim', '--config', aims)['aim']['speed'] == pytest.approx(1.5)
    assert 'no target: give' in command.refused('aim', '--config', write(rig + '}}', 'other.yaml'))
