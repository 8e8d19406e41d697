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

from draw import ANIMATION, DRAWINGS, path_of  # noqa: E402, I100
import fits  # noqa: E402
from models import SERIES, THICKNESSES  # noqa: E402
import style  # noqa: E402
from throws import END, STEP  # noqa: E402

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


def release_at(x, c, damping_ratio=0.0, density_ratio=1.0):
    return first_release(
        mass_ratio=density_ratio * (1.0 - x) / x, speed_ratio=c / x, damping_ratio=damping_ratio
    )


@pytest.mark.parametrize('name', DRAWINGS, scope='module')
def test_figure_in_docs_is_current_and_small(name):
    path = path_of(name, DOCS)
    assert path.stat().st_size < 250_000
    stored = image.imread(path)[:, :, :3]
    drawing = np.asarray(drawn(name).canvas.buffer_rgba())[:, :, :3] / 255.0
    assert stored.shape == drawing.shape
    # Text and edges may differ slightly between versions of matplotlib
    assert np.abs(stored - drawing).mean() < 0.01


def test_animation_in_docs_shows_the_whole_throw_and_is_small():
    pictures = pytest.importorskip('PIL.Image')
    path = path_of(ANIMATION, DOCS)
    assert path.stat().st_size < 2_000_000
    with pictures.open(path) as animation:
        assert animation.n_frames == 1 + round(END / STEP)
        assert animation.info['loop'] == 0
        animation.seek(animation.n_frames - 1)
        assert animation.info['duration'] >= 1000  # the last picture stays [ms]


@pytest.mark.parametrize(('name', 'damping_ratio'), [('fig3', 0.0), ('fig11', 0.064)])
def test_maps_are_the_exact_releases_of_equal_densities(name, damping_ratio):
    points = np.random.default_rng(4).uniform((0.02, 0.3), (0.98, 13.9), size=(40, 2))
    for axes, result in zip(panels(name), ('ejection_phase', 'energy_transfer'), strict=False):
        (picture,) = axes.images
        values = picture.get_array()
        assert picture.get_extent() == pytest.approx((0.0, 1.0, 0.0, 14.0), abs=1e-12)
        for x, c in points:
            row, column = int(c / 14.0 * len(values)), int(x * len(values))
            middle = (column + 0.5) / len(values), 14.0 * (row + 0.5) / len(values)
            expected = getattr(release_at(*middle, damping_ratio), result)
            assert values[row, column] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(('name', 'damping_ratio'), [('fig5', 0.0), ('fig12', 0.064)])
def test_series_are_exact_releases_and_their_points_agree(name, damping_ratio):
    for axes, result in zip(panels(name), ('ejection_phase', 'energy_transfer'), strict=False):
        for series, color, bars in zip(
            SERIES, (style.BLUE, style.ORANGE, style.GREEN), axes.containers, strict=True
        ):
            curves = [
                curve.get_data()
                for curve in axes.lines
                if curve.get_color() == color and len(curve.get_xdata()) > 1000
            ]
            x, values = curves[-1]
            for i in (40, 301, 700, 1100):
                release = release_at(x[i], series.speed * (1.0 - x[i]), damping_ratio, 1.3)
                assert values[i] == pytest.approx(getattr(release, result), rel=1e-9)
            x, values = np.asarray(bars.lines[0].get_data(), dtype=np.float64)
            np.testing.assert_allclose(x, THICKNESSES / (THICKNESSES + series.projectile_length))
            rigid = series.releases(THICKNESSES, damping_ratio=damping_ratio)
            np.testing.assert_allclose(values, getattr(rigid, result), rtol=4e-4)


def test_error_bars_match_linear_propagation_without_jumps():
    # 5.6 mm of the second series: wave speed, thickness and frequency one by one
    series = SERIES[1]
    base = {'thickness': 5.6e-3, 'wave_speed': 7.8, 'frequency': 63.2}

    def transfer(thickness, wave_speed, frequency):
        return first_release(
            mass_ratio=1.3 * series.projectile_length / thickness,
            speed_ratio=wave_speed / (thickness * frequency),
        ).energy_transfer

    variance = sum(
        (0.5 * (transfer(**base | {k: base[k] + d}) - transfer(**base | {k: base[k] - d}))) ** 2
        for k, d in (('thickness', 1e-4), ('wave_speed', 0.3), ('frequency', 0.1))
    )
    bars = series.errors(damping_ratio=0.0).energy_transfer[:, 1]
    # quantiles of 2000 draws are known to 4 %
    np.testing.assert_allclose(bars, math.sqrt(variance), rtol=0.15)


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


def test_line_is_broken_only_where_values_jump():
    smooth = np.sin(np.linspace(0.0, 6.0, 300))
    assert np.isfinite(style.broken(smooth)).all()
    jumps = smooth + (np.arange(300) >= 120) * 0.1
    (gap,) = np.flatnonzero(np.isnan(style.broken(jumps)))
    assert gap == 120
