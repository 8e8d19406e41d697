# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The order of the values of a fit."""

import numpy as np
from soft_throw_ros.identification.fit_description import (
    FitDescription,
    FREE,
    IDEAL_BENCH,
)
from soft_throw_ros.identification.parameter_layout import ParameterLayout
from soft_throw_ros.identification.tracks import ThrowTracks, Track

TRACK = Track(time=np.arange(20.0), position=np.sin(np.arange(20.0)))


def layout_of(*names, **options):
    throws = [ThrowTracks(name=name, plate=TRACK, projectile=TRACK) for name in names]
    amplitude = FREE._replace(is_per_throw=True)
    description = FitDescription({**IDEAL_BENCH, 'engine.amplitude': amplitude}, **options)
    return ParameterLayout.of(throws, description)


def test_shared_values_come_first_and_names_have_the_number_of_the_throw():
    layout = layout_of('a', 'b', heights='common')
    assert layout.names == (
        'engine.frequency', 'engine.damping_ratio', 'layer.wave_speed',
        'engine.amplitude[1]', 'engine.amplitude[2]',
        'start_time[1]', 'plate_offset[1]', 'start_time[2]', 'plate_offset[2]',
    )
    assert layout.indices['engine.amplitude'] == {0: 3, 1: 4}
    assert layout.indices_of('engine.frequency') == [0]
    assert layout.is_per_throw('engine.amplitude')
    assert not layout.is_per_throw('engine.frequency')
    assert 'layer.thickness' not in layout
