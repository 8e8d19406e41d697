# SPDX-License-Identifier: Apache-2.0
"""The command `design aim`."""

from dataclasses import replace
import json
import re

import pytest
from soft_throw_ros.commands import design, design_aim
from soft_throw_ros.core.rig import Layer, Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.aiming import aim, fly, Target
from soft_throw_ros.design.objective import Limits
from soft_throw_ros.design.recommendation import predict
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties

MINE = """\
jelly:
  description: Firm jelly
  source: measured
  density: 1000.0
  wave_speed: 22.6
  loss_tangent: 0.0
"""


def run(capsys, *args, code=0):
    """Run the command; return what it printed."""
    assert design.main(['aim', *map(str, args)]) == code
    return capsys.readouterr().out


def run_json(capsys, *args, code=0):
    return json.loads(run(capsys, '--json', *args, code=code))


def refused(capsys, *args):
    """Run the command, which refuses something; return what it says."""
    with pytest.raises(SystemExit) as end:
        design.main(['aim', *map(str, args)])
    assert end.value.code == 2
    out, err = capsys.readouterr()
    assert out == ''
    usage, message = err.splitlines()[-2:]  # it may have said before that it compiles
    assert usage.startswith('usage: ')
    return message.partition('error: ')[2]


def row(printed, title):
    """Return the cells of a row of the table."""
    (line,) = re.findall(rf'^{re.escape(title)}\s.*', printed, re.MULTILINE)
    return list(map(float, line[28:].split()))


def with_amplitude(amplitude):
    return replace(Rig(), engine=replace(Rig().engine, amplitude=amplitude))


def test_amplitude_that_is_printed_throws_so_high_when_simulated(capsys):
    printed = run_json(capsys, '--target-height', 0.15, '--vary', 'amplitude')
    amplitude = printed['aim']['amplitude']
    throw = simulate(with_amplitude(amplitude))
    rise = throw.apex_height - throw.rig.layer.thickness + throw.rig.static_sag
    assert rise == pytest.approx(0.15, rel=1e-6)
    assert printed['aim']['is_reached'] is True
    assert printed['aim']['target_height'] == 0.15
    assert printed['aim']['target_speed'] is None
    assert printed['aim']['layer'] == ''


def test_table_has_the_throw_now_the_aimed_one_and_that_with_this_layer(capsys):
    printed = run(capsys, '--target-height', 0.15)
    best, this = (aim(Rig(), Target(height=0.15), vary=vary) for vary in ('both', 'amplitude'))
    assert printed.startswith(f'{best.why}\n\n')
    assert re.search(r'^ +now +aimed +with$', printed, re.MULTILINE)
    now = predict(Rig())
    assert row(printed, 'amplitude A') == pytest.approx(
        [2.0, 1e3 * best.amplitude, 1e3 * this.amplitude], rel=1e-5
    )
    assert row(printed, 'rise') == pytest.approx([1e3 * fly(Rig()).height, 150.0, 150.0], rel=1e-5)
    assert row(printed, 'peak strain') == pytest.approx(
        [1e2 * each.peak_strain for each in (now, best, this)], rel=1e-5
    )
    assert prediction_uncertainty(best.rig).sentence() in printed


def test_table_has_no_third_column_if_the_layer_stays(capsys):
    printed = run(capsys, '--target-speed', 2, '--vary', 'amplitude')
    amplitudes = row(printed, 'amplitude A')
    assert len(amplitudes) == 2
    speed = simulate(with_amplitude(1e-3 * amplitudes[1])).ejection_speed
    assert speed == pytest.approx(2.0, rel=1e-5)


def test_speed_as_target_takes_the_place_of_the_default_height(capsys):
    printed = run_json(capsys, '--target-speed', 1.5, '--gravity', 0)
    assert (printed['aim']['target_height'], printed['aim']['target_speed']) == (None, 1.5)
    assert printed['aim']['speed'] == pytest.approx(1.5, rel=1e-9)
    assert printed['aim']['height'] is None  # there is no end to it
    assert printed['parameters']['recommendation.objective'] == 'aim'


def test_target_out_of_reach_says_what_would_do_and_ends_with_1(capsys):
    args = ('--target-height', 0.2, '--vary', 'amplitude', '--max-strain', 0.12)
    printed = run(capsys, *args, code=design_aim.NOT_REACHED)
    first = printed.splitlines()[0]
    assert re.match(
        r'0\.2 m high is not reached: it takes a strain of 16\.\d % instead of at most 12 %; '
        r'the most is 0\.1\d+ m high, with amplitude 2\.\d+ mm, strain 12 %, .*; '
        r'a layer of .* mm and .* m/s would do it: amplitude 2\.\d+ mm, strain [45].*',
        first,
    )
    assert re.search(r'^ +now +the$', printed, re.MULTILINE)
    found = run_json(capsys, *args, code=design_aim.NOT_REACHED)['aim']
    assert found['is_reached'] is False
    assert found['peak_strain'] == pytest.approx(0.12, rel=1e-5)
    thickness, speed = map(float, re.findall(r'a layer of ([\d.]+) mm and ([\d.]+) m/s', first)[0])
    layer = Layer(thickness=1e-3 * thickness, wave_speed=speed)
    would = aim(replace(Rig(), layer=layer), Target(height=0.2), limits=Limits(max_strain=0.12))
    assert would.is_reached


def test_amplitude_out_of_reach_is_named(capsys):
    printed = run(capsys, '--target-speed', 5, '--max-amplitude', 3e-3, code=1)
    assert re.match(
        r'5 m/s is not reached: it takes an amplitude of 6\.8\d mm instead of at most 3 mm; '
        r'the most is 2\.2\d+ m/s, with amplitude 3 mm,',
        printed,
    )


def test_layer_is_picked_from_a_library_of_one_s_own(capsys, tmp_path):
    path = tmp_path / 'mine.yaml'
    path.write_text(MINE)
    args = ('--vary', 'library', '--library', path, '--target-speed', 2)
    found = run_json(capsys, *args)['aim']
    assert found['layer'] == 'jelly'
    assert found['wave_speed'] == 22.6
    best = aim(Rig(), Target(speed=2.0), vary='both')
    assert best.amplitude <= found['amplitude'] < 1.0001 * best.amplitude
    assert run(capsys, *args).startswith('a layer of jelly, 41.')


def test_uncertainties_given_are_those_of_the_prediction(capsys):
    args = ('--target-speed', 2, '--vary', 'amplitude', '--uncertain-wave-speed', 1.0)
    printed = run_json(capsys, *args)
    uncertainty = prediction_uncertainty(
        with_amplitude(printed['aim']['amplitude']), Uncertainties(wave_speed=1.0)
    )
    assert printed['uncertainty'] == uncertainty.values()


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        (['--target-height', '-1'], r'argument --target-height: .* or 0, got -1\.0'),
        (['--target-height', 'high'], "argument --target-height: .* got 'high'"),
        (['--target-height', '0.1', '--target-speed', '2'],
         'argument --target-height: one of .* must be 0, got 0.1 and 2'),
        (['--target-height', '0'], 'either a height or a speed .* got neither'),
        (['--target-height', '0.1', '--gravity', '0'],
         'a height needs gravity, got gravity 0; aim at a speed instead'),
        (['--max-amplitude', '1'], r'argument --max-amplitude: .* to 0.1 m, got 1\.0'),
        (['--vary', 'colour'], "argument --vary: .* got 'colour'"),
        (['--objective', 'peak'], 'unrecognized arguments: --objective peak'),
        (['--motion', 'measured'], "argument --motion: .* 'harmonic', got 'measured'; what is"),
        (['--frequency', '3', '--amplitude', '1e-5', '--vary', 'amplitude',
          '--max-amplitude', '1e-5', '--target-speed', '1'],
         'nothing is thrown within the limits, let alone 1 m/s'),
        (['--library', 'no.yaml'], 'argument --library: no.yaml: No such file'),
    ],
)  # fmt: skip
def test_what_is_refused_is_quoted(capsys, args, message):
    assert re.match(message, refused(capsys, *args))
