# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Spots followed through rendered pictures with exactly known positions."""

import numpy as np
import pytest
from reference.pictures import CONTRAST, disc, exposed, picture
from scipy.ndimage import gaussian_filter
from soft_throw_ros.identification.spots import follow_spots, Spot
from soft_throw_ros.identification.tracks import TrackError

pytest.importorskip('trackpy', reason='comes with the extra [video]')
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


@pytest.mark.parametrize('options', [
    {'blur': 1.6},
    {'contrast': 70.0},
    {'contrast': -CONTRAST, 'around': 40.0},  # light
    {'diameter': 12.0, 'noise': 8.0},
    {'around': 200.0 - 0.3 * np.arange(150.0)[:, None]},  # lit from above
])
def test_spots_are_followed_within_a_tenth_of_a_pixel_until_they_leave(options):
    spots, count = follow_spots(video(**options), light=options.get('contrast', 1.0) < 0.0)
    assert count == 60
    assert [len(spot.picture) for spot in spots[:2]] == [60, 60]
    for index, spot in enumerate(spots):
        errors = np.array(spot.centre) - [centres_of(number)[index] for number in spot.picture]
        assert np.sqrt(np.mean(errors**2, axis=0)).max() < 0.1
    assert 30 <= len(spots[2].picture) < 42
    assert spots[2].has_left


def test_dark_objects_that_are_no_spots_are_ignored():
    levels = np.full((200, 160), 200.0)
    levels[:60] = levels[:, :20] = 30.0  # background
    levels[100:104, 60:120] = 40.0  # a line
    levels[160, 100] = 0.0  # a broken pixel
    truth = [(180.0, 80.0), (140.0, 81.0), (80.0, 79.0)]
    seen = picture((200, 160), truth, np.random.default_rng(1), around=levels)
    spots, _ = follow_spots([seen] * 2)
    assert [spot.first[:2] for spot in spots] == [pytest.approx(each, abs=0.3) for each in truth]


FAST = 90.0 - np.cumsum(np.minimum(0.2 * np.arange(40), 1.5))
SLOW = 90.0 - 0.4 * np.arange(80)


@pytest.mark.parametrize(('width', 'grey', 'rows'), [
    (2.0, 20.0, FAST), (6.0, 120.0, FAST), (6.0, 200.0, SLOW), (16.0, 250.0, FAST),
])
def test_covered_spot_is_missing_and_never_wrong(width, grey, rows):
    rng = np.random.default_rng(0)
    across = np.arange(100.0)[:, None] - 68.0
    cover = gaussian_filter(1.0 * (np.abs(across) < 0.5 * width), (1.0, 0.0))
    levels = (200.0 - CONTRAST * disc((100, 60), row, 30.2) for row in rows)
    pictures = [exposed((1.0 - cover) * level + cover * grey, rng) for level in levels]
    spot = min(follow_spots(pictures)[0], key=lambda spot: abs(spot.first[0] - 90.0))
    row, column = np.transpose(spot.centre)
    assert 5 <= row.size < rows.size
    assert np.hypot(row - rows[spot.picture], column - 30.2).max() < 0.3


def test_samples_beside_a_gap_are_left_out():
    seen = [0, 1, 2, 5, 6, 7]
    spot = Spot(first=np.ones(6), picture=seen, centre=[np.array([50.0 + n, 25.0]) for n in seen])
    spot.finish(8, SHAPE, 7)
    assert (spot.picture, [row for row, _ in spot.centre]) == ([0, 1, 6, 7], [50, 51, 56, 57])


def test_pictures_without_spots_are_refused():
    first, empty = video(count=1)[0], picture(SHAPE, [], np.random.default_rng(0))
    for pictures, message in (
        ([empty] * 2, 'shows no dark round spot'),
        ([], 'no picture'),
        ([first, empty[1:]], r'one size, got \(149, 50\) after \(150, 50\)'),
    ):
        with pytest.raises(TrackError, match=message):
            follow_spots(pictures)
