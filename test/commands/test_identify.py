# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `identify`."""

import contextlib
from dataclasses import replace
import io
import itertools
import json
import math
from pathlib import Path
import re

import bags
import numpy as np
import pytest
from reference.method_of_steps import follow
from soft_throw_ros.commands import identify, throw
from soft_throw_ros.configuration import files, TWIN
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Projectile, Rig
from soft_throw_ros.identification.fit_description import DEFAULT_FREE
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.identification.systematics import FLOORS
from soft_throw_ros.storage.cdr import JointStateEncoder
from soft_throw_ros.storage.message import Message

SAMPLE = Path(__file__).parents[1] / 'data' / 'synthetic_throw.csv'
COMMAND = (identify.main,)
MEASURED = ('--mass', 1.206e-3, '--thickness', 12e-3, '--diameter', 12e-3, '--density', 1000.0)
OF_SAMPLE = (SAMPLE, '--unit', 'mm', *MEASURED)
RIG = Rig(
    engine=Engine(frequency=58.0, damping_ratio=0.05, amplitude=1.8e-3),
    layer=Layer(thickness=12e-3, wave_speed=6.9),
)
"""Rig of the sample, according to its description."""

TRUTH = (58.0, 0.05, 1.8e-3, 6.9)
"""Its values of `DEFAULT_FREE`."""


@pytest.fixture(scope='module')
def sample(tmp_path_factory):
    """Return the JSON result of the identification of the sample, and its parameter file."""
    path = tmp_path_factory.mktemp('sample') / 'my_rig.yaml'
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert identify.main([*map(str, OF_SAMPLE), '--output', str(path), '--json']) == 0
    return json.loads(out.getvalue()), path


def value(result, name):
    """Return value and error of the only row of a quantity."""
    (row,) = (row for row in result['rows'] if row['name'] == name)
    return row['value'], row['error']


def found(result):
    """Return the names of the fitted parameters of the twin."""
    rows = (row for row in result['rows'] if row['error'] is not None)
    return [row['name'] for row in rows if row['name'] in TWIN.by_name]


def test_sample_gives_its_rig(sample):
    result, _ = sample
    assert found(result)[:4] == list(DEFAULT_FREE)
    for name, expected in zip(DEFAULT_FREE, TRUTH, strict=True):
        best, error = value(result, name)
        assert best == pytest.approx(expected, abs=3.5 * error)
        assert error < 0.06 * expected
    assert value(result, 'layer.thickness') == pytest.approx((12e-3, 1e-4), rel=0.05)
    assert value(result, 'layer.density') == (1000.0, None)
    assert (result['warnings'], result['assumed']) == ([], [])
    best, error = value(result, 'layer.wave_speed')
    assert error > FLOORS['layer.wave_speed'].of(best)
    assert value(result, 'layer.rest_wave_speed')[1] > error
    assert value(result, 'ejection.time')[1] > FLOORS['ejection.time'].size
    assert result['verdict']['is_good_enough']
    start = result['fit']['names'].index('start_time')
    assert result['fit']['values'][start] == pytest.approx(0.0124, abs=5e-5)


def test_written_file_suits_the_twin(sample):
    result, path = sample
    settings, text = files.read(path), path.read_text()
    for name in found(result):
        assert settings[name] == pytest.approx(value(result, name)[0], rel=1e-6)
    assert settings['layer.name'] == 'custom'
    uncertain = {name: math.sqrt(3.0) * value(result, name)[1] for name in found(result)}
    uncertain['projectile.mass'] /= settings['projectile.mass']
    # bounds of equally likely values with the same deviation
    for name in TWIN.names_in('uncertainty'):
        (bound,) = (b for n, b in uncertain.items() if n.endswith(name.partition('.')[2]))
        assert settings[name] == pytest.approx(bound, rel=1e-2)
    # Parameters that do not describe the rig are left out of the file
    assert not re.search(r'^\s*rate', text, re.MULTILINE)
    for row in result['rows']:  # with their standard errors
        assert (f'# {row["name"]} ' in text) is (row['name'] in TWIN.by_name)
    predicted = throw.predict(settings)['throw']
    assert predicted['energy_transfer'] == pytest.approx(
        value(result, 'ejection.energy_transfer')[0], rel=1e-4
    )


ASSUMED = ('layer.density', 'layer.diameter', 'projectile.mass')


def test_what_nobody_stated_is_assumed_also_from_the_written_file(command, tmp_path):
    args, output = (SAMPLE, '--unit', 'mm', '--one-camera'), tmp_path / 'rig.yaml'
    first, verdict, *table = command.run(
        *args, '--thickness', 12e-3, '--output', output
    ).splitlines()
    text = output.read_text()
    assert first.startswith('assumed')
    assert 'not good enough' in verdict
    for name in ASSUMED:
        assert name in first
        assert name in verdict
        (row,) = (line for line in table if line.startswith(name))
        assert row.endswith('assumed')
        assert '+-' not in row
        assert re.search(rf'^# {name} [^+]*, assumed$', text, re.MULTILINE)
        assert re.search(rf'^ +# {name}: .* # assumed$', text, re.MULTILINE)
        assert files.read(output)[name] == TWIN.defaults()[name]
    assert files.read(output)['uncertainty.mass'] == TWIN.defaults()['uncertainty.mass']
    again = command.json(*args, '--config', output)
    assert again['assumed'] == list(ASSUMED)
    assert not again['verdict']['is_good_enough']
    assert not set(ASSUMED) & set(found(again))


def test_fit_of_a_rig_that_does_not_throw_is_shown_and_written(command, tmp_path):
    engine = replace(RIG.engine, amplitude=0.5e-3)
    heavy = replace(RIG, engine=engine, projectile=Projectile(mass=0.05))
    time = np.arange(-0.0153, 0.0947, 5e-4)
    plate = Underdamped.of(engine).position(time)
    tracks = np.column_stack([time, plate, ThrowSimulator().follow(heavy, time).position])
    tracks[:, 1:] += 5e-6 * np.random.default_rng(2).normal(size=(time.size, 2))
    np.savetxt(path := tmp_path / 'heavy.csv', tracks, delimiter=',')
    args = (path, '--one-camera', *MEASURED, '--mass', 0.05)
    output, figure = tmp_path / 'rig.yaml', tmp_path / 'a.png'
    result = command.json(*args, '--output', output, '--figure', figure)
    assert figure.stat().st_size > 1000
    reason = 'does not leave the layer'
    for text in (command.err, output.read_text()):
        assert reason in text
    speed, error = value(result, 'layer.wave_speed')
    assert speed == pytest.approx(6.9, abs=4.0 * error)
    assert files.read(output)['layer.wave_speed'] == pytest.approx(speed)
    assert not any(row['name'].startswith('ejection') for row in result['rows'])
    assert any(reason in warning for warning in result['warnings'])
    assert not result['verdict']['is_good_enough']


# A track in mm, of which each case makes a file that some program or instrument writes
LINES = SAMPLE.read_text().splitlines()[3:]


def each(change):
    """Change the cells of all lines with numbers."""
    return [','.join(change(*map(float, row.split(',')))) for row in LINES[1:]]


def in_unit(time):
    return each(lambda t, *z: [f'{time * t:.9g}', *(f'{height:.6f}' for height in z)])


def with_height(column, height, *rows):
    """Return the lines with another height in some rows."""
    lines = [line.split(',') for line in LINES]
    for row in rows:
        lines[row][column] = height
    return [','.join(cells) for cells in lines]


STRANGERS = {  # lines, options, and a defect that is noted
    'Unix seconds': ([LINES[0], *each(
        lambda t, *z: [f'{1732768800 + t:.6f}', *map(str, z)])], (), ''),
    'milliseconds': (['t,plate,projectile', *in_unit(1e3)], ('--time-unit', 'ms'), ''),
    'milliseconds in a label': ([LINES[0].replace('[s]', '[ms]'), *in_unit(1e3)], (), ''),
    'micrometres': ([LINES[0].replace('[mm]', '[\N{GREEK SMALL LETTER MU}m]'), *each(
        lambda t, *z: [str(t), *(str(1e3 * height) for height in z)])], (), ''),
    'decimal commas': ([LINES[0], *each(
        lambda *row: [f'"{cell}"'.replace('.', ',') for cell in row])], (), ''),
    'another column': ([line + ',x' for line in LINES], (), 'not used: x'),
    'empty rows': ([*LINES, ',,', ',,'], (), ''),
    'not available': (with_height(2, 'NA', 150), (), ''),
    'lost samples': (with_height(2, '0.0', 150, 151, 152), (), 'stand still'),
    'outlier': (with_height(1, '4.0', 41), (), 'outlier'),
}


@pytest.mark.parametrize(('lines', 'options', 'note'), STRANGERS.values(), ids=STRANGERS.keys())
def test_files_of_strangers_are_read(command, write, sample, lines, options, note):
    result = command.json(write('\n'.join(lines)), '--unit', 'mm', *MEASURED, *options)
    for name in DEFAULT_FREE:
        best, error = value(sample[0], name)
        assert value(result, name) == pytest.approx((best, error), rel=0.2, abs=0.3 * error)
    outliers = [item['outliers'] for item in result['fit']['residuals']]
    notes = result['notes'] + ['outlier'] * sum(map(len, outliers))
    assert [note in item for item in notes] == [True] * bool(note)
    assert result['warnings'] == []


@pytest.mark.parametrize(
    ('lines', 'options', 'value'),
    [
        (['t,plate,projectile', *in_unit(1e3)], ('--unit', 'mm'), '--time-unit ms'),
        (['t,plate,projectile', *in_unit(5000.0)], ('--unit', 'mm'), 'their rate'),
        (['Format Version,1.23,Take Name,throw', ',,Marker', *LINES], (), 'must begin with #'),
        pytest.param(LINES[1:], ('--hold', 'layer.wave_speed'),
                     'is the unit of heights right (--unit)?', marks=pytest.mark.slow),
    ],
)
def test_another_unit_or_a_foreign_header_is_refused(command, write, lines, options, value):
    assert value in command.refused(write('\n'.join(lines)), *MEASURED, *options)


def test_options_and_file_describe_the_same_fit(command, write):
    path = write('prior: {projectile.mass: [0.0012, 1.2e-5]}', 'fit.yaml')
    args = (SAMPLE, '--unit', 'mm', *MEASURED[2:])
    by_file = command.json(*args, '--fit-file', path)
    for words in (('--mass', '0.0012+-1%'), ('-p', 'projectile.mass:=0.0012 +- 1 %')):
        by_option = command.json(*args, *words)
        assert found(by_file) == found(by_option)
        for name in found(by_file):
            assert value(by_file, name) == pytest.approx(value(by_option, name), rel=1e-6)
    assert by_file['assumed'] == []
    mass, error = value(by_file, 'projectile.mass')
    assert mass == pytest.approx(1.2e-3, rel=0.02)
    assert error <= 1.2e-5


def test_plate_alone_gives_the_engine_with_errors_of_the_stated_noise(command, write, tmp_path):
    rows, output = [line.rpartition(',')[0] for line in LINES[1:]], tmp_path / 'rig.yaml'
    args = (write('\n'.join(rows)), '--unit', 'mm')
    result = command.json(*args, '--output', output)
    stated = command.json(*args, '-p', 'measured.position_noise:=1e-4', '--config', output)
    assert found(result) == list(DEFAULT_FREE[:3])
    for name in DEFAULT_FREE[:3]:
        assert value(stated, name)[1] > 1.5 * value(result, name)[1]
    assert value(result, 'engine.frequency')[0] == pytest.approx(58.0, rel=5e-3)
    assert files.read(output)['engine.frequency'] == pytest.approx(58.0, rel=5e-3)
    assert stated['assumed'] == result['assumed']


def joint_states(topic, times, heights, bodies=('plate', 'projectile')):
    """Yield messages with the heights of bodies, without those that are not seen."""
    channel = bags.channel(topic, 'sensor_msgs/msg/JointState')
    for time, both in zip(times, np.transpose(heights).tolist(), strict=True):
        seen = {body: z for body, z in zip(bodies, both, strict=True) if not math.isnan(z)}
        stamp = bags.BEGIN + round(1e9 * time)
        encoder = JointStateEncoder('camera', tuple(seen), series=1)
        yield Message(channel, encoder.encode(stamp, list(seen.values())), stamp, stamp)


def recorded(starts, noise=2e-5, rest=0.6):
    """Return times and heights of a record in which the rig returns to rest after every throw."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, starts[-1] + rest, 5e-4)
    heights = np.tile([[0.0], [RIG.rest_height]], time.size)
    history = follow(RIG, until=0.25)
    for start in starts:
        since = time - start
        thrown = (since > 0.0) & (since < 0.25)
        heights[0, thrown] = Underdamped.of(RIG.engine).position(since[thrown])
        heights[1, thrown] = history.projectile_position(since[thrown])
    return time, heights + noise * rng.normal(size=heights.shape)


def test_bag_gives_its_throws(command, tmp_path):
    time, heights = recorded(starts=(0.2, 0.6), rest=0.1)
    heights[1, heights[1] > 0.04] = np.nan  # above the field of view of the camera
    folder = bags.write(tmp_path / 'bag', joint_states('/rig/joint_states', time, heights))
    result = command.json(folder, '--thickness', 12e-3)
    assert result['sources'] == ['bag, throw 1', 'bag, throw 2']
    fit = dict(zip(result['fit']['names'], result['fit']['values'], strict=True))
    starts = [fit['start_time[1]'], fit['start_time[2]']]
    assert starts == pytest.approx([0.2, 0.6], abs=1e-4)
    speed, error = value(result, 'layer.wave_speed')
    assert speed == pytest.approx(6.9, abs=4.0 * error)
    assert error < 0.5


@pytest.mark.slow
def test_last_throw_in_the_bag_of_an_exact_twin_gives_its_rig(command, tmp_path):
    # No noise and few samples per period: the flight is the smoothest phase
    time, heights = recorded(starts=(0.2, 0.8, 1.4), noise=0.0)
    messages = joint_states('/twin/joint_states', time[::2], heights[:, ::2])
    path = bags.write(tmp_path / 'bag', messages) / 'bag_0.mcap'
    last = command.json(path, '--thickness', 12e-3, '--from', 1.2)
    for name, expected in zip(DEFAULT_FREE, TRUTH, strict=True):
        result, error = value(last, name)
        # One throw hardly distinguishes wave speed and thickness
        slack = 0.05 * error if name == 'layer.wave_speed' else 0.0
        assert result == pytest.approx(expected, rel=1e-4, abs=slack)


def test_measured_rig_is_the_default_among_several(command, tmp_path, write):
    time, heights = recorded(starts=(0.2,), rest=0.1)
    topics = (
        joint_states('/a/joint_states', time, heights),
        joint_states('/b/joint_states', time, 0.5 * heights, bodies=('plate', 'other')),
        joint_states('/c/joint_states', time, heights, bodies=('arm', 'hand')),
    )
    folder = bags.write(tmp_path / 'bag', itertools.chain(*topics))
    message = command.refused(folder)
    assert message.startswith(f'{folder}: ')
    assert '/a/joint_states, /b/joint_states (`topic` of --fit-file)' in message
    result = command.json(folder, '--fit-file', write('topic: /b/joint_states', 'b.yaml'))
    assert value(result, 'engine.amplitude')[0] == pytest.approx(0.9e-3, rel=0.02)
    other = write('topic: /c/joint_states', 'c.yaml')
    assert '/c/joint_states' in command.refused(folder, '--fit-file', other)
    topics = (
        joint_states('/twin/joint_states', time, 2.0 * heights),
        joint_states('/twin/measured_joint_states', time, heights, bodies=('plate', 'other')),
    )
    result = command.json(bags.write(tmp_path / 'measured', itertools.chain(*topics)))
    assert value(result, 'engine.amplitude')[0] == pytest.approx(1.8e-3, rel=0.02)


def test_unreadable_messages_of_a_bag_are_reported_and_a_cut_bag_is_refused(command, tmp_path):
    time, heights = recorded(starts=(0.2,), rest=0.1)
    messages = list(joint_states('/rig/joint_states', time, heights, bodies=('plate', 'other')))
    unreadable = b'\0\1\0\0' + bytes(range(40))
    messages += [messages[0]._replace(data=unreadable)] * 3
    (path,) = bags.write(tmp_path / 'bag', messages).glob('*.mcap')
    result = command.json(path)
    assert value(result, 'engine.amplitude')[0] == pytest.approx(1.8e-3, rel=0.02)
    (note,) = result['notes']
    assert command.err == f'identify: {note}\n'
    for part in (str(path), '3 messages', '/rig/joint_states', 'sensor_msgs/msg/JointState'):
        assert part in note
    path.write_bytes(path.read_bytes()[:-300])
    assert 'soft-throw recover' in command.refused(path)
