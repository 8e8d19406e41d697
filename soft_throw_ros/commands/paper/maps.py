# SPDX-License-Identifier: Apache-2.0
"""Figs. 4 and 12: maps over thickness and wave speed, harmonic and damped."""

from __future__ import annotations

import functools

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.commands.paper.rig_series import DAMPING_RATIO
from soft_throw_ros.commands.paper.style import (
    legend_below,
    new_figure,
    PAPER,
    show_map,
)
from soft_throw_ros.core.rig import Engine, Rig
from soft_throw_ros.design.landscape import AXES, compute_landscape, Landscape
from soft_throw_ros.design.recommendation import best_ratios

Floats = NDArray[np.float64]

POINTS = 420
"""Of a map along each axis: about one a dot."""

HIGHEST = 14.0
"""Upper end of C."""

_PHASES = np.arange(0.0, 1.21, 0.05)
_TRANSFERS = np.arange(0.0, 4.41, 0.2)
_CHANGES = (-15.0, -10.0, -6.0, -4.0, -2.0, -1.0, 1.0, 2.0, 4.0, 6.0, 10.0, 15.0)


@functools.lru_cache(maxsize=2)
def landscape(damping_ratio: float) -> Landscape:
    """Compute the map of the paper: equal densities, no gravity, first releases."""
    halves = (np.arange(POINTS) + 0.5) / POINTS
    return compute_landscape(
        Rig(engine=Engine(damping_ratio=damping_ratio), gravity=0.0),
        {'x': halves, 'C': HIGHEST * halves},
        density_ratio=1.0,
    )


def draw_maps() -> Figure:
    """Draw Fig. 4: ejection time and energy transfer over x and C."""
    figure = new_figure(
        'Fig. 4   Secs. III and IV: where a layer is worth most',
        'First release, harmonic plate. Projectile and layer are equally dense here; with the '
        "rig's ratio of 1.3\nthe optimum is elsewhere on these axes (see the table).",
        height=5.3,
    )
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    harmonic = landscape(0.0)
    _show_phase(figure, panels[0], harmonic)
    _show_transfer(figure, panels[1], harmonic)
    x, c = (axis.values for axis in harmonic.axes)
    crossings = harmonic.ejection_phase * c[None, :] / x[:, None]
    lines = panels[0].contour(
        x, c, crossings.T, levels=[3.0, 5.0], colors='white', linestyles=['-', '--']
    )
    panels[0].clabel(
        lines, fmt={3.0: '$3\\,t_s$', 5.0: '$5\\,t_s$'}, manual=[(0.75, 5.0), (0.47, 6.5)]
    )
    axes = panels[1]
    along = np.linspace(0.0, 0.6, 100)
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


def draw_damped_maps() -> Figure:
    """Draw Fig. 12: the same for the damped plate, and what damping changes."""
    figure = new_figure(
        'Fig. 12   App. D: the same with a damped plate',
        rf'$\zeta$ = {DAMPING_RATIO:g}, equal densities, first release. '
        r'$\alpha$ counts from the largest speed of the damped plate, Eq. (D4).',
        height=8.6,
    )
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    harmonic, damped = landscape(0.0), landscape(DAMPING_RATIO)
    _show_phase(figure, panels[0, 0], damped)
    _show_transfer(figure, panels[0, 1], damped)
    x, c = (axis.values for axis in damped.axes)
    for axes, title, before, after in (
        (panels[1, 0], '(c) change of $t_e$', harmonic.ejection_phase, damped.ejection_phase),
        (
            panels[1, 1],
            r'(d) change of $\alpha$',
            harmonic.energy_transfer,
            damped.energy_transfer,
        ),
    ):
        change = 100.0 * (after / before - 1.0)
        image = show_map(axes, x, c, change, levels=_CHANGES, colours='PuOr_r', extend='both')
        figure.colorbar(image, ax=axes, label='change by damping (%)', ticks=_CHANGES, pad=0.01)
        _label(axes, title)
    for axes in panels.flat:
        _mark_optimum(axes, 0.0, 'harmonic optimum', marker='o')
        _mark_optimum(axes, DAMPING_RATIO, 'damped optimum', marker='D')
    legend_below(figure, panels[0, 1], columns=2)
    return figure


def _show_phase(figure: Figure, axes: Axes, shown: Landscape) -> None:
    x, c = (axis.values for axis in shown.axes)
    image = show_map(
        axes, x, c, shown.ejection_phase, levels=_PHASES, colours='magma', extend='max'
    )
    figure.colorbar(image, ax=axes, label='$t_e f$', pad=0.01)
    _label(axes, '(a) ejection time in plate periods')


def _show_transfer(figure: Figure, axes: Axes, shown: Landscape) -> None:
    x, c = (axis.values for axis in shown.axes)
    image = show_map(axes, x, c, shown.energy_transfer, levels=_TRANSFERS, colours='cividis')
    figure.colorbar(image, ax=axes, label=r'$\alpha$', pad=0.01)
    lines = axes.contour(
        x, c, shown.energy_transfer.T, levels=[1.0, 2.0, 3.0, 4.0], colors='black', linewidths=0.8
    )
    axes.clabel(lines, fmt='%g')
    _label(axes, '(b) energy transfer factor')


def _label(axes: Axes, title: str) -> None:
    axes.set(title=title, xlim=(0.0, 1.0), ylim=(0.0, HIGHEST))
    axes.set(xlabel=f'${AXES["x"].symbol}$', ylabel=f'${AXES["C"].symbol}$')
    axes.label_outer()


def _mark_optimum(axes: Axes, damping_ratio: float, label: str, *, marker: str = '+') -> None:
    """Mark where the energy transfer is largest."""
    best = best_ratios(damping_ratio)
    x = 1.0 / (1.0 + best.mass_ratio)
    c = best.speed_ratio * x
    axes.plot(
        x,
        c,
        marker,
        mfc='none',
        mec='black',
        mew=1.4,
        ms=6,
        ls='none',
        zorder=6,
        label=rf'{label}: $\alpha$ = {best.energy_transfer:.3f} at ({x:.3f}, {c:.3f})',
    )
