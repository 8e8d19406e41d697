# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Motions of a plate from files and from noisy records of its height."""

import numpy as np
import pytest
from soft_throw_ros.configuration import motions, ParameterError, rig_of, TWIN
from soft_throw_ros.core.plate import SampledMotion, Underdamped
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.core.throw import simulate, throw_many
from twin_runs import complete_settings

PLATE = Underdamped.of(Rig().engine)
TIMES = np.arange(0.0, 0.1, 2e-4)


def lines(separator=',', start=0.0, scale=1.0):
    heights = scale * PLATE.position(TIMES - start)
    return [f'{t:.6f}{separator}{z:.12f}' for t, z in zip(TIMES, heights, strict=True)]


@pytest.mark.parametrize(('head', 'separator', 'scale'), [
    ('', ',', 1.0), ('t [s];plate [mm]\n', ';', 1e3), ('time,height\n', ',', 1.0),
])
def test_file_agrees_with_the_motion_that_it_samples(write, head, separator, scale):
    path = write(head + '\n'.join(lines(separator, start=0.01234, scale=scale)))
    settings = complete_settings(engine__motion_file=str(path))
    assert settings['engine.motion'] == 'file'
    assert TWIN.change(settings, {'engine.motion_file': ''})['engine.motion'] == 'underdamped'
    result, expected, engine = simulate(rig_of(settings)), simulate(Rig()), Rig().engine
    assert abs(result.ejection_time - expected.ejection_time) * engine.frequency < 1e-4
    assert abs(result.ejection_speed - expected.ejection_speed) / engine.speed_scale < 1e-4


def test_written_motion_is_read_back_and_an_encoded_one_bit_by_bit(write):
    motion = motions.read(write('\n'.join(lines())))
    again = motions.read(write(motions.to_csv(motion), 'again.csv'))
    np.testing.assert_allclose(again.states, motion.states, rtol=1e-14, atol=1e-18)
    elsewhere = SampledMotion(motion.times + 7.0, np.add(motion.states, [0.3, 0.0, 0.0]))
    moved = motions.read(write(motions.to_csv(elsewhere), 'moved.csv'))
    np.testing.assert_allclose(moved.states, motion.states, atol=1e-15)
    np.testing.assert_allclose(moved.times, motion.times, atol=1e-14)
    decoded = motions.decode(motions.encode(motion))
    np.testing.assert_array_equal(decoded.states, motion.states)
    for other in (again, decoded):
        np.testing.assert_array_equal(other.times, motion.times)
    for text in ('not base64', '', 7):
        with pytest.raises(ValueError, match=f'no motion .*{text}'):
            motions.decode(text)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', ': is empty'),
        ('0,0\n1,1\n', ':.* at least 4'),
        ('0,0\n1,0\n2,0\n3,1\n', ': heights must be at least 8, got 4'),
        ('\n'.join(f'{5 * n}e-3,{int(n > 15)}' for n in range(20)), 'after the start must be at'),
        ('\n'.join(f'{n},0' for n in range(20)), ': the plate must move, got heights from 0 to 0'),
        ('\n'.join(f'{n}e-3,{n**3}' for n in range(30)), ': the plate must come to rest, got'),
        ('t,z,velocity,acceleration\n0,0,1,0\n1,1,0,0', ': .* at rest, got 1 and 0 m/s'),
    ],
)
def test_bad_file_is_refused_with_line_and_value(write, text, message):
    path = write(text)
    with pytest.raises(ParameterError, match=message) as refused:
        complete_settings(engine__motion_file=str(path))
    assert str(refused.value).startswith(str(path))
    assert refused.value.names == ('engine.motion_file',)


@pytest.mark.parametrize(
    ('start', 'jitter'), [(0.0, 0.0), (0.02, 0.0), (0.02003, 0.0), (0.0201, 0.0), (0.02017, 0.25)]
)
def test_record_agrees_with_the_motion_that_it_samples(start, jitter):
    times = 2e-4 * (np.arange(600) + jitter * np.random.default_rng(3).uniform(size=600))
    motion = motions.motion_from_record(times, PLATE.position(times - start) + 3e-3)
    assert motion.times[0] == 0.0
    inside = np.linspace(0.0, 0.095, 4001)
    misfit = motion.velocity(inside) - PLATE.velocity(inside)
    assert np.abs(misfit).max() < 1e-3 * PLATE.peak_velocity
    assert np.sqrt(np.mean(misfit**2)) < 1e-4 * PLATE.peak_velocity
    np.testing.assert_allclose(motion.position(inside), PLATE.position(inside), atol=1e-6)


@pytest.mark.parametrize(
    ('rate', 'noise', 'error'),
    [
        (1e3, 5e-6, 0.02), pytest.param(2e3, 5e-6, 0.02, marks=pytest.mark.slow),
        pytest.param(5e3, 1e-8, 1e-3, marks=pytest.mark.slow),
        pytest.param(5e3, 5e-6, 4e-3, marks=pytest.mark.slow),
        pytest.param(5e3, 5e-5, 0.05, marks=pytest.mark.slow),
    ],
)
def test_record_throws_as_the_plate_that_it_samples(rate, noise, error):
    """A wrong acceleration at the start would throw the projectile off at once."""
    random = np.random.default_rng(6)
    expected = throw_many(Rig()).ejection_speed
    times = np.arange(0.0, 0.15, 1.0 / rate)
    speeds = []
    for _ in range(12):
        heights = PLATE.position(times - 0.02 - random.uniform(0.0, 1.0 / rate))
        heights += noise * random.standard_normal(times.size)
        motion = motions.motion_from_record(times, heights)
        speeds.append(throw_many(Rig(engine=Engine(motion=motion))).ejection_speed)
    assert speeds == pytest.approx(np.full(12, expected), rel=error)
