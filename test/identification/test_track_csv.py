# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Damaged CSV files of tracks; test_tracks.py has the valid ones and their refusals."""

import io
from pathlib import Path

from damage import accepted, texts
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from soft_throw_ros.identification.track_csv import read_csv, UNITS

LINES = (Path(__file__).parents[1] / 'data/reference_tracks.csv').read_text().splitlines(True)[:16]
POINTS, HEADLESS = ''.join(LINES), ''.join(LINES[1:]).replace(',', '\t')


@settings(max_examples=200)
@given(
    text=texts(POINTS, POINTS.replace(',', ';').replace('.', ','), HEADLESS),
    unit=st.sampled_from(list(UNITS)),
)
def test_damaged_csv_gives_finite_tracks_or_is_refused_with_its_name(text, unit):
    tracks = accepted(
        lambda: read_csv(io.StringIO(text), 'tracks.csv', ('plate', 'projectile'), unit=unit),
        'tracks.csv',
    )
    for track in (tracks or {}).values():
        assert np.isfinite(track.position).all()
        assert np.isfinite(track.time).all()
        assert (np.diff(track.time) > 0.0).all()
