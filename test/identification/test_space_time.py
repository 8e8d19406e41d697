# SPDX-License-Identifier: Apache-2.0
"""A line through a free layer over time, and the period that it shows."""

from pathlib import Path
import re
import runpy

import numpy as np
import pytest
from soft_throw_ros.identification.space_time import space_time, SpaceTime
from soft_throw_ros.identification.tracks import TrackError

pytest.importorskip('skimage', reason='comes with the extra [video]')
CAMERA = runpy.run_path(str(Path(__file__).with_name('rendering.py')))
SHAPE = (120, 40)
RATE, SCALE = 4000.0, 1e-4
PERIOD = 2.0 * 8e-3 / 7.8
TIME = np.arange(140) / RATE
BOTTOM = 100.2 - 3.0 * np.sin(2.0 * np.pi * 63.2 * TIME)
"""Row of the edge of the plate, which still shakes."""
LENGTH = 80.0 + 6.0 * np.exp(-50.0 * TIME) * np.cos(2.0 * np.pi * TIME / PERIOD)
"""Of the layer. [px]"""


@pytest.fixture(scope='module')
def video():
    """Take pictures of a bright layer with a spot on it, on a plate, before something dark."""
    rng = np.random.default_rng(5)
    pictures = []
    for bottom, length in zip(BOTTOM, LENGTH, strict=True):
        layer = CAMERA['band'](SHAPE, bottom, bottom - length)
        plate = CAMERA['band'](SHAPE, SHAPE[0] + 20.0, bottom)
        levels = 40.0 + 150.0 * layer + 30.0 * plate
        levels -= 110.0 * CAMERA['disc'](SHAPE, bottom - 0.5 * length, 12.0)
        pictures.append(CAMERA['exposed'](levels, rng))
    return pictures


def line(video, column=30, first=5, last=115):
    return space_time(video, column=column, first=first, last=last, rate=RATE, scale=SCALE)


@pytest.mark.parametrize('column', [30, 12], ids=['beside the spot', 'through the spot'])
def test_edges_are_followed_within_a_tenth_of_a_pixel(video, column):
    bottom, top = line(video, column).edges()
    for edge, truth in ((bottom, BOTTOM), (top, BOTTOM - LENGTH)):
        left = edge.position / SCALE - (115.5 - truth)
        assert left.std() < 0.08
        assert abs(left.mean()) < 0.4  # one level for edges of different depth


def test_line_without_two_edges_is_refused():
    levels = np.full((20, 30), 50.0)
    levels[:, 10:] = 150.0
    with pytest.raises(TrackError, match='crosses 1 edges in picture 1'):
        SpaceTime(levels=levels, rate=1.0, scale=1.0).edges()


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'last': 120}, 'a line from row 5 to row 120 of column 30 is not within pictures of 120'),
        ({'first': 115}, 'a line from row 115 to row 115'),
        ({'first': -1}, 'a line from row -1'),
        ({'column': 39}, 'of column 39 is not within pictures of 120 rows and 40 columns'),
    ],
)
def test_line_that_is_not_there_is_refused(video, options, message):
    with pytest.raises(TrackError, match=re.escape(message)):
        line(video, **options)
