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
"""
Figs. 8 to 10: how the rig's wave speed and the plate's motion are found.

The paper's measurements are not at hand. What stands for them is computed, and said to be.
"""

from __future__ import annotations

import math

from matplotlib.figure import Figure
from models import (
    DAMPING_RATIO,
    Engine,
    Layer,
    THICKNESS_ERROR,
    THICKNESSES,
    Underdamped,
    WAVE_SPEED_ERROR,
)
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from style import BLACK, BLUE, GREEN, legend_below, new_figure, ORANGE, RED

Floats = NDArray[np.float64]

SLOPE = 0.256
"""Of T_0 over L_s, as printed; its unit can only be s/m."""

NOISE = 20e-6  # of a measured height of the plate [m]
RATE = 5000.0  # of the camera [Hz]

_MILLI = 1e3


def ringing(time: Floats, period: float, *, loss_tangent: float = 0.02) -> Floats:
    """
    Compute the length of a free layer that is let go from a uniform stretch, less its own.

    Parameters
    ----------
    time : ndarray
        [s]
    period : float
        Of the first mode. [s]
    loss_tangent : float
        At that mode; Kelvin and Voigt's, so that the n-th decays n^2 times as fast. [-]

    Returns
    -------
    ndarray
        In units of the first stretch. [-]

    """
    odd = np.arange(1.0, 40.0, 2.0)
    phase = 2.0 * math.pi * time[:, None] / period
    decay = np.exp(-0.5 * loss_tangent * odd**2 * phase)
    return np.asarray((8.0 / (math.pi * odd) ** 2 * np.cos(odd * phase) * decay).sum(axis=1))


def draw_free_layers() -> Figure:
    """Draw Figs. 8 and 9: free layers ring, with a period that grows with their thickness."""
    figure = new_figure(
        'Figs. 8 and 9   App. B: the wave speed, from layers that ring freely',
        'A wave goes there and back in a period $T_0 = 2 L_s / c_s$. The ringing is computed, for '
        'a loss tangent of 0.02;\nthe measured periods of the paper are not at hand, only the '
        'slope of its line.',
        height=4.4,
    )
    panels = figure.subplots(1, 2, width_ratios=(1.15, 1.0))
    speed = Layer().wave_speed
    time = np.linspace(0.0, 22e-3, 1200)
    for thickness, color in zip(THICKNESSES[[1, 3, 5]], (BLUE, ORANGE, GREEN), strict=True):
        period = 2.0 * thickness / speed
        label = f'$L_s$ = {_MILLI * thickness:.1f} mm'
        panels[0].plot(_MILLI * time, ringing(time, period), color=color, label=label)
        panels[0].plot(_MILLI * period, 1.12, 'v', color=color, ms=6)
    panels[0].text(0.3, 1.22, 'one period $T_0$:', va='bottom')
    panels[0].set(
        title='(a) ringing',
        xlabel='time $t$ (ms)',
        ylabel='stretch over first stretch',
        xlim=(0.0, 22.0),
        ylim=(-1.15, 1.45),
    )
    along = np.array([0.0, 32e-3])
    panels[1].fill_between(
        _MILLI * along,
        _MILLI * 2.0 * along / (speed + WAVE_SPEED_ERROR),
        _MILLI * 2.0 * along / (speed - WAVE_SPEED_ERROR),
        color='0.85',
        lw=0,
        label=f'$c_s$ = {speed:g} $\\pm$ {WAVE_SPEED_ERROR:g} m/s',
    )
    panels[1].plot(
        _MILLI * along,
        _MILLI * SLOPE * along,
        color=RED,
        ls='--',
        label=f'paper: $T_0 / L_s$ = {SLOPE:g} s/m, $c_s$ = {2.0 / SLOPE:.2f} m/s',
    )
    panels[1].errorbar(
        _MILLI * THICKNESSES,
        _MILLI * 2.0 * THICKNESSES / speed,
        xerr=_MILLI * THICKNESS_ERROR,
        fmt='o',
        color=BLACK,
        mec='white',
        ms=7,
        label="the rig's six layers, computed",
    )
    panels[1].set(
        title='(b) period',
        xlabel='thickness $L_s$ (mm)',
        ylabel='$T_0$ (ms)',
        xlim=(0.0, 32.0),
        ylim=(0.0, 8.5),
    )
    legend_below(figure, *panels, columns=3)
    return figure


def plate_track() -> tuple[Floats, Floats]:
    """Make a track of the plate as a camera would give it: time [s] and height [m]."""
    time = np.arange(-5e-3, 60e-3, 1.0 / RATE)
    height = Underdamped.of(Engine()).position(np.maximum(time, 0.0))
    return time, height + NOISE * np.random.default_rng(0).standard_normal(time.size)


def fit_plate(time: Floats, height: Floats) -> tuple[Floats, Floats]:
    """
    Fit the damped step, Eq. (D2), by least squares.

    Returns
    -------
    values, errors : ndarray, shape (4,)
        Start [s], frequency [Hz], amplitude [m] and damping ratio, and standard deviations.

    """

    def model(
        time: Floats, start: float, frequency: float, amplitude: float, damping: float
    ) -> Floats:
        plate = Underdamped(frequency=frequency, amplitude=amplitude, damping_ratio=damping)
        return plate.position(np.maximum(time - start, 0.0))

    guess = (0.0, 60.0, 1.8e-3, 0.05)
    bounds = ((-5e-3, 20.0, 1e-4, 0.0), (5e-3, 200.0, 1e-2, 0.9))
    values, covariance = curve_fit(model, time, height, p0=guess, bounds=bounds, x_scale='jac')
    return np.asarray(values), np.sqrt(np.diag(covariance))


def draw_plate_fit() -> Figure:
    """Draw Fig. 10: the plate's motion, the damped step that fits it, and what is left."""
    time, height = plate_track()
    (start, frequency, amplitude, damping), errors = fit_plate(time, height)
    figure = new_figure(
        'Fig. 10   App. D: the motion of the plate, a damped step',
        f'Track computed with the rig of the paper and {NOISE * 1e6:g} $\\mu$m of noise at '
        f"{RATE:g} Hz, for the paper's is not at hand;\nfitted by Eq. (D2). "
        f'The paper has $\\zeta$ = {DAMPING_RATIO:g} $\\pm$ 0.003, and 31.2 $\\pm$ 0.1 Hz for '
        'the slower plate.',
        height=5.2,
    )
    panels = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.0))
    plate = Underdamped(frequency=frequency, amplitude=amplitude, damping_ratio=damping)
    fine = np.linspace(time[0], time[-1], 1500)
    panels[0].plot(
        _MILLI * time, _MILLI * height, '.', color=BLUE, ms=5, label='heights of the plate'
    )
    panels[0].plot(
        _MILLI * fine,
        _MILLI * plate.position(np.maximum(fine - start, 0.0)),
        color=BLACK,
        lw=1.4,
        label=f'fit: $f$ = {frequency:.2f} $\\pm$ {errors[1]:.2f} Hz, '
        f'$\\zeta$ = {damping:.4f} $\\pm$ {errors[3]:.4f}, '
        f'$A$ = {_MILLI * amplitude:.3f} $\\pm$ {_MILLI * errors[2]:.3f} mm',
    )
    left = height - plate.position(np.maximum(time - start, 0.0))
    panels[1].axhline(0.0, color=BLACK, lw=0.8)
    panels[1].plot(_MILLI * time, 1e6 * left, '.', color=BLUE, ms=4)
    panels[0].set(title='(a) height', ylabel='$z_p$ (mm)', ylim=(-0.3, 4.0))
    panels[1].set(
        title='(b) residual',
        ylabel=r'($\mu$m)',
        xlabel='time $t$ (ms)',
        xlim=(-5.0, 60.0),
        ylim=(-90.0, 90.0),
    )
    legend_below(figure, panels[0], columns=2)
    return figure
