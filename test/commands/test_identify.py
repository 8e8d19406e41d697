# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `identify`."""

import contextlib
from dataclasses import replace
import io
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
from soft_throw_ros.identification.rig_model import ThrowSimulator
from soft_throw_ros.identification.systematics import FLOORS
from soft_throw_ros.storage.cdr import JointStateEncoder
from soft_throw_ros.storage.message import Message

SAMPLE = Path(__file__).parents[1] / 'data' / 'synthetic_throw.csv'
COMMAND = (identify.main,)
BODIES = ('plate', 'projectile')
MEASURED = ('--mass', 1.206e-3, '--thickness', 12e-3, '--diameter', 12e-3, '--density', 1000.0)
OF_SAMPLE = (SAMPLE, '--unit', 'mm', *MEASURED)
RIG = Rig(  # of the sample, according to its description
    engine=Engine(frequency=58.0, damping_ratio=0.05, amplitude=1.8e-3),
    layer=Layer(thickness=12e-3, wave_speed=6.9),
)
TRUTH = (58.0, 0.05, 1.8e-3, 6.9)  # its values of `DEFAULT_FREE`


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


def test_sample_gives_its_rig_and_a_file_that_suits_the_twin(sample):
    result, path = sample
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
    settings, text = files.read(path), path.read_text()
    for name in found(result):
        assert settings[name] == pytest.approx(value(result, name)[0], rel=1e-6)
    assert settings['layer.name'] == 'custom'
    # Bounds of equally likely values with the same deviation
    bounds = {name: math.sqrt(3.0) * value(result, name)[1] for name in found(result)}
    bounds['projectile.mass'] /= settings['projectile.mass']
    for name in TWIN.names_in('uncertainty'):
        (bound,) = (b for n, b in bounds.items() if n.endswith(name.partition('.')[2]))
        assert settings[name] == pytest.approx(bound, rel=1e-2)
    # Parameters that do not describe the rig are left out; the others have their errors
    assert not re.search(r'^\s*rate', text, re.MULTILINE)
    for row in result['rows']:
        assert (f'# {row["name"]} ' in text) is (row['name'] in TWIN.by_name)
    predicted = throw.predict(settings)['throw']['energy_transfer']
    assert predicted == pytest.approx(value(result, 'ejection.energy_transfer')[0], rel=1e-4)


ASSUMED = ('layer.density', 'layer.diameter', 'projectile.mass')


def test_what_nobody_stated_is_assumed_also_from_the_written_file(command, tmp_path):
    args, output = (SAMPLE, '--unit', 'mm', '--one-camera'), tmp_path / 'rig.yaml'
    printed = command.run(*args, '--thickness', 12e-3, '--output', output)
    first, verdict, *table = printed.splitlines()
    assert first.startswith('assumed')
    assert 'not good enough' in verdict
    for name in ASSUMED:
        assert name in first
        assert name in verdict
        (row,) = (line for line in table if line.startswith(name))
        assert re.fullmatch('[^+]* assumed', row)
        for pattern in (rf'^# {name} [^+]*, assumed$', rf'^ +# {name}: .* # assumed$'):
            assert re.search(pattern, output.read_text(), re.MULTILINE)
    for name in (*ASSUMED, 'uncertainty.mass'):
        assert files.read(output)[name] == TWIN.defaults()[name]
    again = command.json(*args, '--config', output)
    assert again['assumed'] == list(ASSUMED)
    assert not again['verdict']['is_good_enough']
    assert not set(ASSUMED) & set(found(again))


def test_fit_of_a_rig_that_does_not_throw_is_shown_and_written(command, tmp_path):
    engine = replace(RIG.engine, amplitude=0.5e-3)
    heavy = replace(RIG, engine=engine, projectile=Projectile(mass=0.05))
    time = np.arange(-0.0153, 0.0947, 5e-4)
    plate = Underdamped.of(engine).position(time)
    tracks = np.column_stack([time, plate, ThrowSimulator().follow(heavy, time).height])
    tracks[:, 1:] += 5e-6 * np.random.default_rng(2).normal(size=(time.size, 2))
    np.savetxt(path := tmp_path / 'heavy.csv', tracks, delimiter=',')
    output, figure = tmp_path / 'rig.yaml', tmp_path / 'a.png'
    args = ('--one-camera', *MEASURED, '--mass', 0.05, '--output', output, '--figure', figure)
    result = command.json(path, *args)
    assert figure.stat().st_size > 1000
    for text in (command.err, output.read_text(), ' '.join(result['warnings'])):
        assert 'does not leave the layer' in text
    speed, error = value(result, 'layer.wave_speed')
    assert speed == pytest.approx(6.9, abs=4.0 * error)
    assert files.read(output)['layer.wave_speed'] == pytest.approx(speed)
    assert not any(row['name'].startswith('ejection') for row in result['rows'])
    assert not result['verdict']['is_good_enough']


# A track in mm, of which each case makes a file that some program or instrument writes
LINES = SAMPLE.read_text().splitlines()[3:]
HEAD, TABLE = LINES[0], np.loadtxt(LINES[1:], delimiter=',')


def lines_of(head=HEAD, *, time=1.0, start=0.0):
    """Return the lines of a file with another unit of time and another start."""
    rows = (TABLE * [time, 1.0, 1.0] + [start, 0.0, 0.0]).tolist()
    return [head, *(','.join(f'{value:.16g}' for value in row) for row in rows)]


def with_height(column, height, *rows):
    """Return the lines with another height in some rows."""
    lines = [line.split(',') for line in LINES]
    for row in rows:
        lines[row][column] = height
    return [','.join(cells) for cells in lines]


STRANGERS = {  # lines, options, and a noted defect; `test_csv_rows` has other notations
    'Unix seconds': (lines_of(start=1732768800.0), (), ''),
    'milliseconds': (lines_of('t,plate,projectile', time=1e3), ('--time-unit', 'ms'), ''),
    'another column': ([line + ',x' for line in LINES], (), 'not used: x'),
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


@pytest.mark.parametrize(('lines', 'options', 'value'), [
    (lines_of('t,plate,projectile', time=1e3), ('--unit', 'mm'), '--time-unit ms'),
    (lines_of('t,plate,projectile', time=5e3), ('--unit', 'mm'), 'their rate'),
    (['Format Version,1.23,Take Name,throw', ',,Marker', *LINES], (), 'must begin with #'),
    pytest.param(LINES[1:], ('--hold', 'layer.wave_speed'),
                 'is the unit of heights right (--unit)?', marks=pytest.mark.slow),
])
def test_another_unit_or_a_foreign_header_is_refused(command, write, lines, options, value):
    assert value in command.refused(write('\n'.join(lines)), *MEASURED, *options)


def test_options_and_file_describe_the_same_fit(command, write):
    file = write('prior: {projectile.mass: [0.0012, 1.2e-5]}', 'fit.yaml')
    options = ('--mass', '0.0012+-1%'), ('-p', 'projectile.mass:=0.0012 +- 1 %')
    by_file, *by_options = (
        command.json(SAMPLE, '--unit', 'mm', *MEASURED[2:], *words)
        for words in (('--fit-file', file), *options)
    )
    for result in by_options:
        assert found(result) == found(by_file)
        for name in found(by_file):
            assert value(result, name) == pytest.approx(value(by_file, name), rel=1e-6)
    mass, error = value(by_file, 'projectile.mass')
    assert (mass, by_file['assumed']) == (pytest.approx(1.2e-3, rel=0.02), [])
    assert error <= 1.2e-5


def test_plate_alone_gives_the_engine_with_errors_of_the_stated_noise(command, write, tmp_path):
    output = tmp_path / 'rig.yaml'
    args = (write('\n'.join(line.rpartition(',')[0] for line in LINES)), '--unit', 'mm')
    result = command.json(*args, '--output', output)
    stated = command.json(*args, '-p', 'measured.position_noise:=1e-4', '--config', output)
    assert found(result) == list(DEFAULT_FREE[:3])
    for name in DEFAULT_FREE[:3]:
        assert value(stated, name)[1] > 1.5 * value(result, name)[1]
    for frequency in (value(result, DEFAULT_FREE[0])[0], files.read(output)[DEFAULT_FREE[0]]):
        assert frequency == pytest.approx(58.0, rel=5e-3)
    assert stated['assumed'] == result['assumed']


def write_bag(path, *topics, extra=()):
    """Write a bag with the heights of bodies, without those that are not seen."""
    messages = list(extra)
    for topic, times, heights, *bodies in topics:
        channel = bags.channel(topic, 'sensor_msgs/msg/JointState')
        for time, both in zip(times, np.transpose(heights).tolist(), strict=True):
            seen = {n: z for n, z in zip(bodies or BODIES, both, strict=True) if not math.isnan(z)}
            stamp = bags.BEGIN + round(1e9 * time)
            data = JointStateEncoder('', tuple(seen), series=1).encode(stamp, list(seen.values()))
            messages.append(Message(channel, data, stamp, stamp))
    return bags.write(path, messages)


def recorded(*starts, noise=2e-5):
    """Return times and heights of a record in which the rig returns to rest after every throw."""
    time = np.arange(0.0, starts[-1] + 0.1, 5e-4)
    heights, history = np.empty((2, time.size)), follow(RIG, until=0.25)
    heights[:] = [[0.0], [RIG.rest_height]]
    for start in starts:
        since = time - start
        thrown = (since > 0.0) & (since < 0.25)
        heights[0, thrown] = Underdamped.of(RIG.engine).position(since[thrown])
        heights[1, thrown] = history.projectile_position(since[thrown])
    return time, heights + noise * np.random.default_rng(3).normal(size=heights.shape)


@pytest.mark.parametrize('noise', [2e-5, pytest.param(0.0, marks=pytest.mark.slow)])
def test_bag_gives_its_throws(command, tmp_path, noise):
    time, heights = recorded(0.2, 0.6, noise=noise)
    heights[1, heights[1] > 0.04] = np.nan  # above the field of view of the camera
    folder = write_bag(tmp_path / 'bag', ('/rig/joint_states', time, heights))
    result = command.json(folder, '--thickness', 12e-3)
    assert result['sources'] == ['bag, throw 1', 'bag, throw 2']
    fit = dict(zip(result['fit']['names'], result['fit']['values'], strict=True))
    assert [fit['start_time[1]'], fit['start_time[2]']] == pytest.approx([0.2, 0.6], abs=1e-4)
    speed, error = value(result, 'layer.wave_speed')
    assert speed == pytest.approx(6.9, abs=4.0 * error)
    assert error < 0.5


def test_topic_must_be_chosen_among_several(command, tmp_path, write):
    time, heights = recorded(0.2)
    folder = write_bag(
        tmp_path / 'bag', ('/a/joint_states', time, heights),
        ('/b/joint_states', time, 0.5 * heights, 'plate', 'other'),
        ('/c/joint_states', time, heights, 'arm', 'hand'),
    )
    for words in ((), ('--fit-file', write('topic: /c/joint_states', 'c.yaml'))):
        message = f'{folder}: .*/a/joint_states, /b/joint_states .`topic` of --fit-file'
        assert re.match(message, command.refused(folder, *words))
    chosen = command.json(folder, '--fit-file', write('topic: /b/joint_states', 'b.yaml'))
    assert value(chosen, 'engine.amplitude')[0] == pytest.approx(0.9e-3, rel=0.02)


def test_measured_rig_is_preferred_without_unreadable_messages(command, tmp_path):
    (time, heights), topic = recorded(0.2), '/twin/measured_joint_states'
    channel = bags.channel(topic, 'sensor_msgs/msg/JointState')
    unreadable = Message(channel, b'\0\1\0\0' + bytes(range(40)), bags.BEGIN, bags.BEGIN)
    path = write_bag(
        tmp_path / 'bag', ('/twin/joint_states', time, 2.0 * heights),
        (topic, time, heights, 'plate', 'other'), extra=[unreadable] * 3,
    ) / 'bag_0.mcap'
    result = command.json(path)
    assert value(result, 'engine.amplitude')[0] == pytest.approx(1.8e-3, rel=0.02)
    (note,) = result['notes']
    assert command.err == f'identify: {note}\n'
    for part in (str(path), '3 messages', topic, 'sensor_msgs/msg/JointState'):
        assert part in note
    path.write_bytes(path.read_bytes()[:-300])
    assert 'soft-throw recover' in command.refused(path)
