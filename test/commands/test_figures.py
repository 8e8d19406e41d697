# SPDX-License-Identifier: Apache-2.0
"""The command `figures`: what is drawn is what the models say, and is fit to be shown."""

import functools
import importlib.util
import math
from pathlib import Path
import re

import numpy as np
import pytest
from scipy.optimize import brentq
from soft_throw_ros.commands import figures
from soft_throw_ros.commands.paper.catalogue import DRAWINGS
from soft_throw_ros.commands.paper.page import write_page
from soft_throw_ros.commands.paper.rig_series import SERIES, THICKNESSES
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.core.travelling_wave import first_release

pytest.importorskip('matplotlib', reason='the extra [plot]')

from matplotlib import image
from matplotlib.backends.backend_agg import FigureCanvasAgg
from soft_throw_ros.commands.paper import style

DOCS = Path(__file__).parents[2] / 'docs'
PAPER_FIGURES = [name for name in DRAWINGS if name != 'throw']


@functools.cache
def drawn(name):
    """Draw a figure, once for all tests, and lay it out."""
    with style.settings():
        figure = DRAWINGS[name].draw()
        canvas = FigureCanvasAgg(figure)
        figure.set_dpi(150)
        canvas.draw()
    return figure


@functools.cache
def pixels(name):
    """Return what is on the canvas: (height, width, red green blue) from 0 to 1."""
    return np.asarray(drawn(name).canvas.buffer_rgba())[:, :, :3] / 255.0


def panels(name):
    """Return the axes that are no colour bars."""
    return [axes for axes in drawn(name).axes if axes.get_label() != '<colorbar>']


def line(axes, label):
    """Return x and y of the only line whose label begins so."""
    (found,) = [each for each in axes.lines if each.get_label().startswith(label)]
    return found.get_data()


def curve(axes, color, size):
    """Return x and y of the only line of this colour and number of points."""
    (found,) = [
        each for each in axes.lines if each.get_color() == color and len(each.get_xdata()) == size
    ]
    return found.get_data()


def release_at(x, c, damping_ratio=0.0, density_ratio=1.0):
    return first_release(
        mass_ratio=density_ratio * (1.0 - x) / x, speed_ratio=c / x, damping_ratio=damping_ratio
    )


def refused(capsys, *args):
    with pytest.raises(SystemExit) as end:
        figures.main(list(args))
    assert end.value.code == 2
    return capsys.readouterr().err.splitlines()[-1]


# How they look


@pytest.mark.parametrize('name', DRAWINGS)
def test_figure_shows_something_in_colour_and_much_white(name):
    picture = pixels(name)
    white = (picture > 0.99).all(axis=2).mean()
    coloured = (np.ptp(picture, axis=2) > 0.2).mean()
    assert 0.1 < white < 0.97
    assert coloured > 0.002


@pytest.mark.parametrize('name', DRAWINGS)
def test_nothing_is_cut_off_and_no_legend_hides_data(name):
    figure = drawn(name)
    shown = figure.get_window_extent()
    texts = [figure._suptitle] if figure._suptitle else []
    for axes in figure.axes:
        texts += [axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label, *axes.texts]
    for text in texts:
        if text.get_text() and text.get_visible():
            box = text.get_window_extent()
            assert shown.x0 <= box.x0 < box.x1 <= shown.x1 + 1.0, text.get_text()
            assert shown.y0 <= box.y0 < box.y1 <= shown.y1 + 1.0, text.get_text()
    for legend in figure.legends:
        box = legend.get_window_extent()
        assert shown.x0 <= box.x0 < box.x1 <= shown.x1
        assert not any(axes.get_window_extent().overlaps(box) for axes in figure.axes)


@pytest.mark.parametrize('name', PAPER_FIGURES)
def test_figure_has_its_name_a_caption_and_symbols_or_units_at_its_axes(name):
    title, _, caption = drawn(name)._suptitle.get_text().partition('\n')
    number = name.removeprefix('fig')
    assert re.match(rf'\$\\mathbf\{{Fig\.\\ {number}\\ ', title)
    assert len(caption) > 40
    outer = [axes for axes in panels(name) if axes.get_subplotspec().is_first_col()]
    assert outer
    for axes in outer:
        assert re.search(r'\$|\(\w', axes.get_ylabel()), axes.get_title()
    for axes in panels(name):
        if name != 'fig1' and axes.get_subplotspec().is_last_row():
            assert '$' in axes.get_xlabel(), axes.get_title()


def test_no_text_is_smaller_than_can_be_read_in_a_readme():
    # A README shows 1260 dots as some 830
    for name in DRAWINGS:
        for axes in drawn(name).axes:
            sizes = [
                text.get_size()
                for text in (axes.title, axes._left_title, axes.xaxis.label, *axes.texts)
                if text.get_text()
            ]
            sizes += [tick.label1.get_size() for tick in axes.xaxis.get_major_ticks()]
            assert min(sizes, default=8.0) >= 8.0


# What they show


def test_fig1_shows_plate_layer_and_projectiles_where_they_are():
    rig = SERIES[1].rig(16.8e-3, damping_ratio=0.064)
    throw = simulate(rig, until=0.016)
    bare = throw.history.motion.peak_velocity_time
    for axes in panels('fig1'):
        moment = 1e-3 * float(re.search(r't\$ = ([\d.]+) ms', axes.get_title()).group(1))
        on_layer, on_plate, plate = axes.patches
        path = throw.trajectory(moment)
        assert on_layer.get_y() == pytest.approx(1e3 * path.projectile_position, abs=0.1)
        assert plate.get_y() + plate.get_height() == pytest.approx(
            1e3 * path.plate_position, abs=0.05
        )
        late = max(moment - bare, 0.0)
        alone = throw.history.motion.position(min(moment, bare)) + late * throw.peak_plate_speed
        assert on_plate.get_y() == pytest.approx(1e3 * alone, abs=0.05)
        (layer,) = axes.collections
        heights = layer.get_coordinates()[:, 0, 1]
        assert heights[0] == pytest.approx(1e3 * path.plate_position, abs=0.05)
        assert heights[-1] == pytest.approx(1e3 * path.top_position, abs=0.1)


def test_fig2_follows_the_throw():
    throw = simulate(SERIES[1].rig(16.8e-3, damping_ratio=0.064), until=0.016)
    heights, speeds = panels('fig2')
    for axes, plate, projectile in (
        (heights, 'plate_position', 'projectile_position'),
        (speeds, 'plate_velocity', 'projectile_velocity'),
    ):
        for label, name in (('plate', plate), ('projectile on layer', projectile)):
            time, values = line(axes, label)
            expected = getattr(throw.trajectory(1e-3 * time), name)
            if axes is heights:
                expected = 1e3 * (expected - expected[0])
            np.testing.assert_allclose(values, expected, atol=1e-12)
    text = speeds.texts[0].get_text()
    assert f'{1e3 * throw.ejection_time:.3f} ms' in text
    assert f'= {throw.energy_transfer:.3f}' in text


@pytest.mark.parametrize(('name', 'damping_ratio'), [('fig3', 0.0), ('fig11', 0.064)])
def test_curves_of_the_series_are_the_exact_releases(name, damping_ratio):
    for series, color in zip(SERIES, (style.BLUE, style.ORANGE, style.GREEN), strict=True):
        for axes, result in zip(panels(name), ('ejection_phase', 'energy_transfer'), strict=False):
            found = [
                each.get_data()
                for each in axes.lines
                if each.get_color() == color and len(each.get_xdata()) > 1000
            ]
            x, values = found[-1]
            for i in (40, 301, 700, 1100):
                speed = 7.8 / (series.projectile_length * series.frequency)
                release = release_at(x[i], speed * (1.0 - x[i]), damping_ratio, 1.3)
                assert values[i] == pytest.approx(getattr(release, result), rel=1e-9)


@pytest.mark.parametrize(('name', 'damping_ratio'), [('fig3', 0.0), ('fig11', 0.064)])
def test_points_of_the_series_are_the_layers_with_an_elastic_projectile(name, damping_ratio):
    phase, transfer = panels(name)[:2]
    for series, bars_phase, bars_transfer in zip(
        SERIES, phase.containers, transfer.containers, strict=True
    ):
        assert f'= {series.speed:.1f}' in bars_phase.get_label()
        x, phases = bars_phase.lines[0].get_data()
        _, transfers = bars_transfer.lines[0].get_data()
        np.testing.assert_allclose(x, THICKNESSES / (THICKNESSES + series.projectile_length))
        for i, thickness in enumerate(THICKNESSES):
            rigid = first_release(
                mass_ratio=1.3 * series.projectile_length / thickness,
                speed_ratio=7.8 / (thickness * series.frequency),
                damping_ratio=damping_ratio,
            )
            # A rigid projectile is 1e-5 off; twice that in alpha
            assert phases[i] == pytest.approx(rigid.ejection_phase, rel=2e-5)
            assert transfers[i] == pytest.approx(rigid.energy_transfer, rel=5e-5)
            assert transfers[i] != rigid.energy_transfer


def test_error_bars_are_those_of_linear_propagation_where_nothing_jumps():
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


def test_dots_of_fig3_are_last_releases_that_tend_to_a_bare_plate():
    phase, transfer = panels('fig3')
    color = style.GREEN
    (dots_phase,), (dots_transfer,) = (
        [each for each in axes.lines if each.get_marker() == '.' and each.get_color() == color]
        for axes in (phase, transfer)
    )
    x, phases = dots_phase.get_data()
    _, transfers = dots_transfer.get_data()
    series = SERIES[2]
    i = len(x) // 2
    thickness = series.projectile_length * x[i] / (1.0 - x[i])
    throw = simulate(series.rig(thickness, damping_ratio=0.0), until=2.0 / series.frequency)
    assert throw.recontacts > 0
    assert phases[i] == pytest.approx(throw.last_release.time * series.frequency, abs=1e-5)
    assert transfers[i] == pytest.approx(throw.last_energy_transfer, abs=1e-5)
    for axes, bare, values in ((phase, 0.25, phases), (transfer, 1.0, transfers)):
        place, value = line(axes, 'paper: no layer')
        assert (place[0], value[0]) == (0.0, bare)
        assert np.abs(values - bare).max() < 0.4 * bare


@pytest.mark.parametrize(('name', 'damping_ratio'), [('fig4', 0.0), ('fig12', 0.064)])
def test_maps_are_the_exact_releases_of_equal_densities(name, damping_ratio):
    places = np.random.default_rng(4).uniform((0.02, 0.3), (0.98, 13.9), size=(40, 2))
    for axes, result in zip(panels(name), ('ejection_phase', 'energy_transfer'), strict=False):
        (shown,) = axes.images
        values = shown.get_array()
        left, right, bottom, top = shown.get_extent()
        assert (left, right, bottom, top) == pytest.approx((0.0, 1.0, 0.0, 14.0), abs=1e-12)
        for x, c in places:
            row, column = int(c / 14.0 * len(values)), int(x * len(values))
            middle = (column + 0.5) / len(values), 14.0 * (row + 0.5) / len(values)
            expected = getattr(release_at(*middle, damping_ratio), result)
            assert values[row, column] == pytest.approx(expected, rel=1e-9)
        assert axes.get_xlim() == (0.0, 1.0)
        assert axes.get_ylim() == (0.0, 14.0)


def test_fig4_marks_what_the_paper_says_and_the_highest_point():
    axes = panels('fig4')[1]
    x, c = line(axes, 'paper: ridge')
    np.testing.assert_allclose(c, 10.2 * np.sqrt(x))
    assert line(axes, r'paper: $\alpha$ = 4.12') == ([0.8], [6.7])
    (x,), (c,) = line(axes, 'largest of all')
    assert (x, c) == pytest.approx((0.8102, 6.678), abs=5e-4)
    assert axes.images[0].get_array().max() == pytest.approx(release_at(x, c)[2], abs=1e-3)


def test_fig5_is_the_first_interval_of_the_wave_and_its_limits():
    # In contact V_m = 2 A w (sin a - w cos a + w e^(-a/w)) / (1 + w^2), w for w tau, a for the
    # angle: Eq. (11), which says nothing of how the others are computed. It leaves at the top.
    def speed(a, w):
        return 2.0 * (math.sin(a) - w * math.cos(a) + w * math.exp(-a / w)) / (1.0 + w * w)

    def slope(a, w):
        return math.cos(a) + w * math.sin(a) - math.exp(-a / w)

    angles, transfers, wide = panels('fig5')
    for axes in (transfers, wide):
        w, alpha = line(axes, 'exact')
        for i in (3, 100, 333):
            leaves = brentq(slope, 0.5 * math.pi, math.pi, args=(w[i],))
            assert alpha[i] == pytest.approx(speed(leaves, w[i]) ** 2, rel=1e-8)
    w, angle = line(angles, 'exact')
    leaves = brentq(slope, 0.5 * math.pi, math.pi, args=(w[200],))
    assert angle[200] == pytest.approx(leaves / math.pi, rel=1e-9)
    w, large = line(wide, 'App. C(ii)')
    np.testing.assert_allclose(large, 16.0 / w**2)
    w, mended = line(transfers, 'App. C(i)')
    _, as_printed = line(transfers, 'the same')
    _, exact = line(transfers, 'exact')
    small = w < 0.2
    off = np.abs(exact - mended)[small].max(), np.abs(exact - as_printed)[small].max()
    assert off[0] < 0.25 * off[1]


def test_fig6_shows_intervals_by_colour_and_the_optimum():
    crossings, transfers = panels('fig6')
    for label, low, high in (('before', 1.0, 3.0), ('from', 3.0, 5.0), ('after', 5.0, 99.0)):
        for shown in [each for each in crossings.lines if each.get_label().startswith(label)]:
            values = shown.get_ydata()
            inside = values[np.isfinite(values)]
            assert ((inside >= low) & (inside <= high)).all()
    c, alpha = line(transfers, 'from')
    best = np.nanargmax(alpha)
    assert c[best] == pytest.approx(6.678, abs=0.01)
    assert alpha[best] == pytest.approx(4.1232, abs=1e-4)
    c, alpha = line(transfers, 'thick soft layer')
    flat = (c > 1.0) & (c < 7.9)
    np.testing.assert_allclose(alpha[flat], 4.0, atol=1e-3)
    i = len(c) // 2
    assert alpha[i] == first_release(mass_ratio=1e-3, speed_ratio=c[i]).energy_transfer


def test_fig7_has_the_spring_of_appendix_a_and_layers_above_it():
    phases, transfers = panels('fig7')
    q, alpha = line(transfers, 'spring')
    expected = (q / (q - 1.0) * np.sin(2.0 * np.pi / (q + 1.0))) ** 2
    np.testing.assert_allclose(alpha, expected, rtol=1e-9)
    np.testing.assert_allclose(line(phases, 'spring')[1], 1.0 / (1.0 + q), rtol=1e-12)
    assert line(transfers, 'paper') == ([1.62], [3.13])
    highest = [
        np.nanmax(line(transfers, rf'layer, $\mu = m/\rho_s S L_s$ = {mu}')[1])
        for mu in ('0', 1, 4)
    ]
    assert highest == sorted(highest, reverse=True)
    assert highest[-1] > alpha.max() == pytest.approx(3.1274, abs=1e-4)


def test_fig11_has_the_largest_strains():
    axes = panels('fig11')[2]
    for series, shown in zip(SERIES, axes.lines, strict=False):
        _, strains = shown.get_data()
        for i in (0, 3):
            rig = series.rig(THICKNESSES[i], damping_ratio=0.064)
            expected = simulate(rig, max_events=1).peak_strain.value
            assert strains[i] == pytest.approx(100.0 * expected, rel=1e-7)


def test_strains_without_damping_are_the_exact_ones():
    # Computed with 40 digits: 63.2 Hz, 16.3 mm
    strains = SERIES[0].peak_strains(damping_ratio=0.0)
    np.testing.assert_allclose(strains[:2], (0.20455695137, 0.18543981233), rtol=1e-8)


def test_fig12_shows_what_damping_changes():
    for axes, result in zip(panels('fig12')[2:], (0, 2), strict=True):
        (shown,) = axes.images
        values = shown.get_array()
        x, c = (200.5 / len(values)), 14.0 * 300.5 / len(values)
        change = release_at(x, c, 0.064)[result] / release_at(x, c)[result] - 1.0
        assert values[300, 200] == pytest.approx(100.0 * change, abs=1e-9)


def test_line_is_broken_where_values_jump_and_nowhere_else():
    smooth = np.sin(np.linspace(0.0, 6.0, 300))
    assert np.isfinite(style.broken(smooth)).all()
    jumps = smooth + (np.arange(300) >= 120) * 0.1
    (lost,) = np.flatnonzero(np.isnan(style.broken(jumps)))
    assert lost == 120


# The files


@pytest.mark.parametrize('kind', figures.FORMATS)
def test_a_figure_is_the_same_bytes_every_time(tmp_path, kind, capsys):
    written = []
    for folder in (tmp_path / 'a', tmp_path / 'b' / 'c'):
        assert figures.main(['--output', str(folder), '--only', 'fig7', '--format', kind]) == 0
        (path,) = folder.rglob('*.*')
        assert path == folder / f'paper/fig7.{kind}'
        assert capsys.readouterr().out == f'{path}\n'
        written.append(path.read_bytes())
    assert written[0] == written[1]
    assert written[0][:5] == {'png': b'\x89PNG\r', 'pdf': b'%PDF-', 'svg': b'<?xml'}[kind]


def test_what_is_chosen_is_written_in_our_order(tmp_path, capsys):
    args = ['--output', str(tmp_path), '--only', 'page,fig7, fig1', '--format', 'svg']
    assert figures.main(args) == 0
    printed = capsys.readouterr().out.split()
    assert printed == [
        f'{tmp_path}/{name}' for name in ('paper/fig1.svg', 'paper/fig7.svg', 'paper.md')
    ]
    assert '](paper/fig12.svg)' in (tmp_path / 'paper.md').read_text()


def test_refusals_are_one_line(tmp_path, capsys):
    line = refused(capsys, '--only', 'fig3,fig9')
    assert "'fig9'" in line
    assert 'fig12' in line
    assert "'gif'" in refused(capsys, '--format', 'gif')
    (tmp_path / 'file').touch()
    line = refused(capsys, '--output', str(tmp_path / 'file'), '--only', 'page')
    assert 'file' in line
    assert 'Traceback' not in line


def test_without_matplotlib_there_are_numbers_only(tmp_path, monkeypatch, capsys):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, 'find_spec', lambda name: None if name == 'matplotlib' else find(name)
    )
    assert 'soft_throw_ros[plot]' in refused(capsys, '--output', str(tmp_path))
    assert not list(tmp_path.iterdir())
    assert figures.main(['--output', str(tmp_path), '--only', 'page']) == 0
    assert (tmp_path / 'paper.md').read_text() == write_page('png')


def test_ctrl_c_ends_it_quietly(tmp_path, monkeypatch, capsys):
    def interrupted(_kind):
        raise KeyboardInterrupt

    monkeypatch.setattr(figures, 'write_page', interrupted)
    assert figures.main(['--output', str(tmp_path), '--only', 'page']) == 130
    assert capsys.readouterr().err == 'figures: stopped\n'
    assert not list(tmp_path.iterdir())


def test_page_in_docs_is_current():
    assert (DOCS / 'paper.md').read_text(encoding='utf-8') == write_page('png')


@pytest.mark.parametrize('name', DRAWINGS)
def test_figure_in_docs_is_current_and_small(name):
    path = DOCS / DRAWINGS[name].path('png')
    assert path.stat().st_size < 250_000
    shown = image.imread(path)[:, :, :3]
    assert shown.shape == pixels(name).shape
    # Letters and edges may come out a little different with another matplotlib
    assert np.abs(shown - pixels(name)).mean() < 0.01
