# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Spots followed through rendered pictures with exactly known positions."""

import re

import numpy as np
import pytest
from rendering import CONTRAST, DIAMETER, disc, exposed, picture
from scipy.ndimage import gaussian_filter
from soft_throw_ros.identification.spots import find_spots, follow_spots, Spot, tracks_of
from soft_throw_ros.identification.tracks import TrackError

pytest.importorskip('skimage', reason='comes with the extra [video]')
SHAPE = (150, 50)


def centres_of(number):
    """Where spots on plate, layer and projectile are; the last one leaves at the top."""
    swing = 20.0 * (1.0 - np.cos(0.11 * number))
    late = 20.0 * (1.0 - np.cos(0.11 * max(number - 4, 0)))
    return [
        (135.3 - 0.3 * swing, 24.8),
        (104.7 - 0.5 * late, 25.4),
        (74.2 - max(0.0, 2.3 * (number - 8)), 24.6 + 0.02 * number),
    ]


def video(count=60, seed=0, **options):
    rng = np.random.default_rng(seed)
    return [picture(SHAPE, centres_of(number), rng, **options) for number in range(count)]


def errors_of(spots):
    """Return the errors of all spots: rows and columns [px]."""
    errors = []
    for index, spot in enumerate(spots):
        truth = np.array([centres_of(number)[index] for number in spot.picture])
        errors.append(np.stack([spot.row, spot.column], axis=1) - truth)
    return errors


@pytest.mark.parametrize(
    ('options', 'most'),
    [
        ({}, 0.025),  # the contrast, noise and blur that the module names
        ({'noise': 0.0}, 0.004),
        ({'blur': 1.6}, 0.035),
        ({'contrast': 70.0}, 0.05),
        ({'diameter': 12.0, 'noise': 8.0}, 0.05),
        ({'around': 200.0 - 0.3 * np.arange(150.0)[:, None]}, 0.05),  # lit from above
    ],
    ids=['usual', 'no noise', 'blurred', 'faint', 'large', 'uneven'],
)
def test_spots_are_followed_within_a_twentieth_of_a_pixel(options, most):
    spots = follow_spots(video(**options)).spots
    assert len(spots) == 3
    assert [spot.row.size for spot in spots[:2]] == [60, 60]
    for errors in errors_of(spots):
        assert np.sqrt(np.mean(errors**2, axis=0)).max() < most


def test_spot_is_followed_until_it_leaves_the_picture():
    spots = follow_spots(video()).spots
    seen = spots[2].row.size
    assert 30 < seen < 45
    # to within a picture or so of where its edge, with its blur, touches that of the picture
    assert centres_of(seen - 1)[2][0] > 0.5 * DIAMETER
    assert centres_of(seen + 1)[2][0] < 0.5 * DIAMETER + 4.0
    assert np.abs(errors_of(spots)[2][-3:]).max() < 0.08
    assert [spot.has_left for spot in spots] == [False, False, True]


def behind(wire, width, grey, rows, slope=0.0, seed=0):
    """Take pictures of a spot at these rows behind a wire in front of column 30 at row `wire`."""
    rng = np.random.default_rng(seed)
    shape = (100, 60)
    across = np.arange(shape[0])[:, None] - wire - slope * (np.arange(shape[1]) - 30.0)
    cover = gaussian_filter(1.0 * (np.abs(across) < 0.5 * width), (1.0, 0.0))
    for row in rows:
        levels = 200.0 - CONTRAST * disc(shape, float(row), 30.2)
        yield exposed((1.0 - cover) * levels + cover * grey, rng)


STEP = 80.0 - 18.0 * (1.0 - np.cos(0.11 * np.maximum(np.arange(70) - 10, 0)))


@pytest.mark.parametrize('grey', [20.0, 120.0, 200.0, 250.0])
@pytest.mark.parametrize('width', [2.0, 6.0])
@pytest.mark.parametrize(
    ('rows', 'slope'),
    [(STEP, 0.0), (124.0 - STEP, 0.0), (STEP, 0.3)],
    ids=['step', 'back', 'sloping'],
)
def test_spot_behind_a_wire_is_missing_or_correct_and_found_again(rows, width, grey, slope):
    (spot,) = follow_spots(behind(62.0, width, grey, rows, slope)).spots
    errors = np.hypot(spot.row - rows[spot.picture], spot.column - 30.2)
    assert errors.max() < 0.3
    assert spot.gaps
    assert spot.picture[-1] == 69
    assert spot.picture.size > 25


def test_permanently_hidden_spot_is_missing_to_the_end():
    rows = np.maximum(85.0 - 0.02 * np.arange(60) ** 2, 50.0)
    (spot,) = follow_spots(behind(50.0, 16.0, 30.0, rows)).spots
    assert spot.picture[-1] < 40
    assert np.abs(spot.row - rows[spot.picture]).max() < 0.2
    assert not spot.has_left


def test_motion_blurred_spots_are_followed():
    rng = np.random.default_rng(0)
    middle = 80.0 + 40.0 * np.cos(0.15 * np.arange(60))  # up to 6 pixels in a picture
    during = np.linspace(-0.5, 0.5, 8)
    pictures = []
    for number in range(60):
        rows = 80.0 + 40.0 * np.cos(0.15 * (number + during))
        seen = sum(disc((160, 50), row, 25.0) for row in rows) / during.size
        pictures.append(exposed(200.0 - CONTRAST * seen, rng))
    (spot,) = follow_spots(pictures).spots
    assert spot.picture.size > 55
    assert np.abs(spot.row - middle[spot.picture]).max() < 0.3


@pytest.mark.parametrize('light', [False, True])
@pytest.mark.parametrize('flicker', [0.1, 0.25])
def test_flicker_of_lamps_loses_no_sample(flicker, light):
    rng = np.random.default_rng(2)
    pictures = []
    for number in range(40):
        levels = np.full(SHAPE, 40.0 if light else 190.0)
        for row, column in centres_of(number)[:2]:
            levels += (CONTRAST if light else -CONTRAST) * disc(SHAPE, row, column)
        gain = 1.0 + flicker * np.sin(2.0 * np.pi * 100.0 * number / 4000.0)
        pictures.append(exposed(gain * levels, rng))
    followed = follow_spots(pictures, light=light)
    assert [spot.picture.size for spot in followed.spots] == [40, 40]
    for errors in errors_of(followed.spots):
        assert np.sqrt(np.mean(errors**2, axis=0)).max() < 0.04


@pytest.mark.parametrize('grey', [20.0, 220.0])
def test_spot_hidden_in_the_first_picture_is_found(grey):
    rng = np.random.default_rng(4)
    rows = np.append(np.full(12, 74.2), np.arange(72.0, 20.0, -1.5))
    cover = np.abs(np.arange(SHAPE[0]) - 74.0)[:, None] < 6.0
    pictures = [
        np.where(cover, np.uint8(grey), picture(SHAPE, [(135.3, 24.8), (row, 25.0)], rng))
        for row in rows
    ]
    followed = follow_spots(pictures)
    assert followed.pictures == rows.size
    assert len(followed.spots) == 1
    number, late = followed.late
    assert late[:2] == pytest.approx((rows[number], 25.0), abs=0.5)
    assert follow_spots(picture(SHAPE, [(135.3, 24.8)], rng) for _ in rows).late is None


def test_spots_are_distinguished_from_other_dark_objects():
    rng = np.random.default_rng(1)
    levels = np.full((200, 160), 200.0)
    levels[:60] = 30.0  # background
    levels[:, :20] = 30.0
    levels[100:104, 60:120] = 40.0  # a line
    levels[150:156, 30:36] -= 20.0  # a shadow, too faint
    levels[160, 100] = 0.0  # a broken pixel
    truth = [(180.0, 80.0), (140.0, 81.0), (80.0, 79.0)]
    spots = find_spots(picture((200, 160), truth, rng, around=levels))
    assert [spot[:2] for spot in spots] == [pytest.approx(centre, abs=0.3) for centre in truth]
    assert [spot.diameter for spot in spots] == pytest.approx([7.0] * 3, abs=0.7)


def test_pictures_without_spots_are_refused():
    empty = picture(SHAPE, [], np.random.default_rng(0))
    with pytest.raises(TrackError, match=r'shows no dark round spot$'):
        follow_spots([empty] * 20)
    with pytest.raises(TrackError, match='no dark round spot, but 3 light ones; see --light'):
        follow_spots([255 - frame for frame in video(count=3)])
    with pytest.raises(TrackError, match='no picture'):
        follow_spots([])
    with pytest.raises(TrackError, match=r'one size, got \(149, 50\) after \(150, 50\)'):
        follow_spots([video(count=1)[0], empty[1:]])


def spot(row, count=20):
    rows = row + np.arange(count) ** 2 / 100.0
    return Spot(
        picture=np.arange(count),
        row=rows,
        column=np.full(count, 5.0),
        error=0.02,
        start=(row, 5.0),
    )


def test_tracks_are_heights_in_metres_over_seconds():
    tracks = tracks_of([spot(90.0), spot(70.0), spot(50.0), spot(20.0, 15)], rate=5e3, scale=1e-4)
    assert list(tracks) == ['plate', 'layer 1', 'layer 2', 'projectile']
    assert tracks['plate'].time == pytest.approx(np.arange(20) / 5e3)
    assert tracks['plate'].position == pytest.approx(-1e-6 * np.arange(20) ** 2)
    assert tracks['projectile'].position[0] == pytest.approx(7e-3)
    assert tracks['projectile'].time.size == 15
    assert tracks['plate'].noise == pytest.approx(2e-6)


def test_spots_of_one_body_are_averaged():
    bodies = ['plate', 'plate', 'none', 'projectile', 'projectile']
    spots = [spot(90.0), spot(88.0, 13), spot(80.0, 3), spot(50.0), spot(30.0)]
    tracks = tracks_of(spots, bodies, rate=1.0, scale=1.0)
    assert list(tracks) == ['plate', 'projectile']
    assert tracks['plate'].position == pytest.approx(1.0 - np.arange(13) ** 2 / 100.0)
    assert tracks['plate'].noise == pytest.approx(0.02 / np.sqrt(2.0))
    assert list(tracks_of([spot(9.0)], rate=1.0, scale=1.0)) == ['plate']


def test_pictures_without_the_spot_are_missing_in_its_track():
    hidden = np.delete(np.arange(20), [4, 5, 6])
    whole = spot(90.0)
    partly = Spot(
        picture=hidden,
        row=whole.row[hidden] - 20.0,
        column=whole.column[hidden],
        error=0.02,
        start=(70.0, 5.0),
    )
    assert partly.gaps == [(4, 6)]
    tracks = tracks_of([whole, partly], rate=100.0, scale=1.0)
    assert tracks['plate'].time.size == 20
    assert tracks['projectile'].time == pytest.approx(hidden / 100.0)
    averaged = tracks_of([whole, partly], ['plate', 'plate'], rate=100.0, scale=1.0)['plate']
    assert averaged.time == pytest.approx(hidden / 100.0)
    assert averaged.position == pytest.approx(10.0 - hidden**2 / 100.0)


@pytest.mark.parametrize(
    ('spots', 'options', 'value'),
    [
        ([spot(9.0)], {'rate': 0.0}, '0.0'),
        ([spot(9.0)], {'scale': np.inf}, 'inf'),
        ([spot(9.0)], {'bodies': ['ball']}, "'ball'"),
        ([spot(9.0), spot(3.0)], {'bodies': ['plate']}, 'column 5 row 9, column 5 row 3'),
        ([spot(9.0), spot(3.0, 4)], {}, 'column 5 row 3, on the projectile, is seen in 4 '),
        ([spot(9.0, 0)], {}, 'column 5 row 9, on the plate, is seen in 0 '),
    ],
)
def test_impossible_tracks_of_spots_are_refused(spots, options, value):
    with pytest.raises(ValueError, match=re.escape(value)):
        tracks_of(spots, **{'rate': 1.0, 'scale': 1.0, **options})
