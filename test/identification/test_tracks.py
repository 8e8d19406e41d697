# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tracks: read from text whole or damaged, cut into throws, and how noisy they are."""

import io
from pathlib import Path
import re

from bags import accepted, texts
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.identification.track_csv import read_csv, UNITS
from soft_throw_ros.identification.tracks import (
    FEWEST,
    find_throws,
    split_at_breaks,
    ThrowTracks,
    Track,
    TrackError,
)

BODIES = ('plate', 'projectile')
ROWS = [f'{t:.4f},{t**2:.6f},{t + 0.01:.6f}' for t in np.arange(20) * 2e-4]


@pytest.mark.parametrize(('head', 'count', 'value'), [
    ('0,1e9,0', 0, "file:1: plate must be within +- 1e+06, got '1e9'"),
    ('t,piston,ball', 20, 'no column is named plate or z_plate or zp or z_p, got'),
    ('t,plate [inch],projectile', 20, "got 'plate [inch]'"),
    ('t [h],plate,projectile', 20, 'file:1: time must be in s or ms or us, got'),
    ('', 5, f'file: 5 heights of the plate, where at least {FEWEST} are needed'),
])
def test_bad_csv_is_refused_with_its_line(head, count, value):
    with pytest.raises(TrackError, match=re.escape(value)):
        read_csv([head, *ROWS[:count]], 'file', BODIES)


LINES = (Path(__file__).parents[1] / 'data/reference_tracks.csv').read_text().splitlines(True)[:16]
POINTS, HEADLESS = ''.join(LINES), ''.join(LINES[1:]).replace(',', '\t')


@settings(max_examples=200)
@given(
    text=texts(POINTS, POINTS.replace(',', ';').replace('.', ','), HEADLESS),
    unit=st.sampled_from(list(UNITS)),
)
def test_damaged_csv_gives_finite_tracks_or_is_refused_with_its_name(text, unit):
    tracks = accepted(lambda: read_csv(io.StringIO(text), 'a.csv', BODIES, unit=unit), 'a.csv')
    for track in (tracks or {}).values():
        assert np.isfinite([track.time, track.position]).all()
        assert (np.diff(track.time) > 0.0).all()


PLATE = Underdamped(frequency=63.2, amplitude=2e-3, damping_ratio=0.064)


@pytest.mark.parametrize('rate', [2000.0, 10000.0])
@pytest.mark.parametrize('lost', [0.0, 0.03, 0.3])
def test_noise_is_distinguished_from_motion_with_outliers_and_lost_samples(rate, lost):
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 1.0, 1.0 / rate)
    position = PLATE.position(time - 0.1) + 2e-5 * rng.normal(size=time.size)
    position[[50, 700]] += 5e-3
    track = Track(time=time, position=position).where(rng.random(time.size) >= lost)
    assert track.noise == pytest.approx(2e-5, rel=0.05)


@pytest.mark.parametrize('noise', [0.0, 5e-6, 2e-5])
def test_noise_of_rounded_heights_is_at_least_the_rounding_error(noise):
    time, rounding, noises = np.arange(0.0, 0.1, 2e-4), 2e-5 / np.sqrt(12.0), []
    for seed in range(8):
        scatter = noise * np.random.default_rng(seed).normal(size=time.size)
        heights = 2e-5 * np.round((PLATE.position(time - 0.03) + scatter) / 2e-5)
        noises.append(Track(time=time, position=heights).noise)
    assert 0.99 * rounding < np.mean(noises) < 1.1 * np.hypot(noise, rounding)
    assert Track(time=time, position=np.zeros(time.size)).noise > 0.0


@pytest.mark.parametrize('step', [0.0, 1e-5, 5e-5])
@pytest.mark.parametrize(('first', 'count', 'height'), [(250, 3, 0.0), (300, 200, None)])
def test_heights_that_stand_still_in_motion_are_stuck(step, first, count, height):
    time = np.arange(0.0, 0.1, 2e-4)
    scatter = 5e-6 * np.random.default_rng(4).normal(size=time.size)
    position = 0.01 + PLATE.position(time - 0.03) + scatter
    position = step * np.rint(position / step) if step else position
    assert not Track(time=time, position=position).is_stuck.any()
    stuck = slice(first, first + count)
    position[stuck] = position[first - 1] if height is None else height
    track = Track(time=time, position=position)
    assert track.is_stuck[first + 1:first + count].all()
    assert track.is_stuck.sum() <= count + 1


def record(*, starts, period=0.5, rate=2000.0, noise=1e-5, back=0.3, begin=0.0):
    """Make a plate that jumps at each start, and is put back some time later."""
    time = np.arange(begin, max(starts) + period, 1.0 / rate)
    plate = Underdamped(frequency=40.0, amplitude=2e-3, damping_ratio=0.064)
    position = noise * np.random.default_rng(3).normal(size=time.size) - 0.3
    for start in starts:
        part = np.clip((time - start - back) / 0.1, 0.0, 1.0)
        until = time < start + period if start < max(starts) else True
        position += until * plate.position(time - start) * (1.0 - part**2 * (3.0 - 2.0 * part))
    track = Track(time=time, position=position)
    return ThrowTracks(name='bag', plate=track, projectile=track)


def split_into_throws(record):
    return record.split(find_throws(record.plate), 'throw')


@pytest.mark.parametrize(('starts', 'options'), [
    ([0.2, 0.7, 1.3, 1.8], {'noise': 0.0}),
    ([0.2, 0.7, 1.3, 1.8], {'noise': 2e-4}),  # a tenth of the amplitude
    ([0.2, 0.345, 0.49], {'period': 0.145, 'back': 0.02}),  # less than six periods apart
    ([5.0, 300.0, 590.0], {'rate': 400.0}),  # ten samples in a period
])
def test_record_is_cut_into_its_throws(starts, options):
    throws = split_into_throws(record(starts=starts, **options))
    assert [throw.name for throw in throws] == [f'bag, throw {n + 1}' for n in range(len(starts))]
    edges = [throw.plate.time[index] for throw in throws for index in (0, -1)]
    assert edges == sorted(edges)
    for start, following, throw in zip(starts, [*starts[1:], np.inf], throws, strict=True):
        first, last = throw.plate.time[[0, -1]]
        assert start - 0.01 < first < start
        assert min(start + 0.14, following - 0.01) < last < start + 0.16  # six periods
        assert throw.projectile.time == pytest.approx(throw.plate.time)


@pytest.mark.parametrize(('seen', 'count'), [(0.002, 2), (0.045, 2), (0.055, 3)])
def test_throw_cut_off_by_the_end_of_the_record_is_ignored(seen, count):
    whole = record(starts=[0.2, 0.7, 1.3])
    assert len(split_into_throws(whole.between(0.0, 1.3 + seen))) == count


@pytest.mark.parametrize('pause', [2.0, 1.7e9])  # the second is a clock that was set
def test_record_is_cut_at_long_gaps(pause):
    first, second = (record(starts=[start]).plate for start in (0.2, 0.3))
    track = Track(
        time=np.append(first.time, second.time + pause),
        position=np.append(first.position, second.position),
    )
    parts = split_at_breaks(ThrowTracks(name='bag', plate=track, projectile=track))
    assert [part.name for part in parts] == ['bag, part 1', 'bag, part 2']
    assert [part.plate.time.size for part in parts] == [1400, 1600]
    gap = first.where(np.abs(first.time - 0.3) > 0.2)  # of many samples, but shorter than a second
    assert len(split_at_breaks(ThrowTracks(name='bag', plate=gap))) == 1
    stray = track.where(np.arange(track.time.size) <= first.time.size)
    (only,) = split_at_breaks(ThrowTracks(name='bag', plate=stray))
    assert only.plate.time.size == first.time.size


@pytest.mark.parametrize('options', [
    {'period': 0.25},  # ends before it is put back
    {'period': 0.25, 'begin': 0.21},  # never at rest
    {'period': 0.05, 'rate': 200.0},  # few samples
])
def test_record_of_one_settling_throw_is_not_cut(options):
    whole = record(starts=[0.2], **options)
    assert split_into_throws(whole) == split_at_breaks(whole) == [whole]
