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
"""The command `identify` with videos, rendered from throws and layers whose truth is known."""

from pathlib import Path
import re
import runpy

import numpy as np
import pytest
from reference.method_of_steps import follow
from soft_throw_ros.commands import identify
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Rig

av = pytest.importorskip('av', reason='comes with the extra [video]')
imageio = pytest.importorskip('imageio.v3', reason='comes with the extra [video]')
pytest.importorskip('skimage', reason='comes with the extra [video]')
COMMAND = (identify.main,)
CAMERA = runpy.run_path(str(Path(__file__).parents[1] / 'identification/rendering.py'))
RIG = Rig(
    engine=Engine(frequency=58.0, damping_ratio=0.05, amplitude=1.8e-3),
    layer=Layer(thickness=12e-3, wave_speed=6.9),
)
START = 0.0082
RATE = 4000.0
PIXEL = 1e-4
"""Ten pixels per millimetre, as in the pictures of a high-speed camera of 50 mm height. [m]"""

AS_TAKEN = ('--rate', RATE, '--scale', 12e-3, 120)
PERIOD = 2.0 * 8e-3 / 7.8


def write_video(path, pictures):
    """Write pictures into a video without loss, as a camera's software may."""
    with av.open(str(path), 'w') as container:
        stream = container.add_stream('ffv1', rate=25)
        stream.height, stream.width = pictures[0].shape
        stream.pix_fmt = 'gray'
        for picture in [*pictures, None]:
            frame = None if picture is None else av.VideoFrame.from_ndarray(picture, format='gray')
            container.mux(stream.encode(frame))
    return path


@pytest.fixture(scope='session')
def throw_pictures():
    """Take pictures of a throw; the projectile leaves them at the top."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 0.045, 1.0 / RATE) - START
    plate = Underdamped.of(RIG.engine).position(time)
    projectile = follow(RIG, until=time[-1]).projectile_position(time)
    return [
        CAMERA['picture'](
            (330, 44),
            [
                (315.3 - low / PIXEL, 21.7),
                (300.2 - 0.5 * (low + high) / PIXEL, 22.4),
                (270.1 - high / PIXEL, 22.1),
            ],
            rng,
        )
        for low, high in zip(plate, projectile, strict=True)
    ]


@pytest.fixture(scope='session')
def throw_video(throw_pictures, tmp_path_factory):
    return write_video(tmp_path_factory.mktemp('video') / 'throw.avi', throw_pictures)


@pytest.fixture(scope='session')
def layer_video(tmp_path_factory):
    """Take pictures of a bright layer that rings, with spots at its ends."""
    rng = np.random.default_rng(5)
    shape = (110, 40)
    time = np.arange(0.0, 0.03, 1.0 / RATE)
    change = 6.0 * np.exp(-50.0 * time) * np.cos(2.0 * np.pi * time / PERIOD)
    pictures = []
    for more in change:
        levels = 40.0 + 150.0 * CAMERA['band'](shape, 95.2, 15.2 - more)
        for row, column in ((87.4, 12.3), (24.7 - more, 12.1)):
            levels = levels - 110.0 * CAMERA['disc'](shape, row, column)
        pictures.append(CAMERA['exposed'](levels, rng))
    return write_video(tmp_path_factory.mktemp('video') / 'ring.avi', pictures)


# What is known of the layer: how thick it is, and that it does not stiffen.
KNOWN = ('--thickness', 12e-3, '--hold', 'layer.stiffening')


def assert_is_the_rig(found):
    truth = {
        'engine.frequency': (58.0, 2e-3),
        'engine.damping_ratio': (0.05, 2e-3),
        'engine.amplitude': (1.8e-3, 2e-3),
        'layer.wave_speed': (6.9, 3e-2),  # in it is what is not known of the layer's size
    }
    for name, (expected, most) in truth.items():
        value, error = found['found'][name]['value'], found['found'][name]['error']
        assert value == pytest.approx(expected, abs=4.0 * error)
        assert error < most * expected
    assert found['warnings'] == []


def test_video_gives_the_rig_that_was_filmed(command, throw_video, tmp_path):
    tracks = tmp_path / 'tracks.csv'
    found = command.json('--video', throw_video, *AS_TAKEN, *KNOWN, '--tracks', tracks)
    assert_is_the_rig(found)
    samples = {each['track']: each['samples'] for each in found['fit']['residuals']}
    assert samples['plate'] == 180
    assert 100 < samples['projectile'] < 180
    assert all(each['rms'] < 0.03 * PIXEL for each in found['fit']['residuals'])
    # What was followed is a CSV file like any other
    lines = tracks.read_text().splitlines()
    assert lines[0] == '# From throw.avi: 4000 pictures per second, 120 pixels are 0.012 m.'
    assert re.fullmatch(r'# Noise: plate [12].*e-06 m, layer 1 .* m, projectile .* m', lines[1])
    assert lines[2] == 't [s],plate [m],layer 1 [m],projectile [m]'
    # ... in which both bodies are seen by the same sensor
    hold = ('--hold', 'projectile.scale', '--hold', 'projectile.delay')
    again = command.json(tracks, *KNOWN, *hold)
    for name, value in found['found'].items():
        assert again['found'][name]['value'] == pytest.approx(
            value['value'], abs=0.2 * value['error']
        )


def test_spot_behind_a_wire_is_missing_there_and_the_rig_of_pictures_in_a_folder_is_right(
    command, throw_pictures, tmp_path
):
    wire = np.abs(np.arange(330) - 110.0) < 3.0  # above where the projectile rests
    (tmp_path / 'notes.txt').write_text('no picture')
    for number, picture in enumerate(throw_pictures):
        picture = np.where(wire[:, None], np.uint8(60), picture)  # noqa: PLW2901
        colours = np.stack([picture] * 3, axis=-1)
        imageio.imwrite(tmp_path / f'shot_{number}.png', colours if number % 2 else picture)
    assert_is_the_rig(command.json('--video', tmp_path, *AS_TAKEN, *KNOWN))
    said = r'the spot at column 22 row 150 is not seen as a whole in pictures \d+ to \d+;'
    assert re.search(said, command.err)


def test_overlay_shows_what_was_followed(command, throw_video, tmp_path):
    path = tmp_path / 'seen.mp4'  # a picture is drawn for docs/measured.md
    command.run('--video', throw_video, *AS_TAKEN, '--overlay', path, '--to', 0.04)
    frames = list(imageio.imiter(path))
    assert len(frames) == 180
    assert frames[0].shape == (660, 88, 3)
    # rings and paths are coloured, the picture is not
    shown = frames[20].astype(float)
    assert ((shown.max(axis=-1) - shown.min(axis=-1)) > 60.0).sum() > 100


def test_rate_that_cannot_be_is_refused_before_anything_is_fitted(command, throw_video):
    for rate, scale, value in (
        (25, 12e-3, 'the plate swings at 0.4'),  # at which the video is shown
        (400, 12e-6, 'less than gravity'),
        (4e5, 12e-3, 'the plate swings at'),
    ):
        message = command.refused('--video', throw_video, '--rate', rate, '--scale', scale, 120)
        assert value in message
        assert f'at {rate:g} pictures per second' in message


def test_spots_are_on_what_is_said(command, throw_video):
    found = command.json(
        '--video', throw_video, *AS_TAKEN, '--spots', 'plate, none, none', '--to', 0.04
    )
    assert list(found['found']) == ['engine.frequency', 'engine.damping_ratio', 'engine.amplitude']
    message = command.refused('--video', throw_video, *AS_TAKEN, '--spots', 'plate,projectile')
    assert message.startswith(
        f'{throw_video}: 3 round spots are seen, at column 22 row 315, column 22 row 240, '
    )
    assert message.endswith('and not 2, plate, projectile')


@pytest.mark.parametrize('line', [(), ('--line', 30, 2, 107)], ids=['spots', 'line'])
def test_free_layer_is_read_off_a_video(command, layer_video, line):
    found = command.json('--free-layer', 8e-3, layer_video, *AS_TAKEN, *line)
    (layer,) = found['layers']
    without_loss = PERIOD * np.sqrt(1.0 - (50.0 * PERIOD / (2.0 * np.pi)) ** 2)
    assert layer['period']['value'] == pytest.approx(
        without_loss, abs=4.0 * layer['period']['error']
    )
    assert layer['period']['error'] < 2e-3 * PERIOD


def test_space_time_picture_shows_edges_and_period(command, layer_video, tmp_path):
    pytest.importorskip('matplotlib')
    path, tracks = tmp_path / 'line.png', tmp_path / 'ends.csv'
    line = ('--line', 30, 2, 107)
    pictures = ('--space-time', path, '--tracks', tracks)
    found = command.json('--free-layer', 8e-3, layer_video, *AS_TAKEN, *line, *pictures)
    picture = imageio.imread(path)[..., :3].astype(float)
    assert picture.shape[:2] == (720, 1440)
    # Orange, as nothing else is: two edges from left to right, the upper one of which swings
    orange = (picture[..., 0] - picture[..., 2]) > 100.0
    rows = [np.flatnonzero(column) for column in orange[:, 200:1380].T]
    top = np.array([row[0] for row in rows if row.size])
    assert top.size > 1150
    assert np.ptp(top) == pytest.approx(12.0 / 106 * 610, rel=0.25)
    assert command.json('--free-layer', 8e-3, tracks)['layers'][0]['period'][
        'value'
    ] == pytest.approx(found['layers'][0]['period']['value'], rel=1e-6)


THROW = ('--video', 'VIDEO', *AS_TAKEN)
LAYER = ('--free-layer', '0.01', 'VIDEO', *AS_TAKEN)


@pytest.mark.parametrize(
    ('args', 'message'),
    [
        (('--video', 'VIDEO'), 'argument --rate: must be given with a video'),
        (('--video', 'VIDEO', '--rate', '1'), 'argument --scale: must be given with a video'),
        ((*THROW, '--rate', 'fast'), 'argument --rate: must be finite and positive, got fast'),
        ((*THROW, '--scale', '1', '0'), 'argument --scale: must be finite and positive, got 0'),
        (('a.csv', '--rate', '1'), 'argument --rate: is for videos'),
        ((*THROW, '--video', 'VIDEO', '--tracks', 'a.csv'), 'argument --tracks: is for one video'),
        ((*THROW, '--line', '1', '2', '3'), 'argument --line: is for the video of a free layer'),
        ((*LAYER, '--space-time', 'a.png'), 'argument --space-time: needs --line'),
        ((*LAYER, '--line', '400', '2', '9'), 'VIDEO: a line from row 2 to row 9 of column 400'),
        ((*THROW, '--spots', 'ball'), 'VIDEO: a spot is on one of plate, layer, projectile, none'),
        ((*THROW, '--spots', 'layer,layer,projectile'), 'VIDEO: less than 12 positions of the'),
        ((*THROW, '--light-spots'), 'VIDEO: the first picture shows no light round spot, but'),
        ((*THROW, '--overlay', 'a.gif'), 'argument --overlay: must end on .png, .pdf, .svg, .mp4'),
        (('--video', 'none.avi', *AS_TAKEN), 'none.avi: No such file or directory'),
        ((*THROW, '--tracks', 'no/a.csv'), 'argument --tracks: no/a.csv: there is no folder no'),
    ],
)
def test_what_is_wrong_with_a_video_is_said_in_one_line(command, throw_video, args, message):
    args = [throw_video if arg == 'VIDEO' else arg for arg in args]
    assert command.refused(*args).startswith(message.replace('VIDEO', str(throw_video)))
