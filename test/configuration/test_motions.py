# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motions of a plate from files."""

import numpy as np
import pytest
from soft_throw_ros.configuration import motions, ParameterError, rig_of, TWIN
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate

PLATE = Underdamped.of(Rig().engine)
TIMES = np.arange(0.0, 0.1, 2e-4)


def settings_with(path):
    return TWIN.defaults() | TWIN.change(TWIN.defaults(), {'engine.motion_file': str(path)})


def lines(separator=',', start=0.0, scale=1.0):
    heights = scale * PLATE.position(TIMES - start)
    return [f'{t:.6f}{separator}{z:.12f}' for t, z in zip(TIMES, heights, strict=True)]


@pytest.mark.parametrize(
    ('head', 'separator', 'scale'),
    [
        ('', ',', 1.0),
        ('t [s];plate [mm]\n', ';', 1e3),
        ('time,height\n', ',', 1.0),
    ],
)
def test_file_agrees_with_the_motion_that_it_samples(write, head, separator, scale):
    path = write(head + '\n'.join(lines(separator, start=0.01234, scale=scale)))
    settings = settings_with(path)
    assert settings['engine.motion'] == 'file'
    result, expected = simulate(rig_of(settings)), simulate(Rig())
    frequency, scale = Rig().engine.frequency, Rig().engine.speed_scale
    assert result.ejection_time * frequency == pytest.approx(
        expected.ejection_time * frequency, abs=1e-4
    )
    assert result.ejection_speed / scale == pytest.approx(
        expected.ejection_speed / scale, abs=1e-4
    )


def test_written_motion_is_read_back_exactly(write):
    motion = motions.read(write('\n'.join(lines())))
    again = motions.read(write(motions.to_csv(motion), 'again.csv'))
    np.testing.assert_array_equal(again.times, motion.times)
    np.testing.assert_allclose(again.states, motion.states, rtol=1e-14, atol=1e-18)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', ': is empty'),
        ('0,0\n1,1\n', ':.* at least 4'),
        ('0,0\n1e-3,nan\n', r":2: height .* got 'nan'"),
        ('t,z [furlong]\n0,0\n', r':1: height must be in m or .*furlong'),
        ('\n'.join(f'{n},0' for n in range(20)), ': the plate must move, got heights from 0 to 0'),
        ('\n'.join(f'{n}e-3,{n**3}' for n in range(30)), ': the plate must come to rest, got'),
        ('t,z,velocity,acceleration\n0,0,1,0\n1,1,0,0', ': .* at rest, got 1 and 0 m/s'),
    ],
)
def test_bad_file_is_refused_with_line_and_value(write, text, message):
    path = write(text)
    with pytest.raises(ParameterError, match=message) as refused:
        settings_with(path)
    assert str(refused.value).startswith(str(path))
    assert refused.value.names == ('engine.motion_file',)


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(ParameterError, match=r'nosuch\.csv: No such file'):
        settings_with(tmp_path / 'nosuch.csv')
    with pytest.raises(ParameterError, match=r"'file' needs engine\.motion_file"):
        TWIN.change(TWIN.defaults(), {'engine.motion': 'file'})


def test_removing_the_file_restores_the_underdamped_motion(write):
    settings = settings_with(write('\n'.join(lines())))
    assert TWIN.change(settings, {'engine.motion_file': ''})['engine.motion'] == 'underdamped'


def test_encoded_motion_is_decoded_bit_by_bit(write):
    expected = motions.read(write('\n'.join(lines())))
    again = motions.decode(motions.encode(expected))
    np.testing.assert_array_equal(again.times, expected.times)
    np.testing.assert_array_equal(again.states, expected.states)
    for text in ('not base64', '', 7):
        with pytest.raises(ValueError, match=f'no motion .*{text}'):
            motions.decode(text)
