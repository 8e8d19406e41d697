# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figs. 5 and 12: the three series of throws with a harmonic and a damped plate."""

from __future__ import annotations

from matplotlib.figure import Figure
from models import DAMPING_RATIO, releases_of, SERIES, Series, THICKNESSES
import numpy as np
from numpy.typing import NDArray
from scheme import releases
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.rig import Engine
from soft_throw_ros.design.uncertainty import prediction_uncertainty
import style

Floats = NDArray[np.float64]

_STYLES = tuple(zip(SERIES, (style.BLUE, style.ORANGE, style.GREEN), ('o', 's', '^'), strict=True))

THIN: Floats = np.geomspace(0.6e-3, 3e-3, 41)
"""Thicknesses of layers that may touch the projectile again. [m]"""

X: Floats = np.linspace(0.005, 0.995, 1189)
"""Points of the curves. Below 0.005 a damped throw takes too many crossings to add up."""


def draw_series() -> Figure:
    """Draw Fig. 5: ejection time and energy transfer of the rig, with re-contacts."""
    figure, panels = style.new_figure(
        'Fig. 5   Sec. III: the six layers, two projectiles, two frequencies',
        "Harmonic plate, the rig's densities. Lines: exact, rigid projectile, first release. "
        "Points: the paper's layers by\nthe scheme of the paper with an elastic projectile. "
        'Bars: 95 % within the errors of the rig. Dots: last release.',
        height=5.6, sharex=True,
    )
    for series, color, marker in _STYLES:
        _draw_one(panels, series, 0.0, color, marker)
        _draw_last_releases(panels, series, color)
    label = r'paper: no layer, $t_e f$ = 0.25, $\alpha$ = 1'
    for axes, value in zip(panels, (0.25, 1.0), strict=True):
        axes.plot(0.0, value, **style.PAPER, clip_on=False, label=label)
    style.label_results(panels, phase_end=0.9, xlabel=style.X_LABEL, xlim=(0.0, 1.0))
    return style.legend_below(figure, panels[1], columns=2)


def _draw_curve(
    panels: NDArray[np.object_], series: Series, damping_ratio: float, color: str, width: float
) -> None:
    """Draw the results of a series over the thickness of the layer."""
    curve = series.throws(series.thickness_of(X), damping_ratio=damping_ratio)
    results = curve.ejection_time * series.frequency, curve.energy_transfer
    style.draw_results(panels, X, *results, color=color, lw=width)


def _draw_one(
    panels: NDArray[np.object_], series: Series, damping_ratio: float, color: str, marker: str
) -> None:
    """Draw the curve of a series and the points of the six layers."""
    _draw_curve(panels, series, damping_ratio, color, 1.4)
    rigs = [series.rig(thickness, damping_ratio=damping_ratio) for thickness in THICKNESSES]
    throws = [releases(rig, cells=200)[0] for rig in rigs]
    bounds = [prediction_uncertainty(rig) for rig in rigs]
    label = (
        f'$f$ = {series.frequency:g} Hz, $L_r$ = {1e3 * series.projectile_length:g} mm: '
        f'$c_s / L_r f$ = {series.speed:.3g} (paper: {series.printed})'
    )
    scale = peak_velocity_ratio(damping_ratio)
    for axes, points, intervals in (
        (panels[0], [throw.phase for throw in throws],
         series.frequency * np.array([item.ejection_time for item in bounds])),
        (panels[1], [(throw.speed / scale) ** 2 for throw in throws],
         np.array([item.energy_transfer for item in bounds])),
    ):
        below, above = np.maximum([[-1.0], [1.0]] * (intervals.T - points), 0.0)
        axes.errorbar(
            series.x_of(THICKNESSES), points, yerr=(below, above), fmt=marker, color=color,
            mec='white', ms=7, elinewidth=1.2, capsize=2.5, label=label,
        )


def _draw_last_releases(panels: NDArray[np.object_], series: Series, color: str) -> None:
    """Dot the last release of thin layers with several releases."""
    for thickness in THIN:
        releases = releases_of(series.rig(thickness, damping_ratio=0.0), periods=3.0)
        if len(releases) > 1:
            phase, speed = releases[-1]
            for axes, value in zip(panels, (phase, speed**2), strict=True):
                axes.plot(series.x_of(thickness), value, '.', color=color, ms=4)


def draw_damped_series() -> Figure:
    """Draw Fig. 12: the series with the damped plate, and the largest strain of the layers."""
    figure, panels = style.new_figure(
        'Fig. 12   App. D: the same with the damped plate of the rig',
        rf'$\zeta$ = {DAMPING_RATIO:g}, first release; thin lines: harmonic plate (Fig. 5). '
        'Damping changes $\\alpha$ by a few percent, mostly.\nAt $A$ = '
        f'{1e3 * Engine().amplitude:g} mm and 63.2 Hz the strain is above the 10 % that the paper '
        'gives as its limit.',
        height=5.6, grid=(1, 3),
    )
    for series, color, marker in _STYLES:
        _draw_curve(panels, series, 0.0, color, 0.6)
        _draw_one(panels, series, DAMPING_RATIO, color, marker)
        strains = series.throws(damping_ratio=DAMPING_RATIO, loads=True).peak_strain
        panels[2].plot(
            series.x_of(THICKNESSES), 100.0 * strains, marker, color=color, mec='white', ms=7
        )
    panels[2].axhline(10.0, color=style.RED, ls='--', label='paper: below 10 %')
    panels[2].set(
        title='(c) largest strain', ylabel='strain (%)', ylim=(0.0, 22.0), yticks=range(0, 21, 5)
    )
    style.label_results(panels, phase_end=0.9, xlabel=style.X_LABEL, xlim=(0.0, 1.0))
    return style.legend_below(figure, panels[1], panels[2], columns=2)
