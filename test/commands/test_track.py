# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The command `track`, with videos rendered from throws whose truth is known."""

import json
import re
import sys

import numpy as np
import pytest
from reference.method_of_steps import follow
from reference.pictures import picture
from soft_throw_ros.commands import identify, track
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer, Rig

av = pytest.importorskip('av', reason='comes with the extra [video]')
imageio = pytest.importorskip('imageio.v3', reason='comes with the extra [video]')
pytest.importorskip('trackpy', reason='comes with the extra [video]')
COMMAND = (track.main,)
RIG = Rig(
    engine=Engine(frequency=58.0, damping_ratio=0.05, amplitude=1.8e-3),
    layer=Layer(thickness=12e-3, wave_speed=6.9),
)
START, RATE = 0.0082, 3000.0
PIXEL = 1e-4  # as in the pictures of a high-speed camera of 50 mm height [m]
AS_TAKEN = ('--rate', RATE, '--scale', 12e-3, 120)


def write_video(path, pictures):
    """Write pictures into a video without loss, as a camera's software may."""
    grey = {'in_pixel_format': 'gray', 'out_pixel_format': 'gray'}
    imageio.imwrite(path, np.array(pictures), plugin='pyav', codec='ffv1', fps=25, **grey)
    return path


@pytest.fixture(scope='module')
def throw_pictures():
    """Return pictures of a throw; the projectile leaves the pictures at the top."""
    rng, time = np.random.default_rng(3), np.arange(0.0, 0.045, 1.0 / RATE) - START
    plate = Underdamped.of(RIG.engine).position(time) / PIXEL
    projectile = follow(RIG, until=time[-1]).projectile_position(time) / PIXEL
    spots = [
        ((315.3 - low, 21.7), (300.2 - 0.5 * (low + high), 22.4), (270.1 - high, 22.1))
        for low, high in zip(plate, projectile, strict=True)
    ]
    return [picture((330, 44), centres, rng) for centres in spots]


@pytest.fixture(scope='module')
def throw_video(throw_pictures, tmp_path_factory):
    return write_video(tmp_path_factory.mktemp('video') / 'throw.avi', throw_pictures)


def test_video_gives_the_filmed_rig(command, capsys, throw_video, tmp_path):
    tracks, overlay = tmp_path / 'tracks.csv', tmp_path / 'seen.png'
    assert command.run(throw_video, *AS_TAKEN, '--output', tracks, '--overlay', overlay) == ''
    assert overlay.stat().st_size > 1000
    assert command.err == ''
    first, _, head, *_ = tracks.read_text().splitlines()
    assert head == 't [s],plate [m],layer 1 [m],projectile [m]'
    assert '3000 pictures per second, 120 pixels are 0.012 m' in first
    # The layer is of a known thickness and does not stiffen; one camera has seen both bodies
    assert identify.main([str(tracks), '--thickness', '12e-3', '--one-camera', '--json']) == 0
    result = json.loads(capsys.readouterr().out)
    rows = {row['name']: (row['value'], row['error']) for row in result['rows']}
    for name, expected, most in (
        ('engine.frequency', 58.0, 2e-3),
        ('engine.damping_ratio', 0.05, 1.1e-2),
        ('engine.amplitude', 1.8e-3, 3e-3),
        ('layer.wave_speed', 6.9, 5e-2),  # includes the uncertainty of the layer's size
    ):
        value, error = rows[name]
        assert value == pytest.approx(expected, abs=4.0 * error)
        assert error < most * expected
    assert result['warnings'] == []
    assert {'projectile.scale', 'projectile.delay'}.isdisjoint(result['fit']['names'])
    assert all(each['rms'] < 0.03 * PIXEL for each in result['fit']['residuals'])


def test_covered_spot_in_a_folder_of_pictures_is_a_gap(command, throw_pictures, tmp_path):
    for number, each in enumerate(throw_pictures[:80]):
        levels = each.copy()
        if 30 <= number < 40:
            levels[230:250] = 60  # covers the spot on the layer
        colours = np.stack([levels] * 3, axis=-1)
        imageio.imwrite(tmp_path / f'shot_{number}.png', colours if number % 2 else levels)
    (tmp_path / 'notes.txt').write_text('no picture')
    tracks = command.run(tmp_path, *AS_TAKEN)
    found = re.search(r'spot at column 22 row 240 is not seen in pictures (\d+) to', command.err)
    assert int(found[1]) <= 30
    assert found[0] in tracks
    assert tracks.count(',,') > 9  # a height is missing between the others


@pytest.mark.slow
@pytest.mark.parametrize(('rate', 'length', 'value'), [
    (25, 12e-3, 'plate swings at 0.5'),  # at which the video is shown
    (400, 12e-6, ' 9.81 to'),
    (4e5, 12e-3, 'plate swings at'),
    (RATE / 2, 12e-3, 'projectile falls with 2.'),
    (RATE, 30e-3, 'projectile falls with 2'),
])
def test_impossible_rate_is_refused(command, throw_video, rate, length, value):
    message = command.refused(throw_video, '--rate', rate, '--scale', length, 120)
    assert value in message
    assert f'at {rate:g} pictures per second' in message


def test_video_error_is_one_line(command, throw_pictures, tmp_path, monkeypatch):
    path = write_video(tmp_path / 'short.avi', throw_pictures[:10])
    for words, message in (
        (('--spots', 'plate,projectile'), ': 3 round spots are seen, at column 22 '),
        (('--spots', 'plate,layer,ball'), "'ball'"),
        (('--light-spots',), ': the first picture shows no light round spot'),
    ):
        assert message in command.refused(path, *AS_TAKEN, *words)
    # An early loss of the plate is not explained by the rate
    dark = [np.clip(each // 9, 0, 12) for each in throw_pictures[40:90]]
    path = write_video(tmp_path / 'dark.avi', [*throw_pictures[:40], *dark])
    assert 'of 90 pictures only' in command.refused(path, *AS_TAKEN)
    monkeypatch.setitem(sys.modules, 'trackpy', None)
    assert '[video]' in command.refused(path, *AS_TAKEN)
