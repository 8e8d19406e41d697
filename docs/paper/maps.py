# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figs. 3, 4, 6 and 11: results over thickness and wave speed."""

from __future__ import annotations

from collections.abc import Sequence
import functools
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from models import best_ratios, DAMPING_RATIO, releases_at, SERIES
import numpy as np
from numpy.typing import ArrayLike
from soft_throw_ros.core.closed_form import FirstRelease
from style import BLACK, BLUE, broken, C_LABEL, legend_below, new_figure, PAPER, RED, X_LABEL

_C_END = 14.0
_GRID = (np.arange(420) + 0.5) / 420, _C_END * (np.arange(420) + 0.5) / 420  # x and C, per dot

# Levels of ejection time, energy transfer, crossings and changes, and positions of labels
_PHASES, _TRANSFERS = np.arange(0.0, 1.21, 0.05), np.arange(0.0, 4.41, 0.2)
_CROSSINGS = np.arange(1.0, 10.1, 1.0)
_CHANGES = (-15.0, -10.0, -6.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 6.0, 10.0, 15.0)
_LABELS = (
    (0.85, 3.0), (0.72, 4.6), (0.66, 9.0), (0.53, 9.8), (0.43, 10.6), (0.35, 11.4), (0.3, 12.2),
)


@functools.lru_cache(maxsize=2)
def _landscape(damping_ratio: float) -> FirstRelease:
    """Compute the first releases of the paper's map over (x, C)."""
    return releases_at(_GRID[0][:, None], _GRID[1], damping_ratio=damping_ratio)


def _show(
    axes: Axes, title: str, values: ArrayLike, label: str, levels: Sequence[float], colours: str,
    *, extend: Any = 'neither', ticks: Sequence[float] | None = None,
) -> None:
    """Show values of shape (x, C) as bands of colour between levels, with a colour bar."""
    bands = mpl.colormaps[colours]
    image = axes.imshow(
        np.asarray(values).T, origin='lower', aspect='auto', interpolation='nearest',
        extent=(0.0, 1.0, 0.0, _C_END), cmap=bands,
        norm=BoundaryNorm(levels, bands.N, extend=extend),
    )
    axes.figure.colorbar(image, ax=axes, label=label, ticks=ticks, pad=0.01)
    axes.set(title=title, xlim=(0.0, 1.0), ylim=(0.0, _C_END), xlabel=X_LABEL, ylabel=C_LABEL)
    axes.label_outer()


def _show_phase(axes: Axes, releases: FirstRelease) -> None:
    title = '(a) ejection time in plate periods'
    _show(axes, title, releases.ejection_phase, '$t_e f$', _PHASES, 'magma', extend='max')


def _show_transfer(axes: Axes, releases: FirstRelease, *, contours: bool = True) -> None:
    alpha = np.asarray(releases.energy_transfer)
    _show(axes, '(b) energy transfer factor', alpha, r'$\alpha$', _TRANSFERS, 'cividis')
    if contours:
        levels = [1.0, 2.0, 3.0, 4.0]
        lines = axes.contour(*_GRID, alpha.T, levels=levels, colors='black', linewidths=0.8)
        axes.clabel(lines, fmt='%g')


def _draw_series(axes: Axes) -> None:
    """Draw the three series: layers of one material and any thickness lie on one line."""
    for series, style in zip(SERIES, ('-', '--', '-.'), strict=True):
        axes.plot(
            [0.0, 1.0], [series.speed, 0.0], ls=style, lw=1.4, color='white',
            antialiased=False,  # smooth edges increase the size of the file by half
            path_effects=[withStroke(linewidth=2.6, foreground=BLACK)],
            label=f'series: $C = (1 - x)\\,c_s/L_r f$ = {series.speed:.3g} $(1 - x)$',
        )


def _mark_optimum(axes: Axes, damping_ratio: float, label: str, *, marker: str = '+') -> None:
    """Mark the layer with the largest energy transfer."""
    best = best_ratios(damping_ratio)
    x = 1.0 / (1.0 + best.mass_ratio)
    c = best.speed_ratio * x
    axes.plot(
        x, c, marker, mfc='none', mec=BLACK, mew=1.4, ms=6, ls='none', zorder=6,
        label=rf'{label}: $\alpha$ = {best.energy_transfer:.3f} at ({x:.3f}, {c:.3f})',
    )


def draw_maps() -> Figure:
    """Draw Fig. 3: ejection time and energy transfer over x and C."""
    figure, panels = new_figure(
        'Fig. 3   Sec. III: where a layer is worth most',
        'First release, harmonic plate. Projectile and layer are equally dense here; with the '
        "rig's ratio of 1.3\nthe optimum is elsewhere on these axes (see the table).",
        height=5.3, sharex=True, sharey=True,
    )
    _show_phase(panels[0], _landscape(0.0))
    _show_transfer(panels[1], _landscape(0.0))
    axes = panels[1]
    x = np.linspace(0.0, 0.3, 100)
    axes.plot(
        x, 10.2 * np.sqrt(x), color=RED, ls='--',
        path_effects=[withStroke(linewidth=3.5, foreground='white')],
        label=r'paper: ridge $C = 10.2\sqrt{x}$ for small $x$',
    )
    axes.plot(
        [1.0, 1.0], [0.0, 7.9], color=RED, lw=5.0, solid_capstyle='butt', clip_on=False,
        label=r'paper: $\alpha$ = 4 at $x$ = 1 up to $C$ = 7.9',
    )
    axes.plot(0.8, 6.7, **PAPER, label=r'paper: $\alpha$ = 4.12 at (0.8, 6.7)')
    _mark_optimum(axes, 0.0, 'largest of all')
    for axes in panels:
        _draw_series(axes)
    return legend_below(figure, panels[1], columns=2)


def draw_best() -> Figure:
    """Draw Fig. 4: the best C for every x, and its energy transfer."""
    figure, panels = new_figure(
        'Fig. 4   Sec. III: the best wave speed for every thickness',
        'Equal densities, harmonic plate, first release. Where the line is broken, another peak '
        'is the largest\nfrom there on: one for every wave interval of the release.',
        height=4.4,
    )
    x, c = np.linspace(0.002, 0.998, 499), np.linspace(0.02, _C_END, 2800)
    alpha = np.asarray(releases_at(x[:, None], c).energy_transfer)
    best_c = broken(c[alpha.argmax(axis=1)])
    ridge_x, end = np.linspace(0.0, 0.25, 100), PAPER | {'marker': 'o', 'markersize': 7}
    for axes, best, ridge, optimum, limit in (
        (panels[0], best_c, 10.2 * np.sqrt(ridge_x), 6.7, 7.9),
        (panels[1], alpha.max(axis=1), np.full(ridge_x.shape, 3.13), 4.12, 4.0),
    ):
        axes.plot(x, best, color=BLUE, lw=2.0, label='largest over $C$')
        axes.plot(ridge_x, ridge, color=RED, ls='--',
                  label=r'paper, small $x$: $C = 10.2\sqrt{x}$, $\alpha$ = 3.13')
        axes.plot(0.8, optimum, **PAPER, label=r'paper: $x$ = 0.8, $C$ = 6.7, $\alpha$ = 4.12')
        axes.plot(1.0, limit, **end, clip_on=False,
                  label=r'paper: $x$ = 1, $\alpha$ = 4 up to $C$ = 7.9')
        axes.set(xlabel=X_LABEL, xlim=(0.0, 1.0))
    panels[0].set(title='(a) best wave speed', ylabel=C_LABEL, ylim=(0.0, 9.0))
    panels[1].set(title='(b) largest energy transfer factor', ylabel=r'$\alpha$', ylim=(3.0, 4.3))
    return legend_below(figure, panels[0], columns=2)


def draw_crossings() -> Figure:
    """Draw Fig. 6: ejection time in crossings of the layer, and energy transfer."""
    figure, panels = new_figure(
        'Fig. 6   Sec. IV: wave interval by wave interval',
        'Lines: release after a whole number of crossings, $t_e / t_s$. The paper writes out the '
        'two intervals up to $5\\,t_s$\nand stops there; the closed form goes on. Time and energy '
        'jump at 3, 5, 7 ... crossings.',
        height=5.3, sharex=True, sharey=True,
    )
    x, c = _GRID
    crossings = np.asarray(_landscape(0.0).ejection_phase * c / x[:, None])
    _show(panels[0], '(a) ejection time in crossings', crossings, '$t_e / t_s$',
          _CROSSINGS, 'viridis', extend='max')
    _show_transfer(panels[1], _landscape(0.0), contours=False)
    for axes in panels:
        lines = axes.contour(x, c, crossings.T, levels=_CROSSINGS[1:8], colors='white',
                             linewidths=[1.0, 2.0, 1.0, 2.0, 1.0, 1.0, 1.0])
        axes.clabel(lines, fmt='%g', fontsize=9, manual=_LABELS)
    panels[0].plot([], [], color='0.6', lw=2.0, label=r'$t_e$ = 3 $t_s$ and 5 $t_s$')
    panels[1].plot(0.8, 6.7, **PAPER, label=r'paper: $\alpha$ = 4.12 between 3 $t_s$ and 5 $t_s$')
    return legend_below(figure, *panels, columns=2)


def draw_damped_maps() -> Figure:
    """Draw Fig. 11: the maps with a damped plate, and the changes caused by damping."""
    figure, panels = new_figure(
        'Fig. 11   App. D: the maps of Fig. 3 with a damped plate',
        rf'$\zeta$ = {DAMPING_RATIO:g}, equal densities, first release. '
        r'$\alpha$ counts from the largest speed of the damped plate, Eq. (D4).',
        height=8.6, grid=(2, 2), sharex=True, sharey=True,
    )
    harmonic, damped = _landscape(0.0), _landscape(DAMPING_RATIO)
    _show_phase(panels[0, 0], damped)
    _show_transfer(panels[0, 1], damped)
    for axes, title, name in zip(
        panels[1], ('(c) change of $t_e$', r'(d) change of $\alpha$'),
        ('ejection_phase', 'energy_transfer'), strict=True,
    ):
        change = 100.0 * (np.asarray(getattr(damped, name)) / getattr(harmonic, name) - 1.0)
        _show(axes, title, change, 'change by damping (%)', _CHANGES, 'PuOr_r',
              extend='both', ticks=_CHANGES)
    for axes in panels.flat:
        _mark_optimum(axes, 0.0, 'harmonic optimum', marker='o')
        _mark_optimum(axes, DAMPING_RATIO, 'damped optimum', marker='D')
    _draw_series(panels[0, 1])
    return legend_below(figure, panels[0, 1], columns=2)
