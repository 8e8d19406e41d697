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
"""Figs. 3, 4, 6 and 11, and where re-contacts are: all over thickness and wave speed."""

from __future__ import annotations

import functools

from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from models import best_layer, DAMPING_RATIO, FirstRelease, releases_at, releases_of, rig_of
import numpy as np
from numpy.typing import NDArray
from style import BLACK, BLUE, broken, C_LABEL, legend_below, new_figure, PAPER, show_map, X_LABEL

Floats = NDArray[np.float64]

POINTS = 420
"""Of a map along each axis: about one a dot."""

HIGHEST = 14.0
"""Upper end of C."""

_PHASES = np.arange(0.0, 1.21, 0.05)
_TRANSFERS = np.arange(0.0, 4.41, 0.2)
_CROSSINGS = np.arange(1.0, 10.1, 1.0)
_CHANGES = (-15.0, -10.0, -6.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 6.0, 10.0, 15.0)

_PLACES_OF_LABELS = (
    (0.85, 3.0), (0.72, 4.6), (0.66, 9.0), (0.53, 9.8), (0.43, 10.6), (0.35, 11.4), (0.3, 12.2),
)

PLACES = (np.arange(POINTS) + 0.5) / POINTS, HIGHEST * (np.arange(POINTS) + 0.5) / POINTS
"""Of a map, along x and along C."""


@functools.lru_cache(maxsize=2)
def landscape(damping_ratio: float) -> FirstRelease:
    """Compute the map of the paper: equal densities, no gravity, first releases; (x, C)."""
    x, c = PLACES
    return releases_at(x[:, None], c, damping_ratio=damping_ratio)


def crossings_until_release() -> Floats:
    """Return t_e / t_s over the map, with the harmonic plate."""
    x, c = PLACES
    return np.asarray(landscape(0.0).ejection_phase * c / x[:, None])


def draw_maps() -> Figure:
    """Draw Fig. 3: ejection time and energy transfer over x and C."""
    figure = new_figure(
        'Fig. 3   Sec. III: where a layer is worth most',
        'First release, harmonic plate. Projectile and layer are equally dense here; with the '
        "rig's ratio of 1.3\nthe optimum is elsewhere on these axes (see the table).",
        height=5.3,
    )
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    _show_phase(figure, panels[0], landscape(0.0))
    _show_transfer(figure, panels[1], landscape(0.0))
    axes = panels[1]
    along = np.linspace(0.0, 0.3, 100)
    axes.plot(
        along,
        10.2 * np.sqrt(along),
        color=PAPER['color'],
        ls='--',
        path_effects=[withStroke(linewidth=3.5, foreground='white')],
        label=r'paper: ridge $C = 10.2\sqrt{x}$ for small $x$',
    )
    axes.plot(
        [1.0, 1.0],
        [0.0, 7.9],
        color=PAPER['color'],
        lw=5.0,
        solid_capstyle='butt',
        clip_on=False,
        label=r'paper: $\alpha$ = 4 at $x$ = 1 up to $C$ = 7.9',
    )
    axes.plot(0.8, 6.7, **PAPER, label=r'paper: $\alpha$ = 4.12 at (0.8, 6.7)')
    _mark_optimum(axes, 0.0, 'largest of all')
    legend_below(figure, axes, columns=2)
    return figure


def best_over_c(x: Floats) -> tuple[Floats, Floats]:
    """Find the C of the largest energy transfer at every x, and that."""
    c = np.linspace(0.02, HIGHEST, 2800)
    alpha = np.asarray(releases_at(x[:, None], c).energy_transfer)
    best = alpha.argmax(axis=1)
    return c[best], alpha[np.arange(x.size), best]


def draw_best() -> Figure:
    """Draw Fig. 4: the best C, and the largest alpha that it gives, against x."""
    figure = new_figure(
        'Fig. 4   Sec. III: the best wave speed for every thickness',
        'Equal densities, harmonic plate, first release. Where the line is broken, another peak '
        'is the largest\nfrom there on: one for every wave interval of the release.',
        height=4.4,
    )
    panels = figure.subplots(1, 2)
    x = np.linspace(0.002, 0.998, 499)
    c, alpha = best_over_c(x)
    panels[0].plot(x, broken(c), color=BLUE, lw=2.0, label='largest over $C$')
    panels[1].plot(x, alpha, color=BLUE, lw=2.0, label='largest over $C$')
    along = np.linspace(0.0, 0.25, 100)
    ridge = r'paper, small $x$: $C = 10.2\sqrt{x}$, $\alpha$ = 3.13'
    panels[0].plot(along, 10.2 * np.sqrt(along), color=PAPER['color'], ls='--', label=ridge)
    panels[1].plot(along, np.full(along.shape, 3.13), color=PAPER['color'], ls='--')
    best = r'paper: $x$ = 0.8, $C$ = 6.7, $\alpha$ = 4.12'
    panels[0].plot(0.8, 6.7, **PAPER, label=best)
    panels[1].plot(0.8, 4.12, **PAPER)
    end = PAPER | {'marker': 'o', 'markersize': 7}
    label = r'paper: $x$ = 1, $\alpha$ = 4 up to $C$ = 7.9'
    panels[0].plot(1.0, 7.9, **end, clip_on=False, label=label)
    panels[1].plot(1.0, 4.0, **end, clip_on=False)
    panels[0].set(title='(a) best wave speed', ylabel=C_LABEL, ylim=(0.0, 9.0))
    panels[1].set(title='(b) largest energy transfer factor', ylabel=r'$\alpha$', ylim=(3.0, 4.3))
    for axes in panels:
        axes.set(xlabel=X_LABEL, xlim=(0.0, 1.0))
    legend_below(figure, panels[0], columns=2)
    return figure


def draw_crossings() -> Figure:
    """Draw Fig. 6: ejection time in crossings of the layer, and energy transfer."""
    figure = new_figure(
        'Fig. 6   Sec. IV: wave interval by wave interval',
        'Lines: release after a whole number of crossings, $t_e / t_s$. The paper writes out the '
        'two intervals up to $5\\,t_s$\nand stops there; the closed form goes on. Time and energy '
        'jump at 3, 5, 7 ... crossings.',
        height=5.3,
    )
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    crossings = crossings_until_release()
    x, c = PLACES
    image = show_map(
        panels[0], x, c, crossings, levels=_CROSSINGS, colours='viridis', extend='max'
    )
    figure.colorbar(image, ax=panels[0], label='$t_e / t_s$', pad=0.01)
    _label(panels[0], '(a) ejection time in crossings')
    _show_transfer(figure, panels[1], landscape(0.0), contours=False)
    for axes in panels:
        lines = axes.contour(
            x,
            c,
            crossings.T,
            levels=_CROSSINGS[1:8],
            colors='white',
            linewidths=[1.0, 2.0, 1.0, 2.0, 1.0, 1.0, 1.0],
        )
        axes.clabel(lines, fmt='%g', fontsize=9, manual=_PLACES_OF_LABELS)
    panels[0].plot([], [], color='0.6', lw=2.0, label=r'$t_e$ = 3 $t_s$ and 5 $t_s$')
    panels[1].plot(0.8, 6.7, **PAPER, label=r'paper: $\alpha$ = 4.12 between 3 $t_s$ and 5 $t_s$')
    legend_below(figure, *panels, columns=2)
    return figure


def draw_damped_maps() -> Figure:
    """Draw Fig. 11: the same for the damped plate, and what damping changes."""
    figure = new_figure(
        'Fig. 11   App. D: the maps of Fig. 3 with a damped plate',
        rf'$\zeta$ = {DAMPING_RATIO:g}, equal densities, first release. '
        r'$\alpha$ counts from the largest speed of the damped plate, Eq. (D4).',
        height=8.6,
    )
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    harmonic, damped = landscape(0.0), landscape(DAMPING_RATIO)
    _show_phase(figure, panels[0, 0], damped)
    _show_transfer(figure, panels[0, 1], damped)
    for axes, title, before, after in (
        (panels[1, 0], '(c) change of $t_e$', harmonic.ejection_phase, damped.ejection_phase),
        (
            panels[1, 1],
            r'(d) change of $\alpha$',
            harmonic.energy_transfer,
            damped.energy_transfer,
        ),
    ):
        change = 100.0 * (np.asarray(after) / before - 1.0)
        image = show_map(axes, *PLACES, change, levels=_CHANGES, colours='PuOr_r', extend='both')
        figure.colorbar(image, ax=axes, label='change by damping (%)', ticks=_CHANGES, pad=0.01)
        _label(axes, title)
    for axes in panels.flat:
        _mark_optimum(axes, 0.0, 'harmonic optimum', marker='o')
        _mark_optimum(axes, DAMPING_RATIO, 'damped optimum', marker='D')
    legend_below(figure, panels[0, 1], columns=2)
    return figure


def recontacts_at(x: float, c: float) -> tuple[int, float]:
    """Count re-contacts within 2.5 plate periods, and return the alpha of the last release."""
    rig = rig_of(mass_ratio=(1.0 - x) / x, speed_ratio=c / x)
    found = releases_of(rig, periods=2.5)
    return len(found) - 1, found[-1][1] ** 2


def draw_recontacts() -> Figure:
    """Draw where the layer catches up with the projectile, and what that gives."""
    figure = new_figure(
        'After the release   Where the layer catches up with the projectile',
        'Equal densities, harmonic plate that goes on, no gravity. Slow waves, well within $C$ < '
        '2, and thin stiff layers,\nwhere the last release, not the first, tends to that of a '
        'bare plate; besides, traces beside $t_e$ = 3 and 5 $t_s$.',
        height=5.0,
    )
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    x, c = (np.arange(100) + 0.5) / 100, HIGHEST * (np.arange(140) + 0.5) / 140
    found = np.array([[recontacts_at(each, at) for at in c] for each in x])
    count, last = found[..., 0], found[..., 1]
    blues = ListedColormap(['#f2f2f2', '#9ecae1', '#4292c6', '#08519c', '#041f4a'])
    image = panels[0].pcolormesh(
        x, c, np.minimum(count, 4.0).T, cmap=blues, vmin=-0.5, vmax=4.5, shading='nearest'
    )
    bar = figure.colorbar(image, ax=panels[0], label='contacts after the release', pad=0.01)
    bar.set_ticks(range(5), labels=['0', '1', '2', '3', '> 3'])
    image = show_map(panels[1], x, c, last, levels=_TRANSFERS, colours='cividis', extend='max')
    figure.colorbar(image, ax=panels[1], label=r'$\alpha$', pad=0.01)
    again = np.where(count > 0.0, 1.0, 0.0)
    panels[1].contour(x, c, again.T, levels=[0.5], colors='white', linewidths=0.8)
    for axes, title in zip(
        panels, ('(a) how often', r'(b) $\alpha$ of the last release'), strict=True
    ):
        _label(axes, title)
    return figure


def _show_phase(figure: Figure, axes: Axes, shown: FirstRelease) -> None:
    image = show_map(
        axes,
        *PLACES,
        np.asarray(shown.ejection_phase),
        levels=_PHASES,
        colours='magma',
        extend='max',
    )
    figure.colorbar(image, ax=axes, label='$t_e f$', pad=0.01)
    _label(axes, '(a) ejection time in plate periods')


def _show_transfer(
    figure: Figure, axes: Axes, shown: FirstRelease, *, contours: bool = True
) -> None:
    alpha = np.asarray(shown.energy_transfer)
    image = show_map(axes, *PLACES, alpha, levels=_TRANSFERS, colours='cividis')
    figure.colorbar(image, ax=axes, label=r'$\alpha$', pad=0.01)
    if contours:
        lines = axes.contour(
            *PLACES, alpha.T, levels=[1.0, 2.0, 3.0, 4.0], colors='black', linewidths=0.8
        )
        axes.clabel(lines, fmt='%g')
    _label(axes, '(b) energy transfer factor')


def _label(axes: Axes, title: str) -> None:
    axes.set(title=title, xlim=(0.0, 1.0), ylim=(0.0, HIGHEST), xlabel=X_LABEL, ylabel=C_LABEL)
    axes.label_outer()


def _mark_optimum(axes: Axes, damping_ratio: float, label: str, *, marker: str = '+') -> None:
    """Mark where the energy transfer is largest."""
    best = best_layer(damping_ratio)
    x = 1.0 / (1.0 + best.mass_ratio)
    c = best.speed_ratio * x
    axes.plot(
        x,
        c,
        marker,
        mfc='none',
        mec=BLACK,
        mew=1.4,
        ms=6,
        ls='none',
        zorder=6,
        label=rf'{label}: $\alpha$ = {best.energy_transfer:.3f} at ({x:.3f}, {c:.3f})',
    )
