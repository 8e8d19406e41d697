# Copyright 2026 soft_throw_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""The figures of docs/paper show the numbers of the models, and the files are current."""

import functools
import math
from pathlib import Path
import sys

import numpy as np
import pytest
from scipy.optimize import brentq
from soft_throw_ros.core.closed_form import first_release

pytest.importorskip('matplotlib', reason='the extra [plot]')

from matplotlib import image  # noqa: E402, I100
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402

sys.path.append(str(Path(__file__).parents[1] / 'docs' / 'paper'))  # it is not installed

from draw import DRAWINGS, path_of  # noqa: E402, I100
import fits  # noqa: E402
import style  # noqa: E402

DOCS = Path(__file__).parents[1] / 'docs'


@functools.cache
def drawn(name):
    """Draw a figure once for all tests."""
    with style.settings():
        figure = DRAWINGS[name]()
        canvas = FigureCanvasAgg(figure)
        figure.set_dpi(150)
        canvas.draw()
    return figure


def panels(name):
    """Return the axes without colour bars."""
    return [axes for axes in drawn(name).axes if axes.get_label() != '<colorbar>']


def line(axes, label):
    """Return x and y of the only line whose label starts with the given text."""
    (curve,) = [curve for curve in axes.lines if curve.get_label().startswith(label)]
    return curve.get_data()


@pytest.mark.parametrize(
    'name',
    [
        pytest.param(name, marks=[pytest.mark.slow] if name == 'recontacts' else [])
        for name in DRAWINGS
    ],
    scope='module',
)
def test_figure_in_docs_is_current_and_small(name):
    path = path_of(name, DOCS)
    assert path.stat().st_size < 250_000
    stored = image.imread(path)[:, :, :3]
    drawing = np.asarray(drawn(name).canvas.buffer_rgba())[:, :, :3] / 255.0
    assert stored.shape == drawing.shape
    # Text and edges may differ slightly between versions of matplotlib
    assert np.abs(stored - drawing).mean() < 0.01


@pytest.mark.parametrize(('name', 'damping_ratio'), [('fig3', 0.0), ('fig11', 0.064)])
def test_maps_are_the_exact_releases_of_equal_densities(name, damping_ratio):
    points = np.random.default_rng(4).uniform(0.02, 0.98, size=(40, 2))
    for axes, result in zip(panels(name), ('ejection_phase', 'energy_transfer'), strict=False):
        (picture,) = axes.images
        values = picture.get_array()
        assert picture.get_extent() == pytest.approx((0.0, 1.0, 0.0, 14.0), abs=1e-12)
        for row, column in (points * len(values)).astype(int):
            x, c = (column + 0.5) / len(values), 14.0 * (row + 0.5) / len(values)
            release = first_release(
                mass_ratio=(1.0 - x) / x, speed_ratio=c / x, damping_ratio=damping_ratio
            )
            assert values[row, column] == pytest.approx(getattr(release, result), rel=1e-9)


def test_fig7_has_the_spring_of_appendix_a_below_the_layers():
    phases, transfers = panels('fig7')
    q, alpha = line(transfers, 'spring')
    expected = (q / (q - 1.0) * np.sin(2.0 * np.pi / (q + 1.0))) ** 2
    np.testing.assert_allclose(alpha, expected, rtol=1e-9)
    np.testing.assert_allclose(line(phases, 'spring')[1], 1.0 / (1.0 + q), rtol=1e-12)
    highest = [
        np.nanmax(line(transfers, rf'layer, $\mu = m/\rho_s S L_s$ = {mu}')[1])
        for mu in ('0', 1, 4)
    ]
    assert highest == sorted(highest, reverse=True)
    assert highest[-1] > alpha.max() == pytest.approx(3.1274, abs=1e-4)


def test_plate_fit_recovers_the_true_parameters():
    values, errors = fits.fit_plate(*fits.plate_track())
    assert (np.abs(values - (0.0, 63.2, 2e-3, 0.064)) < 4.0 * errors).all()
    assert errors[1] < 0.05


def test_thick_layer_is_the_first_interval_of_the_wave():
    # Eq. (11), an independent formula: in contact V_m = 2 A omega (sin a - w cos a + w e^(-a/w)) /
    # (1 + w^2) with w = omega tau and the angle a. The projectile leaves at its largest speed.
    def speed(a, w):
        return 2.0 * (math.sin(a) - w * math.cos(a) + w * math.exp(-a / w)) / (1.0 + w * w)

    def slope(a, w):
        return math.cos(a) + w * math.sin(a) - math.exp(-a / w)

    angles, transfers, wide = panels('thick_layer')
    for axes in (transfers, wide):
        w, alpha = line(axes, 'exact')
        for i in (3, 100, 333):
            release = brentq(slope, 0.5 * math.pi, math.pi, args=(w[i],))
            assert alpha[i] == pytest.approx(speed(release, w[i]) ** 2, rel=1e-8)
    w, angle = line(angles, 'exact')
    release = brentq(slope, 0.5 * math.pi, math.pi, args=(w[200],))
    assert angle[200] == pytest.approx(release / math.pi, rel=1e-9)
