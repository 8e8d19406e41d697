# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figs. 8 to 10: measurements of the paper that are not at hand, replaced by computed data."""

from __future__ import annotations

import math

from matplotlib.figure import Figure
from models import DAMPING_RATIO, THICKNESSES
import numpy as np
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Engine, Layer
from soft_throw_ros.design.prediction import Uncertainties
from soft_throw_ros.identification.plate_fit import fit_plate, NAMES
from soft_throw_ros.identification.tracks import Track
from style import BLACK, BLUE, GREEN, legend_below, MILLI, new_figure, ORANGE, RED

SLOPE, SLOPE_ERROR = 0.256, 0.008
"""Slope of T_0 over L_s and its error, printed without a unit, which can only be this. [s/m]"""

NOISE, RATE = 20e-6, 5000.0  # of a height of the plate [m], and of the frames of the camera [Hz]


def draw_free_layers() -> Figure:
    """Draw Figs. 8 and 9: the ringing of free layers, and its period over their thickness."""
    figure, panels = new_figure(
        'Figs. 8 and 9   App. B: the wave speed, from layers that ring freely',
        'A wave goes there and back in a period $T_0 = 2 L_s / c_s$. The ringing is computed, for '
        'a loss tangent of 0.02;\nthe measured periods of the paper are not at hand, only the '
        'slope of its line.',
        height=4.4, width_ratios=(1.15, 1.0),
    )
    speed = Layer().wave_speed
    time, loss_tangent = np.linspace(0.0, 22e-3, 1200), 0.02
    odd = np.arange(1.0, 40.0, 2.0)  # modes; by Kelvin and Voigt they decay n^2 times as fast
    for thickness, color in zip(THICKNESSES[[1, 3, 5]], (BLUE, ORANGE, GREEN), strict=True):
        period = 2.0 * thickness / speed
        phase = 2.0 * math.pi * time[:, None] / period
        decay = np.exp(-0.5 * loss_tangent * odd**2 * phase)
        length = (8.0 / (math.pi * odd) ** 2 * np.cos(odd * phase) * decay).sum(axis=1)
        label = f'$L_s$ = {MILLI * thickness:.1f} mm'
        panels[0].plot(MILLI * time, length, color=color, label=label)
        panels[0].plot(MILLI * period, 1.12, 'v', color=color, ms=6)
    panels[0].text(0.3, 1.22, 'one period $T_0$:', va='bottom')
    panels[0].set(title='(a) ringing', xlabel='time $t$ (ms)', ylabel='stretch over first stretch',
                  xlim=(0.0, 22.0), ylim=(-1.15, 1.45))
    thickness = np.array([0.0, 32e-3])
    panels[1].fill_between(
        MILLI * thickness, MILLI * 2.0 * thickness / (speed + Uncertainties().wave_speed),
        MILLI * 2.0 * thickness / (speed - Uncertainties().wave_speed), color='0.85', lw=0,
        label=f'$c_s$ = {speed:g} $\\pm$ {Uncertainties().wave_speed:g} m/s',
    )
    panels[1].plot(
        MILLI * thickness, MILLI * SLOPE * thickness, color=RED, ls='--',
        label=f'paper: $T_0 / L_s$ = {SLOPE:g} s/m, $c_s$ = {2.0 / SLOPE:.2f} m/s',
    )
    panels[1].errorbar(
        MILLI * THICKNESSES, MILLI * 2.0 * THICKNESSES / speed,
        xerr=MILLI * Uncertainties().thickness,
        fmt='o', color=BLACK, mec='white', ms=7, label="the rig's six layers, computed",
    )
    panels[1].set(title='(b) period', xlabel='thickness $L_s$ (mm)', ylabel='$T_0$ (ms)',
                  xlim=(0.0, 32.0), ylim=(0.0, 8.5))
    return legend_below(figure, *panels, columns=3)


def draw_plate_fit() -> Figure:
    """Draw Fig. 10: the motion of the plate, the fitted damped step, and the residual."""
    time = np.arange(-5e-3, 60e-3, 1.0 / RATE)
    height = Underdamped.of(Engine()).position(np.maximum(time, 0.0))
    height += NOISE * np.random.default_rng(0).standard_normal(time.size)
    fitted = fit_plate(Track(time=time, position=height))
    frequency, damping, amplitude, start, offset = (fitted[name] for name in NAMES)
    plate = Underdamped(
        frequency=frequency.value, damping_ratio=damping.value, amplitude=amplitude.value
    )
    figure, panels = new_figure(
        'Fig. 10   App. D: the motion of the plate, a damped step',
        f'Track computed with the rig of the paper and {NOISE * 1e6:g} $\\mu$m of noise at '
        f"{RATE:g} Hz, for the paper's is not at hand;\nfitted by Eq. (D2). "
        f'The paper has $\\zeta$ = {DAMPING_RATIO:g} $\\pm$ 0.003, and 31.2 $\\pm$ 0.1 Hz for '
        'the slower plate.',
        height=5.2, grid=(2, 1), sharex=True, height_ratios=(3.0, 1.0),
    )
    fine = np.linspace(time[0], time[-1], 1500)
    panels[0].plot(MILLI * time, MILLI * height, '.', color=BLUE, ms=5,
                   label='heights of the plate')
    panels[0].plot(
        MILLI * fine, MILLI * (offset.value + plate.position(fine - start.value)),
        color=BLACK, lw=1.4,
        label=f'fit: $f$ = {frequency.value:.2f} $\\pm$ {frequency.error:.2f} Hz, '
        f'$\\zeta$ = {damping.value:.4f} $\\pm$ {damping.error:.4f}, '
        f'$A$ = {MILLI * amplitude.value:.3f} $\\pm$ {MILLI * amplitude.error:.3f} mm',
    )
    panels[1].axhline(0.0, color=BLACK, lw=0.8)
    panels[1].plot(MILLI * time, 1e6 * fitted.residuals[0].values, '.', color=BLUE, ms=4)
    panels[0].set(title='(a) height', ylabel='$z_p$ (mm)', ylim=(-0.3, 4.0))
    panels[1].set(title='(b) residual', ylabel=r'($\mu$m)', xlabel='time $t$ (ms)',
                  xlim=(-5.0, 60.0), ylim=(-90.0, 90.0))
    return legend_below(figure, panels[0], columns=2)
