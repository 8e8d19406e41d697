# SPDX-License-Identifier: Apache-2.0
"""The command `throw`."""

import csv
import json
import math
from pathlib import Path
import re
import subprocess
import sys

import pytest
from soft_throw_ros.commands import throw
from soft_throw_ros.commands.rig_options import OPTIONS
from soft_throw_ros.configuration import files, LAYERS, TWIN
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.travelling_wave import first_release

ROOT = Path(__file__).parents[2]


def run(capsys, *args):
    """Run the command; return what it printed."""
    assert throw.main([str(arg) for arg in args]) == 0
    return capsys.readouterr().out


def run_json(capsys, *args):
    return json.loads(run(capsys, '--json', *args))


EXACT = ('--model', 'travelling_wave')


def refused(capsys, *args):
    """Run the command, which refuses something; return what it says."""
    with pytest.raises(SystemExit) as end:
        throw.main([str(arg) for arg in args])
    assert end.value.code == 2
    out, err = capsys.readouterr()
    assert out == ''
    usage, message = err.splitlines()[-2:]  # it may have said before that it compiles
    assert usage.startswith('usage: ')
    return message.partition('error: ')[2]


@pytest.fixture
def write(tmp_path):
    """Write a file; return its path."""

    def write(text, name='cases.csv'):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def test_json_has_the_models_to_the_last_digit(capsys):
    printed = run_json(capsys, '--thickness', 0.01)
    assert tuple(printed['models']) == tuple(throw.MODELS)
    assert tuple(printed['notes']) == (*throw.MODELS, 'uncertainty')
    rig = Rig(layer=Layer(thickness=0.01))
    exact = simulate(rig)
    model = printed['models']['travelling_wave']
    assert printed['parameters']['layer.thickness'] == 0.01
    assert printed['parameters']['layer.name'] == 'custom'
    assert printed['rig']['mass_ratio'] == rig.mass_ratio
    assert model['ejection_time'] == exact.ejection_time
    assert model['ejection_speed'] == exact.ejection_speed
    assert model['energy_transfer'] == exact.energy_transfer
    assert model['peak_strain'] == exact.peak_strain.value
    assert model['apex_height'] == exact.apex_height
    assert printed['leaves_linear_range'] is exact.leaves_linear_range is True
    ratio = rig.natural_frequency / rig.engine.frequency
    assert printed['models']['spring_mass']['energy_transfer'] == pytest.approx(
        spring_mass.first_release(frequency_ratio=ratio).energy_transfer, rel=1e-14
    )


@pytest.mark.parametrize(
    'options',
    [
        [],
        ['--gravity', 0],
        ['--motion', 'harmonic', '--layer', 'gelatin_29.1mm'],
        # with re-contacts, and with a fall afterwards
        ['--layer', 'gelatin_2.0mm', '--frequency', 31.1, '--gravity', 0],
        ['--layer', 'gelatin_2.0mm', '--frequency', 31.1],
    ],
    ids=lambda options: ' '.join(map(str, options)),
)
def test_other_models_agree_with_the_exact_one_on_every_line(capsys, options):
    same = ('stepper', 'finite_difference', 'finite_difference_elastic')
    asked = [word for name in same for word in ('--model', name)]
    models = run_json(capsys, *EXACT, *asked, *options)['models']
    exact = models['travelling_wave']
    for name in same:
        found = models[name]
        missing = {'peak_strain', 'peak_strain_depth'} if name == 'stepper' else set()
        assert exact.keys() - found.keys() == missing
        if name != 'stepper':  # it is known to half a cell
            depth = found.pop('peak_strain_depth')
            assert depth == pytest.approx(exact['peak_strain_depth'], rel=1e-2)
        assert found == pytest.approx({key: exact[key] for key in found}, rel=5e-4), name
        assert found['recontacts'] == exact['recontacts']


def test_internal_loss_costs_energy_and_is_what_is_missing(capsys):
    printed = run_json(capsys, '--loss-tangent', 0.05)
    models = printed['models']
    assert models['travelling_wave'] is None
    assert printed['notes']['travelling_wave'].startswith('none, layer.loss_tangent must be 0')
    lossy = models['finite_difference']
    assert lossy['energy_transfer'] == pytest.approx(3.2556, abs=1e-4)
    for name in ('stepper', 'finite_difference', 'finite_difference_glued'):
        parts = ('layer_energy', 'projectile_energy', 'heat')
        total = sum(models[name][part] for part in parts)
        assert total == pytest.approx(models[name]['plate_work'], rel=1e-3)
        assert models[name]['heat'] > 0.0
    shared = {key: lossy[key] for key in models['stepper']}
    assert models['stepper'] == pytest.approx(shared, rel=2e-3)
    lines = run(capsys, '--loss-tangent', 0.05, '--model', 'finite_difference').splitlines()
    (heat,) = [line for line in lines if line.startswith('  to heat')]
    assert float(heat.split()[3]) == pytest.approx(1e3 * lossy['heat'], rel=5e-6)
    assert 'to heat' not in run(capsys, '--model', 'finite_difference')


def test_stepper_is_that_of_the_twin(capsys, write):
    path = write('twin: {ros__parameters: {model: finite_difference_glued}}', 'a.yaml')
    asked = ('--model', 'stepper', '--model', 'finite_difference_glued')
    models = run_json(capsys, '--config', path, *asked)['models']
    assert models['stepper']['energy_transfer'] == pytest.approx(
        models['finite_difference_glued']['energy_transfer'], rel=1e-3
    )


def test_table_lines_up_and_has_the_numbers_of_the_json(capsys):
    lines = run(capsys).splitlines()
    models = run_json(capsys)['models']
    assert max(map(len, lines)) <= 100
    head = [line.ljust(100) for line in lines[2:5]]
    columns = [28 + 12 * n for n in range(len(models))]
    words = ['_'.join(line[start : start + 12].strip() for line in head) for start in columns]
    assert [word.strip('_') for word in words] == list(models)
    (alpha,) = [line for line in lines if line.startswith('energy transfer alpha')]
    shown = [float(alpha[start : start + 12]) for start in columns]
    assert shown == pytest.approx(
        [model['energy_transfer'] for model in models.values()], rel=5e-6
    )
    (time,) = [line for line in lines if line.startswith('ejection time t_e')]
    assert time.split()[3] == 'ms'
    assert float(time.split()[4]) == pytest.approx(
        1e3 * models['travelling_wave']['ejection_time'], rel=5e-6
    )


def test_uncertainty_of_the_rig_is_shown(capsys):
    """Energy does not jump near the paper's thickness, so that a derivative tells as much."""
    only = ('thickness', 'wave-speed', 'mass', 'frequency', 'damping-ratio')
    nothing = [word for name in only for word in (f'--uncertain-{name}', 0)]
    exact = [*EXACT, '--gravity', 0]
    asked = [*exact, *nothing, '--uncertain-thickness', 1e-5]
    printed = run_json(capsys, *asked)
    found = printed['uncertainty']
    lower, upper = (
        run_json(capsys, *exact, '--thickness', 0.0168 + change)['models']['travelling_wave']
        for change in (-0.95e-5, 0.95e-5)
    )
    for name in ('ejection_time', 'ejection_speed', 'energy_transfer'):
        low, high = sorted((lower[name], upper[name]))
        assert found[f'{name}.low'] == pytest.approx(low, rel=1e-5)
        assert found[f'{name}.high'] == pytest.approx(high, rel=1e-5)
    assert printed['notes']['uncertainty'] in run(capsys, *asked)


def test_uncertainty_that_is_too_large_says_so_and_leaves_the_models(capsys):
    printed = run_json(capsys, *EXACT, '--thickness', 0.002, '--uncertain-thickness', 0.002)
    assert printed['uncertainty'] is None
    assert 'uncertainty.thickness must be below' in printed['notes']['uncertainty']
    assert printed['models']['travelling_wave'] is not None


def test_table_warns_beyond_the_linear_range_only(capsys):
    assert 'Strain beyond 10 % leaves the linear range' in run(capsys, *EXACT)
    assert 'linear range' not in run(capsys, *EXACT, '--max-strain', 0.2)
    assert 'Strain beyond 1 %' in run(capsys, *EXACT, '--max-strain', 0.01)


def test_model_that_refuses_a_rig_says_why_and_leaves_the_others(capsys):
    # So light a projectile relaxes 40 times per step that real time can afford
    options = (
        '--mass', 1e-5, '--thickness', 0.1, '--diameter', 0.2, *EXACT, '--model', 'stepper',
    )  # fmt: skip
    printed = run_json(capsys, *options)
    assert printed['models']['stepper'] is None
    assert re.match(r'none, projectile\.mass 1e-05 kg', printed['notes']['stepper'])
    assert printed['models']['travelling_wave']['energy_transfer'] > 1.0
    table = run(capsys, *options)
    assert printed['notes']['stepper'] in table
    assert 'nan' not in table


def test_plate_that_is_measured_is_for_the_twin(capsys):
    assert refused(capsys, '--motion', 'measured') == (
        "argument --motion: engine.motion must be one of 'underdamped', 'harmonic', "
        "got 'measured'; what is measured is for the twin"
    )


def test_every_parameter_of_the_rig_is_an_option(capsys):
    with pytest.raises(SystemExit) as end:
        throw.main(['--help'])
    assert end.value.code == 0
    shown = ''.join(capsys.readouterr().out.split())
    for entry in TWIN.entries:
        if entry.group in ('engine', 'layer', 'projectile') or entry.name == 'gravity':
            option = OPTIONS[entry.name]
            assert f'{option}{entry.unit.upper()}' in shown
            if entry.name != 'engine.motion':  # of which a command knows less
                assert ''.join(entry.meaning.replace('`', '').split()) in shown
    assert "oneof'underdamped','harmonic'(default" in shown
    assert len(set(OPTIONS.values())) == len(OPTIONS)
    assert '--modelNAME' in shown
    assert '--max-strainNUMBER' in shown


def test_options_replace_what_the_file_says(capsys, write):
    path = write('twin: {ros__parameters: {gravity: 0.0, layer.name: gelatin_2.0mm}}', 'a.yaml')
    printed = run_json(capsys, '--config', path, *EXACT)['parameters']
    assert printed['gravity'] == 0.0
    assert printed['layer.thickness'] == LAYERS['gelatin_2.0mm']['layer.thickness']
    printed = run_json(capsys, '--config', path, '--thickness', 0.01, *EXACT)['parameters']
    assert (printed['layer.name'], printed['layer.thickness']) == ('custom', 0.01)
    assert run(capsys, '--config', files.default_file(), *EXACT) == run(capsys, *EXACT)


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        (('--thickness', '16.8'), 'argument --thickness: layer.thickness .* m, got 16.8'),
        (('--thickness', 'nan'), 'argument --thickness: .* got nan'),
        (('--thickness', 'soft'), "argument --thickness: .* got 'soft'"),
        (('--mass', '-1'), 'argument --mass: .* got -1'),
        (('--frequency', '0'), 'argument --frequency: .* got 0'),
        (('--layer', 'jelly'), "argument --layer: .* got 'jelly'"),
        (('--loss-tangent', '-0.1'), 'argument --loss-tangent: .* from 0 to 2, got -0.1'),
        (('--model', 'magic'), "argument --model: invalid choice: 'magic'"),
        (('--max-strain', '0'), 'max_strain must be .* got 0'),
        (('--layer', 'gelatin_2.0mm', '--thickness', '0.01'), 'is 0.002, got 0.01'),
        (('--thicknes', '0.01'), 'unrecognized arguments: --thicknes 0.01'),
        (('--config', 'no_such.yaml'), 'no_such.yaml: No such file'),
        (('--cases', 'no_such.csv'), 'no_such.csv: No such file'),
        (('--output', 'no_such/folder'), 'no_such/folder: No such file'),
        (('--cases', 'a.csv', '--json'), 'argument --json: not allowed with argument --cases'),
        (('--cases', 'a.csv', '--mass', '1'), 'argument --mass: not allowed with argument --ca'),
        (('--cases', 'a.csv', '--config', 'b'), 'argument --config: not allowed'),
        (('--cases', 'a.csv', '--max-strain', '1'), 'argument --max-strain: not allowed'),
        (('--cases', 'a.csv', *EXACT), 'argument --model: not allowed'),
    ],
)
def test_what_is_refused_is_quoted(capsys, args, message):
    assert re.search(message, refused(capsys, *args))


def test_bad_file_is_named_with_its_line(capsys, write):
    path = write('twin:\n  ros__parameters:\n    gravity: -1\n', 'bad.yaml')
    assert refused(capsys, '--config', path).startswith(f'{path}:3: gravity must be')


def test_cases_get_a_release_row_for_row(capsys, write):
    cases = [(0.2342, 8.242, 0.0), (0.63, 7.3, 0.064), (30.0, 0.5, 0.3)]
    path = write(
        # another order, another column, spaces, an empty line, the mark of a spreadsheet
        '\ufeffname, kappa,zeta,mu\r\n'
        + ''.join(f'"a, b",{kappa},{zeta} ,{mu}\r\n' for mu, kappa, zeta in cases)
        + '\r\n'
    )
    rows = list(csv.DictReader(run(capsys, '--cases', path).splitlines()))
    assert [tuple(float(row[name]) for name in ('mu', 'kappa', 'zeta')) for row in rows] == cases
    for row, (mu, kappa, zeta) in zip(rows, cases, strict=True):
        exact = first_release(mass_ratio=mu, speed_ratio=kappa, damping_ratio=zeta)
        assert float(row['te_f']) == pytest.approx(exact.ejection_phase, abs=1e-12)
        assert float(row['alpha']) == pytest.approx(exact.energy_transfer, rel=1e-12)


def test_no_cases_give_no_rows(capsys, write):
    assert run(capsys, '--cases', write('mu,kappa,zeta\n')) == 'mu,kappa,zeta,te_f,alpha\n'


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('mu,kappa,zeta\n1,2,0\n\n1,soft,0\n', r":4: kappa must be .* got 'soft'"),
        ('mu,kappa,zeta\n0,2,0\n', r":2: mu must be .* positive, got '0'"),
        ('mu,kappa,zeta\n1,-2,0\n', r":2: kappa must be .* got '-2'"),
        ('mu,kappa,zeta\n1,inf,0\n', r":2: kappa must be .* got 'inf'"),
        ('mu,kappa,zeta\n1,2,nan\n', r":2: zeta must be .* got 'nan'"),
        ('mu,kappa,zeta\n1,2,1\n', r":2: zeta must be .* below 1, got '1'"),
        ('mu,kappa,zeta\n1,2\n', r":2: must have 3 values, got \['1', '2'\]"),
        ('mu,kappa\n1,2\n', r":1: must name the columns mu, kappa, zeta, got 'mu,kappa'"),
        ('', r':1: must name the columns'),
        (b'mu,kappa,zeta\n1,\xff,0\n', r': is no UTF-8 text'),
        # far outside of what can be resolved: a named error, and no wrong number
        ('mu,kappa,zeta\n1,2,0\n1e6,1e5,0\n1e7,1e5,0\n', r':3: no release .* mass_ratio 1e\+06'),
    ],
)
def test_bad_case_is_named_with_file_line_and_value(capsys, write, text, message):
    path = write(text)
    said = refused(capsys, '--cases', path)
    assert re.match(re.escape(str(path)) + message, said)


def test_output_goes_to_the_file(capsys, write, tmp_path):
    path = tmp_path / 'result'
    assert run(capsys, '--json', '--output', path, *EXACT) == ''
    assert json.loads(path.read_text())['parameters'].keys() <= TWIN.defaults().keys()
    cases = write('mu,kappa,zeta\n1,2,0\n')
    assert run(capsys, '--cases', cases, '--output', path) == ''
    assert math.isfinite(float(path.read_text().splitlines()[1].split(',')[-1]))


def test_reader_that_has_seen_enough_gets_no_traceback():
    """A pipe is closed before anything is read, as `| head` may do."""
    with subprocess.Popen(
        [sys.executable, '-m', 'soft_throw_ros', 'throw', '--cases', '-'],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        process.stdout.close()
        process.stdin.write('mu,kappa,zeta\n' + '1,2,0\n' * 20000)
        process.stdin.close()
        said = process.stderr.read()
        assert process.wait(timeout=100) == 0
    assert 'rror' not in said
