# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figs. 1 and 2, and the pictures of the README: one throw as a strip, over time, in motion."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from models import DAMPING_RATIO, SERIES
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.stepper import PLATE_POSITION, PROJECTILE_POSITION
from soft_throw_ros.core.throw import simulate, Throw
import style
from style import MILLI

Floats = NDArray[np.float64]

PLATE, PROJECTILE, BARE = style.BLACK, style.BLUE, style.GREEN
"""Colours of the plate, the projectile on the layer, and the projectile on the bare plate."""

_THICKNESS = 16.8e-3  # of the layer of Figs. 1 and 2 [m]
_DRAWN_TIME = 0.016  # end of the time axis of Fig. 2 [s]
_GAP = 1.5  # distance of a projectile from the middle of a panel of Fig. 1 [mm]
_README_TIME = 0.022  # end of the pictures of the README [s]
_FRAME = 2e-4  # time between two frames of the animation [s]
_RATE, _PAUSE = 15, 15  # frames per second, 333 times too slow; frames of the last picture


def shown_throw() -> Throw:
    """Simulate the throw of Figs. 1 and 2: short projectile, higher frequency."""
    return simulate(SERIES[1].rig(_THICKNESS, damping_ratio=DAMPING_RATIO), until=_DRAWN_TIME)


def heights_of_layer(throw: Throw, time: Floats, *, points: int) -> tuple[Floats, Floats]:
    """Return heights and strains of material points of the layer, shape (time, points)."""
    _, layers = throw.trajectory(time, points=points)
    rise = cumulative_trapezoid(layers[:, 1], time, axis=0, initial=0.0)
    return np.linspace(0.0, throw.rig.rest_height, points) + rise, layers[:, 3]


def bare_flight(throw: Throw, time: Floats) -> Floats:
    """Return the height of a projectile that leaves the bare plate at its largest speed."""
    motion = Underdamped.of(throw.rig.engine)
    start = motion.position(np.minimum(time, motion.peak_velocity_time))
    flight = np.maximum(time - motion.peak_velocity_time, 0.0)
    fall = 0.5 * throw.rig.gravity * flight**2
    return np.asarray(start + motion.peak_velocity * flight - fall)


def draw_states() -> Figure:
    """Draw Fig. 1: the throw at six moments, beside one from the bare plate."""
    throw = shown_throw()
    rig = throw.rig
    before = np.arange(0.0, throw.ejection_time, 1e-5)
    _, layers = throw.trajectory(before, points=97)
    strain = np.abs(layers[:, 3])
    moments = (
        (0.0, 'at rest'),
        (rig.crossing_time, 'wave is at the top'),
        (Underdamped.of(rig.engine).peak_velocity_time, 'bare plate throws'),
        (before[strain.max(axis=1).argmax()], 'pressed hardest'),
        (throw.ejection_time, 'layer throws'),
        (0.0125, 'in flight'),
    )
    figure, panels = style.new_figure(
        'Fig. 1   A projectile on the bare plate, and one on a soft layer',
        f"The paper's rig: $f$ = {rig.engine.frequency:g} Hz, $\\zeta$ = "
        f'{rig.engine.damping_ratio:g}, $A$ = {MILLI * rig.engine.amplitude:g} mm, $L_s$ = '
        f'{MILLI * rig.layer.thickness:g} mm, $L_r$ = {MILLI * rig.projectile.length:g} mm. '
        'To scale.',
        height=3.15, grid=(1, len(moments)), sharex=True, sharey=True,
    )
    time = np.linspace(0.0, _DRAWN_TIME, 1601)
    heights, strain = heights_of_layer(throw, time, points=41)
    rows = np.searchsorted(time, [moment for moment, _ in moments])
    limit = 100.0 * np.abs(strain[rows]).max()
    for axes, (moment, name), row in zip(panels, moments, rows, strict=True):
        image = draw_state(axes, throw, moment, heights[row], strain[row], limit)
        axes.set_title(f'{name}\n$t$ = {MILLI * moment:.1f} ms', fontsize='small', loc='center')
        axes.set(xlim=(-15.5, 15.5), ylim=(-1.5, 37.5), xticks=[], aspect='equal')
        axes.spines['bottom'].set_visible(False)
        axes.spines['left'].set_visible(axes is panels[0])
        axes.tick_params(left=axes is panels[0])
    panels[0].set_ylabel('height $z$ (mm)')
    panels[0].text(-7.5, 9.5, 'on the\nplate', ha='center', fontsize='small', color=BARE)
    panels[0].text(7.5, 26.3, 'on the\nlayer', ha='center', fontsize='small', color=PROJECTILE)
    figure.colorbar(image, ax=list(panels), label='strain of the layer (%)', location='bottom',
                    shrink=0.5, aspect=40, pad=0.02)
    return figure


def draw_state(
    axes: Axes, throw: Throw, moment: float, heights: Floats, strain: Floats, limit: float
) -> QuadMesh:
    """Draw plate, layer and both projectiles at a moment; the limit of colours is in percent."""
    rig = throw.rig
    width = MILLI * rig.layer.diameter
    plate = MILLI * float(Underdamped.of(rig.engine).position(moment))
    edges = np.array([_GAP, _GAP + width])
    image = axes.pcolormesh(
        edges, MILLI * heights, 50.0 * (strain[:-1] + strain[1:])[:, None], cmap='PuOr',
        vmin=-limit, vmax=limit,
    )
    axes.plot(edges[[0, 0, 1, 1]], MILLI * heights[[0, -1, -1, 0]], color='0.35', lw=0.8)
    states, _ = throw.trajectory(moment)
    for left, bottom, color in (
        (_GAP, float(states[0, PROJECTILE_POSITION]), PROJECTILE),
        (-_GAP - width, float(bare_flight(throw, np.array([moment]))[0]), BARE),
    ):
        size = (width, MILLI * rig.projectile.length)
        axes.add_patch(Rectangle((left, MILLI * bottom), *size, color=color, lw=0))
    axes.add_patch(Rectangle((-15.0, plate - 1.2), 30.0, 1.2, color=PLATE, lw=0))
    return image


def draw_traces() -> Figure:
    """Draw Fig. 2: positions and velocities of plate and projectile over time."""
    throw = shown_throw()
    figure, panels = style.new_figure(
        'Fig. 2   The same throw against time',
        'The projectile moves once the first wave has crossed the layer, in $t_s$, and leaves '
        'when the layer no longer pushes.\nHeights count from rest, so that they are those of its '
        'centre, too, which the paper gives.',
        height=6.2, grid=(2, 1), sharex=True,
    )
    time = np.linspace(0.0, _DRAWN_TIME, 1601)
    states, layers = throw.trajectory(time)
    _, plate_heights, projectile_heights, plate_speeds, projectile_speeds, _, _ = states.T
    thickness = throw.rig.layer.thickness
    bare = time >= Underdamped.of(throw.rig.engine).peak_velocity_time
    free = time >= throw.ejection_time
    panels[0].plot(MILLI * time[free], MILLI * (layers[free, 0, -1] - thickness), color='0.5',
                   lw=1.2, label='top of the layer')
    lines = (
        (plate_heights, projectile_heights - thickness, bare_flight(throw, time)),
        (plate_speeds, projectile_speeds, np.full(time.shape, throw.peak_plate_speed)),
    )
    for axes, scale, (plate, projectile, alone) in zip(panels, (MILLI, 1.0), lines, strict=True):
        dashed = {'color': BARE, 'ls': '--', 'label': 'projectile on bare plate'}
        axes.plot(MILLI * time[bare], scale * alone[bare], **dashed)
        axes.plot(MILLI * time, scale * plate, color=PLATE, lw=2.0, label='plate')
        axes.plot(MILLI * time, scale * projectile, color=PROJECTILE, lw=2.6,
                  label='projectile on layer')
        axes.axvline(MILLI * throw.ejection_time, color='0.5', lw=0.9, ls=':')
        axes.set_xlim(0.0, MILLI * _DRAWN_TIME)
    panels[0].set(title='(a) positions', ylabel='height from rest (mm)', ylim=(-2.0, 16.5))
    panels[1].set(
        title='(b) velocities', xlabel='time $t$ (ms)', ylabel='velocity (m/s)', ylim=(-0.75, 1.75)
    )
    crossing = MILLI * throw.rig.crossing_time
    for k in range(1, int(MILLI * _DRAWN_TIME / crossing) + 1):
        for axes in panels:
            axes.axvline(k * crossing, color='0.9', lw=0.8, zorder=0)
        panels[0].text(k * crossing, 16.4, f'${k}\\,t_s$', color='0.5', ha='center', va='top')
    _quote_release(panels[1], throw, (1.2, 1.3), throw.ejection_speed)
    text = f'$V_p^*$ = {throw.peak_plate_speed:.3f} m/s'
    panels[1].text(15.9, throw.peak_plate_speed + 0.05, text, color=BARE, ha='right')
    return style.legend_below(figure, panels[0], columns=4)


def _quote_release(axes: Axes, throw: Throw, position: tuple[float, float], height: float) -> None:
    """Label the release at a height of the axes with its results."""
    axes.annotate(
        f'leaves at $t_e$ = {MILLI * throw.ejection_time:.3f} ms\nwith $V_e$ = '
        f'{throw.ejection_speed:.3f} m/s,\n'
        rf'$\alpha = (V_e / V_p^*)^2$ = {throw.energy_transfer:.3f}',
        xy=(MILLI * throw.ejection_time, height), xytext=position, va='center',
        arrowprops={'arrowstyle': '->', 'color': '0.3'},
    )


def draw_throw() -> Figure:
    """Draw the picture of the README: a throw of the default rig, with the strain of the layer."""
    rig = Rig()
    throw = simulate(rig, until=_README_TIME)
    time = np.linspace(0.0, _README_TIME, 1101)
    states, _ = throw.trajectory(time)
    heights, strain = heights_of_layer(throw, time, points=97)

    figure = Figure(figsize=(style.WIDTH, 4.8), layout='constrained')
    axes = figure.subplots()
    limit = 100.0 * np.abs(strain).max()
    corners = 0.5 * (strain[:-1] + strain[1:])
    image = axes.pcolormesh(
        np.broadcast_to(MILLI * time[:, None], heights.shape), MILLI * heights,
        50.0 * (corners[:, :-1] + corners[:, 1:]), vmin=-limit, vmax=limit, rasterized=True,
        cmap=mpl.colormaps['PuOr'].resampled(48),  # bands halve the size of the file
    )
    figure.colorbar(image, label='strain of the layer (%)', pad=0.01)
    for material in (24, 48, 72):
        axes.plot(MILLI * time, MILLI * heights[:, material], color='0.35', lw=0.6)
    axes.plot(MILLI * time, MILLI * heights[:, -1], color='0.35', lw=1.0)
    axes.plot(MILLI * time, MILLI * states[:, PLATE_POSITION], color=PLATE, lw=2.5)
    lower = MILLI * states[:, PROJECTILE_POSITION]
    upper = lower + MILLI * rig.projectile.length
    axes.fill_between(MILLI * time, lower, upper, color=PROJECTILE, alpha=0.85)
    # A projectile on the bare plate leaves at the largest speed of the plate
    after = time >= Underdamped.of(rig.engine).peak_velocity_time
    bare = rig.layer.thickness + bare_flight(throw, time[after])
    axes.plot(MILLI * time[after], MILLI * bare, color=BARE, lw=1.8, ls=(0, (4, 2)))
    axes.axvline(MILLI * throw.ejection_time, color='0.5', lw=0.8, ls=':')
    _quote_release(axes, throw, (1.0, 40.0), MILLI * throw.events[0].position)
    for text, x, y, color, angle in (
        ('projectile', 13.6, 32.2, 'white', 27.0),
        ('from a bare plate, $\\alpha$ = 1', 15.6, 23.9, BARE, 10.5),
        ('soft layer', 17.4, 12.9, '0.1', 0.0),
        ('plate', 19.3, -0.3, PLATE, 0.0),
    ):
        axes.text(x, y, text, color=color, rotation=angle, rotation_mode='anchor')
    axes.set(xlabel='time $t$ (ms)', ylabel='height $z$ (mm)', xlim=(0.0, 22.0), ylim=(-1.0, 47.0))
    return figure


def save_animation(path: Path) -> None:
    """Write a throw of the default rig as an animated GIF, which repeats without end."""
    throw = simulate(Rig(), until=_README_TIME)
    # Displacements are integrals of velocities, so heights need smaller steps than frames.
    time = np.linspace(0.0, _README_TIME, 1 + 10 * round(_README_TIME / _FRAME))
    heights, strain = heights_of_layer(throw, time, points=61)
    limit = 100.0 * np.abs(strain[time < throw.ejection_time]).max()  # colours of Fig. 1
    bare_release = Underdamped.of(throw.rig.engine).peak_velocity_time
    frames = [*range(0, time.size, 10), *[time.size - 1] * _PAUSE]
    with style.settings():
        figure = Figure(figsize=(4.6, 4.6), layout='constrained')
        axes = figure.subplots()
        image = draw_state(axes, throw, 0.0, heights[0], strain[0], limit)
        figure.colorbar(image, ax=axes, label='strain of the layer (%)', shrink=0.7,
                        extend='both')

        def draw(row: int) -> tuple[()]:
            axes.clear()
            draw_state(axes, throw, time[row], heights[row], strain[row], limit)
            axes.set(xlim=(-15.5, 15.5), ylim=(-8.0, 48.0), xticks=[], aspect='equal')
            axes.spines['bottom'].set_visible(False)
            axes.set_ylabel('height $z$ (mm)')
            axes.set_title(f'$t$ = {MILLI * time[row]:4.1f} ms', loc='left')
            for x, name, color, release, speed in (
                (-7.5, 'bare plate', BARE, bare_release, throw.peak_plate_speed),
                (7.5, 'on the layer', PROJECTILE, throw.ejection_time, throw.ejection_speed),
            ):
                text = f'{name}\n{speed:.2f} m/s' if time[row] >= release else name
                axes.text(x, -2.0, text, color=color, ha='center', va='top')
            return ()

        animation = FuncAnimation(figure, draw, frames=frames)
        animation.save(path, writer=PillowWriter(fps=_RATE), dpi=90)
