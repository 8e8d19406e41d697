# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Charts, by the artists of Matplotlib and by pixels, and the map of all layers."""

from __future__ import annotations

import numpy as np
import pytest

figures = pytest.importorskip('matplotlib.figure')

from soft_throw_ros.configuration import TWIN  # noqa: E402, I100
from soft_throw_ros.core.rig import Layer, Rig  # noqa: E402
from soft_throw_ros.recording import charts  # noqa: E402
from soft_throw_ros.recording.charts import draw_energy_map  # noqa: E402


def test_colours_distinguish_signs_and_are_grey_without_a_value() -> None:
    colours = charts.signed_colours(np.array([[-0.2, 0.0], [0.2, np.nan]]), 0.2).astype(int)
    assert colours.shape == (2, 2, 3)
    (red, _, blue), middle = colours[0]
    assert red > blue
    assert middle.min() > 240
    (red, _, blue), grey = colours[1]
    assert blue > red
    assert grey.tolist() == [0xB0] * 3


# the map of all layers, against the model

BEST = {'thickness': 0.0418, 'wave_speed': 22.65, 'energy_transfer': 4.143}


@pytest.mark.parametrize(
    ('values', 'expected'),
    [
        ({}, ['now: α 3.637']),
        (BEST, ['now: α 3.637', 'recommended: α 4.143']),
        ({'now.energy_transfer': 3.5, **BEST}, ['now: α 3.500', 'recommended: α 4.143']),
    ],
)
def test_marks_are_the_layer_of_the_rig_and_the_recommended_one(values, expected) -> None:
    figure = draw_energy_map(Rig(), TWIN.defaults(), values)
    assert [line.get_label() for line in figure.axes[0].lines] == expected
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == expected


def test_map_extends_beyond_the_considered_layers() -> None:
    panel = draw_energy_map(Rig(layer=Layer(thickness=0.08)), TWIN.defaults(), {}).axes[0]
    assert panel.get_xlim() == pytest.approx((1.0, 80.0))
    assert np.nanmax(panel.collections[0].get_array()) > 4.0
