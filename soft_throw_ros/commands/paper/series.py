# SPDX-License-Identifier: Apache-2.0
"""Figs. 3 and 11: the three series of throws, harmonic and damped."""

from __future__ import annotations

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.commands.paper.rig_series import (
    DAMPING_RATIO,
    SERIES,
    Series,
    THICKNESSES,
)
from soft_throw_ros.commands.paper.style import (
    BLUE,
    broken,
    GREEN,
    legend_below,
    new_figure,
    ORANGE,
    PAPER,
)
from soft_throw_ros.core.rig import Engine
from soft_throw_ros.design.landscape import AXES

Floats = NDArray[np.float64]

_LOOKS = tuple(zip(SERIES, (BLUE, ORANGE, GREEN), ('o', 's', '^'), strict=True))

THIN: Floats = np.geomspace(0.6e-3, 3e-3, 41)
"""Layers that may touch the projectile again. [m]"""

X: Floats = np.linspace(0.005, 0.995, 1189)
"""Where curves are computed. Nearer to 0, with damping, there are too many crossings to add up."""


def draw_series() -> Figure:
    """Draw Fig. 3: ejection time and energy transfer of the rig, with re-contacts."""
    figure = new_figure(
        'Fig. 3   Sec. III: the six layers, two projectiles, two frequencies',
        "Harmonic plate, the rig's densities. Lines: exact, rigid projectile, first release. "
        "Points: the paper's layers by\nfinite differences with an elastic projectile; bars: what "
        "the rig's uncertainties make of them. Dots: last release.",
        height=5.6,
    )
    panels = figure.subplots(1, 2, sharex=True)
    for series, color, marker in _LOOKS:
        _draw_one(panels, series, 0.0, color, marker)
        _draw_last_releases(panels, series, color)
    label = r'paper: no layer, $t_e f$ = 0.25, $\alpha$ = 1'
    for axes, value in zip(panels, (0.25, 1.0), strict=True):
        axes.plot(0.0, value, **PAPER, clip_on=False, label=label)
    _label(panels)
    legend_below(figure, panels[1], columns=2)
    return figure


def _draw_one(
    panels: NDArray[np.object_], series: Series, damping_ratio: float, color: str, marker: str
) -> None:
    """Draw a series: the curve and the six layers."""
    curve = series.releases(series.thickness(X), damping_ratio=damping_ratio)
    points = series.elastic_releases(damping_ratio=damping_ratio)
    errors = series.errors(damping_ratio=damping_ratio)
    label = (
        f'$f$ = {series.frequency:g} Hz, $L_r$ = {1e3 * series.projectile_length:g} mm: '
        f'$c_s / L_r f$ = {series.speed:.1f}'
    )
    if series is SERIES[2]:
        label += ' (printed: 34.5)'
    for axes, line, middle, error in (
        (panels[0], curve.ejection_phase, points.ejection_phase, errors.ejection_phase),
        (panels[1], curve.energy_transfer, points.energy_transfer, errors.energy_transfer),
    ):
        axes.plot(X, broken(line), color=color, lw=1.4)
        axes.errorbar(
            series.place(THICKNESSES),
            middle[:, 0],
            xerr=errors.x,
            yerr=error,
            fmt=marker,
            color=color,
            mec='white',
            ms=7,
            elinewidth=1.2,
            capsize=2.5,
            label=label,
        )


def _draw_last_releases(panels: NDArray[np.object_], series: Series, color: str) -> None:
    """Dot the last release of thin layers where it is not the first."""
    first = series.releases(THIN, damping_ratio=0.0)
    last = series.last_releases(THIN, damping_ratio=0.0)
    again = last.ejection_phase[:, 0] > 1.0001 * first.ejection_phase
    for axes, values in zip(panels, (last.ejection_phase, last.energy_transfer), strict=True):
        axes.plot(series.place(THIN)[again], values[again, 0], '.', color=color, ms=4)


def draw_damped_series() -> Figure:
    """Draw Fig. 11: the same for the damped plate, and how far the layers are strained."""
    figure = new_figure(
        'Fig. 11   App. D: the same with the damped plate of the rig',
        rf'$\zeta$ = {DAMPING_RATIO:g}, first release; thin lines: harmonic plate (Fig. 3). '
        'Damping changes $\\alpha$ by a few percent, mostly.\nAt $A$ = '
        f'{1e3 * Engine().amplitude:g} mm and 63.2 Hz the strain is above the 10 % below which '
        'the paper puts it.',
        height=5.6,
    )
    panels = figure.subplots(1, 3)
    for series, color, marker in _LOOKS:
        harmonic = series.releases(series.thickness(X), damping_ratio=0.0)
        for axes, values in zip(panels, harmonic[::2], strict=False):
            axes.plot(X, broken(values), color=color, lw=0.6)
        _draw_one(panels, series, DAMPING_RATIO, color, marker)
        strains = 100.0 * series.peak_strains(damping_ratio=DAMPING_RATIO)
        panels[2].plot(series.place(THICKNESSES), strains, marker, color=color, mec='white', ms=7)
    panels[2].axhline(10.0, color=PAPER['color'], ls='--', label='paper: below 10 %')
    panels[2].set(
        title='(c) largest strain', ylabel='strain (%)', ylim=(0.0, 22.0), yticks=range(0, 21, 5)
    )
    _label(panels)
    legend_below(figure, panels[1], panels[2], columns=2)
    return figure


def _label(panels: NDArray[np.object_]) -> None:
    panels[0].set(title='(a) ejection time', ylabel='$t_e f$', ylim=(0.0, 0.9))
    panels[1].set(title='(b) energy transfer factor', ylabel=r'$\alpha$', ylim=(0.0, 4.4))
    for axes in panels:
        axes.set(xlabel=f'${AXES["x"].symbol}$', xlim=(0.0, 1.0))
