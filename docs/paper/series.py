# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figs. 5, 7 and 12: ejection time and energy transfer of three series, and of springs."""

from __future__ import annotations

import math
from typing import Any

from matplotlib.figure import Figure
from models import best_frequency_ratio, DAMPING_RATIO, releases_of, SERIES, Series, THICKNESSES
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scheme import releases
from soft_throw_ros.core.closed_form import first_releases, spring_release
from soft_throw_ros.core.plate import peak_velocity_ratio
from soft_throw_ros.core.rig import Engine
from soft_throw_ros.design.prediction import prediction_uncertainty
import style

Floats = NDArray[np.float64]

_STYLES = tuple(zip(SERIES, (style.BLUE, style.ORANGE, style.GREEN), ('o', 's', '^'), strict=True))

_THIN = np.geomspace(0.6e-3, 3e-3, 41)  # layers that may touch the projectile again [m]
_X = np.linspace(0.005, 0.995, 1189)  # below, a damped throw takes too many crossings to add up


def _draw_results(
    panels: NDArray[np.object_], x: Floats, phase: ArrayLike, transfer: ArrayLike, **options: Any
) -> None:
    """Draw ejection phase and energy transfer in the first two panels, broken at jumps."""
    for axes, values in zip(panels[:2], (phase, transfer), strict=True):
        axes.plot(x, style.broken(values), **options)


def _label_results(panels: NDArray[np.object_], *, phase_end: float, **options: Any) -> None:
    """Label two panels as ejection time and energy transfer, and set options of all panels."""
    panels[0].set(title='(a) ejection time', ylabel='$t_e f$', ylim=(0.0, phase_end))
    panels[1].set(title='(b) energy transfer factor', ylabel=r'$\alpha$', ylim=(0.0, 4.4))
    for axes in panels:
        axes.set(**options)


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
        for thickness in _THIN:
            throws = releases_of(series.rig(thickness, damping_ratio=0.0), periods=3.0)
            if len(throws) > 1:
                phase, speed = throws[-1]
                for axes, value in zip(panels, (phase, speed**2), strict=True):
                    axes.plot(series.x_of(thickness), value, '.', color=color, ms=4)
    label = r'paper: no layer, $t_e f$ = 0.25, $\alpha$ = 1'
    for axes, value in zip(panels, (0.25, 1.0), strict=True):
        axes.plot(0.0, value, **style.PAPER, clip_on=False, label=label)
    _label_results(panels, phase_end=0.9, xlabel=style.X_LABEL, xlim=(0.0, 1.0))
    return style.legend_below(figure, panels[1], columns=2)


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
        strains = 100.0 * series.throws(damping_ratio=DAMPING_RATIO, loads=True).peak_strain
        x = series.x_of(THICKNESSES)
        panels[2].plot(x, strains, marker, color=color, mec='white', ms=7)
    panels[2].axhline(10.0, color=style.RED, ls='--', label='paper: below 10 %')
    panels[2].set(
        title='(c) largest strain', ylabel='strain (%)', ylim=(0.0, 22.0), yticks=range(0, 21, 5)
    )
    _label_results(panels, phase_end=0.9, xlabel=style.X_LABEL, xlim=(0.0, 1.0))
    return style.legend_below(figure, panels[1], panels[2], columns=2)


def _draw_curve(
    panels: NDArray[np.object_], series: Series, damping_ratio: float, color: str, width: float
) -> None:
    """Draw the results of a series over the thickness of the layer."""
    thickness = series.projectile_length * _X / (1.0 - _X)
    curve = series.throws(thickness, damping_ratio=damping_ratio)
    results = curve.ejection_time * series.frequency, curve.energy_transfer
    _draw_results(panels, _X, *results, color=color, lw=width)


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


def draw_spring() -> Figure:
    """Draw Fig. 7: the massless spring, and layers with different masses."""
    figure, panels = style.new_figure(
        'Fig. 7   App. A: the massless spring, and layers that have mass',
        'A layer much lighter than the projectile acts as a spring. Lighter projectiles gain more '
        'energy than from any spring.',
        height=4.5,
    )
    ratio = np.linspace(0.02, 5.0, 1200)
    spring = spring_release(frequency_ratio=ratio)
    for mu, color in ((0.25, style.ORANGE), (1.0, style.SKY), (4.0, style.BLUE)):
        layer = first_releases(mass_ratio=mu, speed_ratio=2.0 * math.pi * math.sqrt(mu) * ratio)
        label = rf'layer, $\mu = m/\rho_s S L_s$ = {mu:g}'
        results = layer.ejection_phase, layer.energy_transfer
        _draw_results(panels, ratio, *results, color=color, label=label)
    for axes, values in zip(panels, (spring.ejection_phase, spring.energy_transfer), strict=True):
        axes.plot(ratio, values, color=style.BLACK, ls='--', label=r'spring: $\mu \to \infty$')
        axes.axvline(best_frequency_ratio(), color='0.7', lw=0.8, zorder=0)
    _label_results(panels, phase_end=1.2, xlabel='$f_0 / f$', xlim=(0.0, 5.0))
    panels[1].plot(1.62, 3.13, **style.PAPER, label=r'paper: $f_0/f$ = 1.62, $\alpha$ = 3.13')
    return style.legend_below(figure, panels[1], columns=3)
