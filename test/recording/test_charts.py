# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Charts, by the artists of Matplotlib and by pixels."""

from __future__ import annotations

import io

import numpy as np
import pytest

figures = pytest.importorskip('matplotlib.figure')

from soft_throw_ros.recording import charts  # noqa: E402, I100
from soft_throw_ros.recording.charts import MapAxis  # noqa: E402

X = MapAxis('x (mm)', np.linspace(10.0, 30.0, 5))
Y = MapAxis('y', np.geomspace(1.0, 100.0, 3))


def pixels_of(png: bytes) -> np.ndarray:
    image = pytest.importorskip('PIL.Image')
    with image.open(io.BytesIO(png)) as opened:
        return np.asarray(opened.convert('RGB')).astype(int)


def test_map_has_values_scales_titles_and_marks() -> None:
    values = np.arange(15.0).reshape(5, 3)
    values[1, 0] = np.nan
    figure = figures.Figure()
    panel = figure.subplots()
    marks = [('low', 10.0, 1.0), ('high', 30.0, 100.0)]
    charts.draw_map(panel, (X, Y), values, label='s', highest=7.0, marks=marks)
    (mesh,) = panel.collections
    np.testing.assert_array_equal(mesh.get_array().T, values)
    assert mesh.get_clim() == (0.0, 7.0)
    assert (panel.get_xscale(), panel.get_yscale()) == ('linear', 'log')
    assert (panel.get_xlim(), panel.get_ylim()) == ((10.0, 30.0), (1.0, 100.0))
    assert (panel.get_xlabel(), panel.get_ylabel()) == ('x (mm)', 'y')
    drawn = [(line.get_label(), *line.get_xydata()[0]) for line in panel.lines]
    assert drawn == marks
    assert figure.axes[1].get_ylabel() == 's'


def test_frame_surrounds_its_box_and_is_drawn_once() -> None:
    png = charts.strain_frame(8.0, 16.0, 30.0)
    assert charts.strain_frame(8.0, 16.0, 30.0) is png
    pixels = pixels_of(png)
    assert pixels.shape == (190, 620, 3)
    left, top, width, height = charts.FRAME_BOX
    background = pixels[0, 0]
    outside = pixels[top + 20, left - 30:left - 8]
    assert (pixels[top + 5, left - 3:left + 3] != background).any()  # the axis
    assert (pixels[top + 5, left + width - 3:left + width + 3] != background).any()
    assert (pixels[top + height + 5:, left:left + width] != background).any()  # its ticks
    assert (outside == background).all(axis=-1).any()


def test_colours_distinguish_signs_and_are_grey_without_a_value() -> None:
    colours = charts.signed_colours(np.array([[-0.2, 0.0], [0.2, np.nan]]), 0.2).astype(int)
    assert colours.shape == (2, 2, 3)
    (red, _, blue), middle = colours[0]
    assert red > blue
    assert middle.min() > 240
    (red, _, blue), grey = colours[1]
    assert blue > red
    assert grey.tolist() == [0xB0] * 3
