# SPDX-License-Identifier: Apache-2.0
"""Figs. 5 and 6, the travelling wave crossing by crossing, and Fig. 7, the massless spring."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.commands.paper import limits
from soft_throw_ros.commands.paper.style import (
    BLACK,
    BLUE,
    broken,
    GREEN,
    legend_below,
    new_figure,
    ORANGE,
    PAPER,
    RED,
    SKY,
)
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.travelling_wave import first_releases
from soft_throw_ros.design.landscape import AXES
from soft_throw_ros.design.recommendation import best_ratios

Floats = NDArray[np.float64]


def draw_thick_layer() -> Figure:
    r"""Draw Fig. 5: releases before the wave returns, which :math:`\omega \tau` decides."""
    figure = new_figure(
        'Fig. 5   App. C: released from a thick layer before the wave comes back',
        r'Only $\omega\tau = 2\pi m c_s f / E_s S$ counts. For small $\omega\tau$ the paper '
        r'prints $4 - 2\,(\omega\tau + e^{-\pi/2\omega\tau})^2$;'
        '\n'
        r'exact is $\alpha \to 4 - 4\,(\omega\tau - e^{-1-\pi/2\omega\tau})^2$.',
        height=4.4,
    )
    panels = figure.subplots(1, 3)
    near = np.linspace(0.02, 1.6, 400)
    wide = np.geomspace(0.02, 200.0, 400)
    for axes, values, exact in (
        (panels[0], near, limits.exact(near).angle / math.pi),
        (panels[1], near, limits.exact(near).energy_transfer),
        (panels[2], wide, limits.exact(wide).energy_transfer),
    ):
        axes.plot(values, exact, color=BLACK, lw=2.0, label='exact')
    for approximate, color, style, label in (
        (limits.light_projectile, BLUE, '--', r'App. C(i) for small $\omega\tau$, mended'),
        (limits.light_projectile_as_printed, RED, ':', 'the same as printed'),
    ):
        found = approximate(near)
        panels[0].plot(near, found.angle / math.pi, color=color, ls=style, label=label)
        panels[1].plot(near, found.energy_transfer, color=color, ls=style, label=label)
    large = wide[wide > 3.0]
    panels[2].plot(
        large,
        limits.heavy_projectile(large).energy_transfer,
        color=GREEN,
        ls='--',
        label=r'App. C(ii) for large $\omega\tau$: $16/(\omega\tau)^2$',
    )
    panels[0].set(
        title='(a) when',
        ylabel=r'$\omega\,(t_e - t_s)\,/\,\pi$',
        xlim=(0.0, 1.6),
        ylim=(0.45, 1.05),
    )
    panels[1].set(
        title='(b) how much', ylabel=r'energy transfer $\alpha$', xlim=(0.0, 1.6), ylim=(0.0, 4.2)
    )
    panels[2].set(
        title='(c) over a wide range',
        ylabel=r'energy transfer $\alpha$',
        xscale='log',
        yscale='log',
        xlim=(0.02, 200.0),
        ylim=(3e-4, 10.0),
    )
    for axes in panels:
        axes.set_xlabel(r'$\omega\tau$')
    panels[1].plot(0.0, 4.0, **PAPER, clip_on=False, label=r'paper: $\alpha = 4$')
    legend_below(figure, panels[1], panels[2], columns=3)
    return figure


def draw_crossings() -> Figure:
    """Draw Fig. 6: releases in the first, the second and later wave intervals."""
    figure = new_figure(
        'Fig. 6   Sec. IV: one wave interval after the other',
        'Time and energy jump where the release passes 3, 5, ... crossings $t_s$ of the layer. '
        'Equal densities, harmonic plate.\n'
        'The paper writes out the first two intervals; the series does not end there.',
        height=6.4,
    )
    panels = figure.subplots(2, 1, sharex=True)
    c = np.linspace(0.02, 14.0, 2797)
    best = 1.0 / (1.0 + best_ratios(0.0).mass_ratio)
    for x in (0.4, best):
        _draw_intervals(panels, c, x, labelled=x == best)
    thick = first_releases(mass_ratio=1e-3, speed_ratio=c)
    for axes, values in zip(
        panels, (thick.ejection_phase * c, thick.energy_transfer), strict=True
    ):
        axes.plot(c, values, color=ORANGE, lw=1.3, label=r'thick soft layer, $x \to 1$')
    for crossings in (3, 5, 7):
        panels[0].axhline(crossings, color='0.7', lw=0.8, zorder=0)
    panels[0].set(
        title='(a) ejection time in crossings of the layer',
        ylabel='$t_e / t_s$',
        ylim=(0.0, 8.0),
        yticks=range(9),
    )
    panels[1].set(
        title='(b) energy transfer factor',
        xlabel=f'${AXES["C"].symbol}$',
        ylabel=r'$\alpha$',
        xlim=(0.0, 14.0),
        ylim=(0.0, 4.9),
        yticks=range(5),
    )
    for axes, places in (
        (panels[0], ((6.2, 6.2), (6.2, 3.6))),
        (panels[1], ((3.05, 2.3), (1.6, 2.5))),
    ):
        for x, place in zip((0.4, best), places, strict=True):
            axes.text(*place, f'$x$ = {x:.2f}')
    panels[1].plot(6.7, 4.12, **PAPER, label=r'paper: $\alpha$ = 4.12 at $x$ = 0.8, $C$ = 6.7')
    panels[1].annotate(
        'paper, $x$ = 1: $\\alpha$ = 4 up to\n$C$ = 7.9, or 8 by its analysis',
        xy=(8.0, 4.02),
        xytext=(9.4, 4.4),
        color=PAPER['color'],
        va='center',
        arrowprops={'arrowstyle': '->', 'color': PAPER['color']},
    )
    legend_below(figure, panels[1], columns=3)
    return figure


def _draw_intervals(panels: tuple[Axes, Axes], c: Floats, x: float, *, labelled: bool) -> None:
    """Draw ejection time and energy transfer along C, in a colour for each wave interval."""
    releases = first_releases(mass_ratio=(1.0 - x) / x, speed_ratio=c / x)
    crossings = np.asarray(releases.ejection_phase) * c / x
    interval = np.floor(0.5 * (crossings - 1.0))
    for low, high, color, label in (
        (0, 0, BLUE, r'before $3\,t_s$: Eqs. (11)-(13)'),
        (1, 1, SKY, r'from $3\,t_s$ to $5\,t_s$: Eq. (14)'),
        (2, np.inf, GREEN, r'after $5\,t_s$, where the paper stops'),
    ):
        mine = (interval >= low) & (interval <= high)
        for axes, values in zip(panels, (crossings, releases.energy_transfer), strict=True):
            axes.plot(
                c,
                np.where(mine, values, np.nan),
                color=color,
                lw=2.6,
                label=label if labelled else None,
            )


def draw_spring() -> Figure:
    """Draw Fig. 7: the massless spring, and layers with less and less mass beside it."""
    figure = new_figure(
        'Fig. 7   App. A: the massless spring, and layers that have mass',
        'What is left of a layer much lighter than the projectile; lighter projectiles gain more '
        'than any spring can give.',
        height=4.5,
    )
    panels = figure.subplots(1, 2)
    ratio = np.linspace(0.02, 5.0, 1200)
    spring = spring_mass.first_release(frequency_ratio=ratio)
    for mu, color in ((0.25, ORANGE), (1.0, SKY), (4.0, BLUE)):
        layer = first_releases(
            mass_ratio=mu, speed_ratio=2.0 * math.pi * math.sqrt(mu) * ratio, unresolved='nan'
        )
        label = rf'layer, $\mu = m/\rho_s S L_s$ = {mu:g}'
        panels[0].plot(ratio, broken(layer.ejection_phase), color=color, label=label)
        panels[1].plot(ratio, broken(layer.energy_transfer), color=color, label=label)
    for axes, values in (
        (panels[0], spring.ejection_phase),
        (panels[1], spring.energy_transfer),
    ):
        axes.plot(ratio, values, color=BLACK, ls='--', label=r'spring: $\mu \to \infty$')
        axes.set(xlabel='$f_0 / f$', xlim=(0.0, 5.0))
    panels[0].set(title='(a) ejection time', ylabel='$t_e f$', ylim=(0.0, 1.2))
    panels[1].set(title='(b) energy transfer', ylabel=r'$\alpha$', ylim=(0.0, 4.4))
    panels[1].plot(1.62, 3.13, **PAPER, label=r'paper: $f_0/f$ = 1.62, $\alpha$ = 3.13')
    best = spring_mass.best_frequency_ratio()
    panels[1].axvline(best, color='0.7', lw=0.8, zorder=0)
    panels[0].axvline(best, color='0.7', lw=0.8, zorder=0)
    legend_below(figure, panels[1], columns=3)
    return figure
