# SPDX-License-Identifier: Apache-2.0
"""The command `design recommend`."""

import json
import re

import pytest
from soft_throw_ros.commands import design
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.configuration.layers import library
from soft_throw_ros.core.rig import Projectile, Rig
from soft_throw_ros.design.objective import Limits, Robust, Versatile
from soft_throw_ros.design.recommendation import predict, recommend
from soft_throw_ros.design.requests import limits_of, objective_of
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties

MINE = """\
jelly:
  description: Firm jelly
  source: measured
  density: 1050.0
  wave_speed: {value: 18.0, range: [17.0, 19.0]}
  loss_tangent: 0.01
  thicknesses: [10e-3, 20e-3, 40e-3]
"""


@pytest.fixture
def mine(tmp_path):
    """Write a library, and return its path."""
    path = tmp_path / 'mine.yaml'
    path.write_text(MINE)
    return path


def run(capsys, *args):
    """Run the command; return what it printed."""
    assert design.main(['recommend', *map(str, args)]) == 0
    return capsys.readouterr().out


def run_json(capsys, *args):
    return json.loads(run(capsys, '--json', *args))


def refused(capsys, *args):
    """Run the command, which refuses something; return what it says."""
    with pytest.raises(SystemExit) as end:
        design.main(['recommend', *map(str, args)])
    assert end.value.code == 2
    out, err = capsys.readouterr()
    assert out == ''
    usage, message = err.splitlines()[-2:]  # it may have said before that it compiles
    assert usage.startswith('usage: ')
    return message.partition('error: ')[2]


def row(printed, title):
    """Return the cells of a row of the table."""
    (line,) = re.findall(rf'^{re.escape(title)}\s.*', printed, re.MULTILINE)
    return line[28:].split()


def test_table_is_what_is_recommended_beside_what_is_there(capsys):
    printed = run(capsys, '--vary', 'thickness')
    best, now = recommend(Rig(), vary='thickness'), predict(Rig())
    assert printed.startswith(f'{best.why}\n\n')
    assert printed.endswith(f'\n\n{best.note}\n')
    for title, name, scale in (
        ('thickness L_s', 'thickness', 1e3),
        ('wave speed c_s', 'wave_speed', 1.0),
        ('energy transfer alpha', 'energy_transfer', 1.0),
        ('peak strain', 'peak_strain', 1e2),
        ('work of the plate', 'plate_work', 1e3),
    ):
        shown = list(map(float, row(printed, title)))
        expected = [getattr(each, name) for each in (now, best, best.by_wave_speed, best.by_both)]
        assert shown == pytest.approx([scale * value for value in expected], rel=1e-5)
    assert prediction_uncertainty(best.rig).sentence() in printed
    assert 'Strain beyond 10 % leaves the linear range (now, recommended)' in printed


def test_table_says_what_a_deviation_costs(capsys):
    printed = run(capsys, '--vary', 'thickness')
    items = {item.name: item for item in recommend(Rig(), vary='thickness').sensitivities}
    _, table = printed.split('around the recommended layer')
    for name, scale in (('thickness', 1e3), ('wave_speed', 1.0), ('mass', 1e3)):
        (line,) = re.findall(rf'^{name.replace("_", " ")} .*', table, re.MULTILINE)
        best, low, high, within, more = re.findall(r'[-+]?\d+\.?\d*', line)
        item = items[name]
        assert float(best) == pytest.approx(scale * item.value, rel=1e-3)
        assert float(low) == pytest.approx(scale * item.low, rel=1e-3)
        assert float(high) == pytest.approx(scale * item.high, rel=1e-3)
        assert float(within) == pytest.approx(scale * item.tolerance, rel=0.05)
        assert float(more) == pytest.approx(item.elasticity, abs=0.006)


def test_json_has_everything_to_the_last_digit(capsys):
    printed = run_json(capsys, '--mass', 2e-3, '--vary', 'wave_speed')
    rig = Rig(projectile=Projectile(mass=2e-3))
    best = recommend(rig, vary='wave_speed')
    found = printed['recommendation']
    assert found['wave_speed'] == best.wave_speed
    assert found['energy_transfer'] == best.energy_transfer
    assert found['now']['energy_transfer'] == predict(rig).energy_transfer
    assert found['by_both']['thickness'] == best.by_both.thickness
    assert [item['name'] for item in found['sensitivities']] == [
        item.name for item in best.sensitivities
    ]
    assert found['why'] == best.why
    assert printed['parameters']['projectile.mass'] == 2e-3
    assert printed['parameters']['recommendation.vary'] == 'wave_speed'
    uncertainty = prediction_uncertainty(best.rig)
    assert printed['uncertainty'] == uncertainty.values()


def test_layer_that_throws_nothing_is_said_and_is_null_in_json(capsys):
    printed = run_json(capsys, '--mass', 1.0)
    assert printed['recommendation']['now'] is None
    assert printed['recommendation']['now_score'] == 0.0
    table = run(capsys, '--mass', 1.0)
    assert 'as it is, the layer throws nothing (alpha nothing -> 3.03)' in table
    assert row(table, 'energy transfer alpha')[:2] == ['-', '3.02776']


def test_options_are_what_is_asked(capsys):
    options = {
        'objective': 'robust', 'quantile': 0.05, 'vary': 'thickness', 'thickness-max': 0.012,
        'uncertain-wave-speed': 0.6, 'uncertain-mass': 0.05,
    }  # fmt: skip
    args = [text for name, value in options.items() for text in (f'--{name}', value)]
    best = recommend(
        Rig(),
        vary='thickness',
        objective=Robust(uncertainties=Uncertainties(wave_speed=0.6, mass=0.05), quantile=0.05),
        limits=Limits(thickness_max=0.012),
    )
    found = run_json(capsys, *args)['recommendation']
    assert (found['thickness'], found['score']) == (best.thickness, best.score)
    assert found['thickness'] <= 0.012
    assert run(capsys, *args).startswith(best.why)


def test_versatile_layer_is_for_the_projectiles_and_frequencies_given(capsys):
    args = ('--objective', 'versatile', '--masses', 1e-3, 3e-3, 6e-3, '--frequencies', 50, 70)
    best = recommend(
        Rig(), objective=Versatile(masses=(1e-3, 3e-3, 6e-3), frequencies=(50.0, 70.0))
    )
    printed = run_json(capsys, *args)
    assert printed['parameters']['recommendation.masses'] == [1e-3, 3e-3, 6e-3]
    assert printed['recommendation']['score'] == best.score
    assert printed['recommendation']['objective'] == 'versatile'


def test_layer_is_picked_from_a_library_of_one_s_own(capsys, mine):
    args = ('--vary', 'library', '--library', mine)
    found = run_json(capsys, *args)['recommendation']
    ranks = {item['layer']: item['score'] for item in found['candidates']}
    assert found['layer'] == 'jelly_40.0mm' == max(ranks, key=ranks.get)
    layers = library(mine).layers
    for name in ('jelly_20.0mm', 'jelly_40.0mm'):
        settings = {**TWIN.defaults(), 'layer.library': str(mine), **layers[name]}
        expected = predict(rig_of(settings)).energy_transfer
        assert ranks[name] == pytest.approx(expected, rel=1e-12)
    assert len(ranks) == 8  # others are worse, and shown as well
    assert list(ranks.values()) == sorted(ranks.values(), reverse=True)
    printed = run(capsys, *args)
    assert printed.startswith('layer jelly_40.0mm and thickness 16.8 -> 40 mm: ')
    _, table = printed.split('from the library')
    assert re.search(rf'^jelly_40.0mm +40.0 +{found["score"]:.3f}$', table, re.MULTILINE)


def test_file_of_the_twin_says_what_is_asked_and_options_replace_it(capsys, tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text(
        'twin: {ros__parameters: {engine.motion: measured, engine.frequency: 58.0,\n'
        '  recommendation: {vary: thickness, thickness_max: 0.03, max_strain: 0.12}}}\n'
    )
    printed = run_json(capsys, '--config', path, '--max-strain', 0.11)
    settings = {
        **TWIN.defaults(), 'engine.frequency': 58.0, 'recommendation.vary': 'thickness',
        'recommendation.thickness_max': 0.03, 'recommendation.max_strain': 0.11,
    }  # fmt: skip
    best = recommend(
        rig_of(settings),
        vary='thickness',
        objective=objective_of(settings),
        limits=limits_of(settings),
    )
    assert printed['recommendation']['thickness'] == best.thickness
    assert printed['recommendation']['peak_strain'] <= 0.11 * (1.0 + 1e-6)


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        (['--objective', 'best'], "argument --objective: .* 'aim', got 'best'"),
        (['--objective', 'aim'], "recommendation.objective 'aim' is what `design aim` is for"),
        (['--vary', 'amplitude'], "recommendation.vary 'amplitude' is for .* alone, got 'peak'"),
        (['--motion', 'measured'],
         "argument --motion: engine.motion must be one of 'underdamped', 'harmonic', "
         "got 'measured'; what is measured is for the twin"),
        (['--max-strain', '-1'], r'argument --max-strain: .* or 0, got -1\.0'),
        (['--quantile', '0.6'], r'argument --quantile: .* from 0 to 0.5, got 0\.6'),
        (['--masses', '0.001', 'heavy'], r"argument --masses: .* got \[0.001, 'heavy'\]"),
        (['--masses', '0.001', '-2'], r'argument --masses: .* got \[0.001, -2.0\]'),
        (['--frequencies', '0'], r'argument --frequencies: .* from 1 to 1000 Hz, got \[0.0\]'),
        (['--thickness-min', '0.03', '--thickness-max', '0.02'],
         'argument --thickness-min: .* must be below .* got 0.03 and 0.02'),
        (['--thickness-min', '0.06'], 'thickness_min must be below .* got 0.06 and 0.05'),
        (['--library', 'no.yaml'], 'argument --library: no.yaml: No such file'),
        (['--objective', 'robust', '--uncertain-wave-speed', '10'],
         'uncertainty.wave_speed must be below the wave speed itself, 7.8, got 10'),
        (['--max-strain', '0.001'],
         'no layer with .* keeps a strain of at most 0.001 and .* inf m/s2; the best without '
         'these limits has 0.0359 and 523.4'),
        (['--gravity', '30', '--amplitude', '1e-5'], 'no throw .* gravity .19 of the largest'),
    ],
)  # fmt: skip
def test_what_is_refused_is_quoted(capsys, args, message):
    assert re.match(message, refused(capsys, *args))


def test_broken_library_is_refused_with_its_line(capsys, tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text(MINE.replace('1050.0', 'heavy'))
    assert refused(capsys, '--library', path, '--vary', 'library') == (
        f'argument --library: {path}:4: density must be a number from 50 to 5000 kg/m3, '
        "got 'heavy'"
    )
