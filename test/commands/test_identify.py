# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The command `identify`."""

import contextlib
import io
import json
from pathlib import Path
import re

import numpy as np
import pytest
from reference.method_of_steps import follow
from soft_throw_ros.commands import identify, throw
from soft_throw_ros.configuration import files, rig_of
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Rig
from soft_throw_ros.identification.fit_description import USUAL
from soft_throw_ros.identification.forward import ThrowSimulator
from soft_throw_ros.recording.bag_writer import BagWriter
from soft_throw_ros.recording.cdr import JointStateEncoder
from soft_throw_ros.recording.message import Channel, Message

SAMPLE = Path(__file__).parents[1] / 'data' / 'synthetic_throw.csv'
COMMAND = (identify.main,)
OF_SAMPLE = (SAMPLE, '--unit', 'mm', '--thickness', 12e-3)
RIG = Rig(
    engine=Engine(frequency=58.0, damping_ratio=0.05, amplitude=1.8e-3),
    layer=Layer(thickness=12e-3, wave_speed=6.9),
)
"""What the sample says that it is of."""


@pytest.fixture(scope='module')
def found_in_sample():
    """Give what is found in the sample, as JSON."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert identify.main([*map(str, OF_SAMPLE), '--json']) == 0
    return json.loads(out.getvalue())


def value(found, name):
    return found['found'][name]['value'], found['found'][name]['error']


def test_sample_gives_its_rig(found_in_sample):
    found, truth = found_in_sample, (58.0, 0.05, 1.8e-3, 6.9)
    assert list(found['found'])[:4] == list(USUAL)
    for name, expected in zip(USUAL, truth, strict=True):
        best, error = value(found, name)
        assert best == pytest.approx(expected, abs=3.5 * error)
        assert error < 0.05 * expected
    assert value(found, 'layer.thickness') == pytest.approx((12e-3, 1e-4), rel=0.05)
    assert found['held']['layer.density'] == 1000.0
    assert found['warnings'] == []
    place = found['fit']['names'].index('layer.wave_speed')
    covariance = np.array(found['fit']['covariance'])
    assert np.sqrt(covariance[place, place]) == value(found, 'layer.wave_speed')[1]
    assert found['throws'][0]['start_time'] == pytest.approx(0.0124, abs=5e-5)
    averaged = found['throws'][0]['running_averages']
    for name, exact in found['ejection'].items():
        assert averaged[name]['value'] == pytest.approx(
            exact['value'], abs=3.0 * averaged[name]['error']
        )


def test_readme_shows_what_is_printed_of_the_sample_and_the_file_is_one_of_the_twin(
    command, found_in_sample, tmp_path, monkeypatch
):
    pytest.importorskip('matplotlib')
    root = SAMPLE.parents[2]
    text = (root / 'README.md').read_text(encoding='utf-8')
    (call,) = re.findall(r"make identify ARGS='(.*synthetic_throw.*)'", text)
    monkeypatch.chdir(root)
    path = tmp_path / 'my_rig.yaml'
    args = call.replace('my_rig.yaml', str(path)).split()
    printed = command.run(*args, '--figure', tmp_path / 'a.png').splitlines()[:7]
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')
    shown = re.findall(r'^    ((?:engine|layer|projectile)\.\w+ +.* \+- .*)$', text, re.MULTILINE)
    # The last digits may depend on the processor
    for line, other in zip(printed, shown, strict=True):
        assert line.split()[0] == other.split()[0]
        assert float(line.split()[1]) == pytest.approx(float(other.split()[1]), rel=1e-3)
    found, settings = found_in_sample, files.read(path)
    for name in found['found']:
        assert settings[name] == pytest.approx(value(found, name)[0], rel=1e-6)
    assert settings['layer.name'] == 'custom'
    # What does not describe the rig stays as it was
    assert not re.search(r'^\s*rate', path.read_text(), re.MULTILINE)
    for line in printed:  # and says how sure it is
        assert f'# {line.split()[0]} {" ".join(line.split()[1:])}' in path.read_text()
    predicted = throw.predict(settings, ['travelling_wave'])['models']['travelling_wave']
    assert predicted['energy_transfer'] == pytest.approx(
        found['ejection']['energy_transfer']['value'], rel=1e-4
    )


def test_large_strain_is_said_and_written(command, write, tmp_path):
    engine = Engine(frequency=58.0, damping_ratio=0.05, amplitude=5e-3)
    rig = Rig(engine=engine, layer=Layer(elasticity='neo_hookean'))
    time = np.arange(0.0, 0.08, 2e-4)
    heights = np.stack([
        Underdamped.of(engine).position(time - 0.0153),
        ThrowSimulator().follow(rig, time - 0.0153).position,
    ])
    heights += 2e-5 * np.random.default_rng(2).normal(size=heights.shape)
    rows = [','.join(map(str, row)) for row in np.column_stack([time, *heights]).tolist()]
    path = write('\n'.join(['t,plate,projectile', *rows]))
    output = tmp_path / 'rig.yaml'
    printed = command.run(path, '--output', output)
    assert re.search(r'^layer.elasticity +neo_hookean$', printed, re.MULTILINE)
    assert rig_of(files.read(output)).layer.elasticity == 'neo_hookean'
    assert command.json(path, '--hold', 'layer.stiffening')['chosen'] == {}


def test_samples_that_are_3_mm_off_are_listed_and_left_out(command, write, found_in_sample):
    clean = found_in_sample
    lines = SAMPLE.read_text().splitlines()
    off = {}
    for column, body, row in ((1, 'plate', 44), (2, 'projectile', 4)):
        cells = lines[row].split(',')
        cells[column] = str(float(cells[column]) + 3.0)
        lines[row], off[body] = ','.join(cells), float(cells[0])
    path = write('\n'.join(lines))
    found = command.json(path, *OF_SAMPLE[1:])
    for residual in found['fit']['residuals']:
        (outlier,) = residual['outliers']
        assert outlier['time'] == off[residual['track']]
        assert outlier['deviation'] == pytest.approx(3e-3, abs=1e-4)
    for name in USUAL:
        best, error = value(clean, name)
        assert value(found, name)[0] == pytest.approx(best, abs=error)
    assert found['warnings'] == []
    printed = command.run(path, *OF_SAMPLE[1:])
    for body, time in off.items():
        assert f'left out as outliers of {body}: {time:g} s' in printed


def test_fit_is_described_alike_by_options_and_file(command, write):
    path = write('parameters: {projectile.mass: 0.0012 +- 1 %}\nheights: own', 'fit.yaml')
    by_file = command.json(*OF_SAMPLE, '--fit-file', path)
    by_option = command.json(*OF_SAMPLE, '--mass', '0.0012+-1%')
    assert by_file == by_option
    mass, error = value(by_file, 'projectile.mass')
    assert mass == pytest.approx(1.2e-3, rel=0.02)
    assert error <= 1.2e-5
    path.write_text('heights: [')
    assert command.refused(*OF_SAMPLE, '--fit-file', path).startswith(f'{path}:1: ')


def test_plate_alone_gives_the_engine(command, write, tmp_path):
    rows = [line.rpartition(',')[0] for line in SAMPLE.read_text().splitlines()[4:]]
    path, output = write('\n'.join(rows)), tmp_path / 'rig.yaml'
    found = command.json(path, '--unit', 'mm', '--output', output)
    assert list(found['found']) == list(USUAL[:3])
    assert value(found, 'engine.frequency')[0] == pytest.approx(58.0, rel=5e-3)
    assert found['ejection'] is None
    assert files.read(output)['engine.frequency'] == pytest.approx(58.0, rel=5e-3)
    assert 'layer.wave_speed cannot be found' in command.refused(
        path, '--unit', 'mm', '--fit', 'layer.wave_speed'
    )


def ringing(thickness, seed):
    """Text of a free layer's ends in mm."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 0.05, 2e-4)
    rings = np.exp(-30.0 * time) * np.cos(np.pi * 7.8 / thickness * time)
    noise = rng.normal(size=(2, time.size)) * 1e-5
    bottom, top = 0.1 + noise[0], 0.1 + thickness + 5e-4 * rings + noise[1]
    rows = zip(time, 1e3 * bottom, 1e3 * top, strict=True)
    return '\n'.join(['t;bottom;top', *(f'{t:.4f};{a:.4f};{b:.4f}' for t, a, b in rows)])


def test_free_layers_give_the_wave_speed(command, write, tmp_path):
    thicknesses = (5.6e-3, 16.8e-3, 29.1e-3)
    args = ['--unit', 'mm', '--output', tmp_path / 'rig.yaml', '--thickness-error', 2e-5]
    for thickness in thicknesses:
        path = write(ringing(thickness, seed=1), f'{thickness}.csv')
        args += ['--free-layer', thickness, path]
    found = command.json(*args, '--fit', 'layer.loss_tangent', '--figure', tmp_path / 'a.png')
    speed, error = value(found, 'layer.wave_speed')
    assert speed == pytest.approx(7.8, abs=4.0 * error)
    assert error < 0.03
    periods = [layer['period']['value'] for layer in found['layers']]
    assert periods == pytest.approx([2.0 * t / 7.8 for t in thicknesses], rel=5e-3)
    assert (tmp_path / 'a.png').stat().st_size > 10_000
    settings = files.read(tmp_path / 'rig.yaml')
    assert settings['layer.wave_speed'] == pytest.approx(speed, rel=1e-4)
    assert settings['layer.loss_tangent'] == pytest.approx(
        value(found, 'layer.loss_tangent')[0], rel=1e-2
    )
    rows = [line.split() for line in command.run(*args).splitlines() if ' mm ' in line]
    assert [float(row[2]) for row in rows] == pytest.approx(1e3 * np.array(periods), rel=1e-3)


def test_free_layers_of_two_materials_are_doubted(command, write):
    args = ['--unit', 'mm']
    for thickness, truth in ((10e-3, 10e-3), (20e-3, 24e-3)):
        args += ['--free-layer', thickness, write(ringing(truth, seed=2), f'{thickness}.csv')]
    command.run(*args)
    assert 'not proportional to the thicknesses' in command.err
    assert 'do not agree in their loss' in command.err  # for they decay alike, thick or thin


class Bag:
    """Writes messages JointState into a bag."""

    def __init__(self, folder):
        self.writer = BagWriter(folder, distribution='jazzy')

    def add(self, topic, times, plate, projectile, names=('plate', 'projectile')):
        """Write positions; of what is not seen there is none."""
        channel = Channel(topic=topic, type='sensor_msgs/msg/JointState', schema='float64 x')
        for time, *both in zip(times, plate, projectile, strict=True):
            stamp = 1_700_000_000_000_000_000 + round(1e9 * time)
            seen = {
                name: each for name, each in zip(names, both, strict=True) if not np.isnan(each)
            }
            encoder = JointStateEncoder('camera', tuple(seen), series=1)
            data = encoder.encode(stamp, list(seen.values()))
            self.writer.write(Message(channel, data, stamp, stamp))
        return self

    def close(self):
        self.writer.close()
        return self.writer.folder


def recorded(starts=(0.2, 0.8), noise=2e-5):
    """Make a record of throws, after each of which all is put back."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, starts[-1] + 0.6, 5e-4)
    heights = np.tile([[0.0], [12e-3 - RIG.static_sag]], time.size)
    history = follow(RIG, until=0.25)
    for start in starts:
        since = time - start
        thrown = (since > 0.0) & (since < 0.25)
        heights[0, thrown] = Underdamped.of(RIG.engine).position(since[thrown])
        heights[1, thrown] = history.projectile_position(since[thrown])
    return time, heights + noise * rng.normal(size=heights.shape)


def test_bag_gives_its_throws(command, tmp_path):
    time, (plate, projectile) = recorded()
    folder = Bag(tmp_path / 'bag').add('/rig/joint_states', time, plate, projectile).close()
    found = command.json(folder, '--thickness', 12e-3)
    assert [each['name'] for each in found['throws']] == ['bag, throw 1', 'bag, throw 2']
    assert [each['start_time'] for each in found['throws']] == pytest.approx([0.2, 0.8], abs=1e-4)
    speed, error = value(found, 'layer.wave_speed')
    assert speed == pytest.approx(6.9, abs=4.0 * error)
    assert error < 0.35


def test_of_several_rigs_the_measured_one_comes_first_and_others_are_asked_for(command, tmp_path):
    time, (plate, projectile) = recorded(starts=(0.2,))
    bag = Bag(tmp_path / 'bag')
    bag.add('/a/joint_states', time, plate, projectile)
    bag.add('/b/joint_states', time, 0.5 * plate, projectile, names=('plate', 'other'))
    bag.add('/c/joint_states', time, plate, projectile, names=('arm', 'hand'))
    folder = bag.close()
    message = command.refused(folder)
    assert message.startswith(f'{folder}: ')
    assert '/a/joint_states, /b/joint_states (choose with --topic)' in message
    found = command.json(folder, '--topic', '/b/joint_states')
    assert value(found, 'engine.amplitude')[0] == pytest.approx(0.9e-3, rel=0.02)
    assert '/c/joint_states' in command.refused(folder, '--topic', '/c/joint_states')
    bag = Bag(tmp_path / 'measured')
    bag.add('/twin/joint_states', time, 2.0 * plate, projectile)
    bag.add('/twin/measured_joint_states', time, plate, projectile, names=('plate', 'other'))
    found = command.json(bag.close())
    assert value(found, 'engine.amplitude')[0] == pytest.approx(1.8e-3, rel=0.02)


def test_bag_of_an_exact_twin_gives_its_rig(command, tmp_path):
    # Without noise, and with few samples per period, in which the flight is the smoothest part
    time, (plate, projectile) = recorded(starts=(0.2, 0.8, 1.4), noise=0.0)
    every = slice(None, None, 2)
    folder = Bag(tmp_path / 'bag').add(
        '/twin/joint_states', time[every], plate[every], projectile[every]
    ).close()
    printed = command.run(folder, '--thickness', 12e-3)
    assert command.err == ''
    assert 'no running averages: bag, throw 1: running averages need at least 20' in printed
    last = command.json(next(folder.glob('*.mcap')), '--thickness', 12e-3, '--from', 1.2)
    assert last['sources'] == ['bag_0.mcap']
    for name, expected in zip(USUAL, (58.0, 0.05, 1.8e-3, 6.9), strict=True):
        found, error = value(last, name)
        # One throw hardly tells wave speed, thickness and stiffening apart
        slack = 0.05 * error if name == 'layer.wave_speed' else 0.0
        assert found == pytest.approx(expected, rel=1e-4, abs=slack)


def test_what_cannot_be_read_of_a_bag_is_said(command, tmp_path):
    time, (plate, projectile) = recorded(starts=(0.2,))
    names = ('plate', 'other')
    bag = Bag(tmp_path / 'bag').add('/rig/joint_states', time, plate, projectile, names=names)
    channel = Channel(
        topic='/rig/joint_states', type='sensor_msgs/msg/JointState', schema='float64 x'
    )
    for stamp in range(3):
        bag.writer.write(Message(channel, b'\0\1\0\0' + bytes(range(40)), stamp, stamp))
    (path,) = bag.close().glob('*.mcap')
    left_out = (
        f"identify: {path}: 3 messages on '/rig/joint_states' are no sensor_msgs/msg/JointState, "
        'and left out\n'
    )
    assert value(command.json(path), 'engine.amplitude')[0] == pytest.approx(1.8e-3, rel=0.02)
    assert command.err == left_out
    path.write_bytes(path.read_bytes()[:-300])
    assert value(command.json(path), 'engine.amplitude')[0] == pytest.approx(1.8e-3, rel=0.02)
    damage, *rest = command.err.splitlines(keepends=True)
    assert damage.startswith(f'identify: {path}: ')
    assert 'what can be read is taken' in damage
    assert rest == [left_out]


def test_throw_of_a_bag_that_is_none_is_left_out(command, tmp_path):
    time, (plate, projectile) = recorded(starts=(0.2, 0.8, 1.4))
    plate[(time > 0.8) & (time < 0.83)] = 1.5e-3
    plate[(time > 0.83) & (time < 1.4)] = 0.0
    folder = Bag(tmp_path / 'bag').add('/rig/joint_states', time, plate, projectile).close()
    found = command.json(folder, '--thickness', 12e-3)
    assert found['sources'] == ['bag, throw 1', 'bag, throw 3']
    assert command.err.startswith('identify: bag, throw 2 is left out: the plate goes down')


@pytest.mark.parametrize(
    ('start', 'noise'),
    [(-0.002, 2e-5), (0.015, 4e-4)],
    ids=['never at rest', 'hardly to be seen'],
)
def test_throw_that_looks_like_several_is_one(command, write, start, noise):
    time = np.arange(0.0, 0.1, 2e-4)
    plate = Underdamped.of(RIG.engine).position(time - start)
    projectile = follow(RIG, until=time[-1] - start).projectile_position(time - start)
    seen = np.stack([plate, projectile]) + noise * np.random.default_rng(2).normal(
        size=(2, time.size)
    )
    lines = [f'{t:.4f},{low:.7f},{high:.7f}' for t, low, high in zip(time, *seen, strict=True)]
    found = command.json(write('\n'.join(lines)), '--thickness', 12e-3)
    assert found['sources'] == ['file']
    for name, truth in zip(USUAL, (58.0, 0.05, 1.8e-3, 6.9), strict=True):
        best, error = value(found, name)
        assert best == pytest.approx(truth, abs=4.0 * error)


def test_projectile_that_is_not_seen_is_left_out(command, tmp_path):
    time, (plate, projectile) = recorded(starts=(0.2,))
    projectile[projectile > 0.04] = np.nan  # beyond what the camera sees
    projectile[50:60] = np.nan
    found = command.json(
        Bag(tmp_path / 'bag').add('/twin/measured_joint_states', time, plate, projectile).close(),
        '--thickness',
        12e-3,
    )
    samples = {each['track']: each['samples'] for each in found['fit']['residuals']}
    assert samples['projectile'] < samples['plate']
    speed, error = value(found, 'layer.wave_speed')
    assert speed == pytest.approx(6.9, abs=4.0 * error)


THICKNESS = 'layer.thickness'


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        ((), 'either FILE or --video, or --free-layer must be given'),
        ((SAMPLE, '--free-layer', '0.01', SAMPLE), 'either FILE or --video, or --free-layer'),
        (('none.csv',), 'none.csv: No such file or directory'),
        ((SAMPLE,), f"{SAMPLE}:4: plate is read in m, got 'plate [mm]'; see --unit mm"),
        ((SAMPLE, '--noise', '0'), 'argument --noise: must be finite and positive, got 0'),
        ((SAMPLE, '--fit', 'layer.colour'), 'argument --fit: what is fitted must be some of '),
        ((SAMPLE, '--fit', THICKNESS, '--hold', THICKNESS), f'argument --hold: {THICKNESS}'),
        ((SAMPLE, '--thickness', '7'), f'argument --thickness: {THICKNESS} must be a number from'),
        (('--free-layer', 'x', SAMPLE), 'argument --free-layer: M must be a number from 0.0005'),
        (('--free-layer', '1e-2', SAMPLE, '--thickness-error', '-1'), 'argument --thickness-e'),
        (('--free-layer', '1e-2', SAMPLE), f"{SAMPLE}:4: no column is named 'bottom', got t [s]"),
        ((*OF_SAMPLE, '--from', '0.025'), f'{SAMPLE.name}: the plate does not move as a damped'),
        ((*OF_SAMPLE, '--mass', '0.0012+-0%'), 'argument --mass: projectile.mass must have an'),
        ((*OF_SAMPLE, '--from', '1'), f'{SAMPLE.name}: only 0 samples from 1 s to inf s'),
        ((*OF_SAMPLE, '--output', 'none/rig.yaml'), 'argument --output: none/rig.yaml: there'),
        ((*OF_SAMPLE, '--figure', 'a.gif'), 'argument --figure: must end on .png, .pdf, .svg'),
    ],
)
def test_what_is_wrong_is_said_in_one_line(command, args, message):
    assert command.refused(*args).startswith(message)


def test_wrong_unit_without_a_header_is_noticed(command, write):
    rows = [line for line in SAMPLE.read_text().splitlines() if line[0].isdigit()]
    message = command.refused(write('\n'.join(rows)), '--hold', 'layer.wave_speed')
    assert message.startswith('found, but not for the twin: engine.amplitude must be a number')
    assert message.endswith('is the unit of heights right (--unit)?')
