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
"""The animated picture of the README: one throw in slow motion, beside the bare plate."""

from __future__ import annotations

from pathlib import Path

from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.figure import Figure
import numpy as np
from soft_throw_ros.core.plate import Underdamped
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from style import MILLI, settings
from throws import BARE, draw_state, heights_of_layer, PROJECTILE

STEP = 2e-4
"""Time between two frames. [s]"""

END = 0.022
"""Time of the last frame. [s]"""

RATE = 15
"""Frames per second; with `STEP`, the picture is slower than the throw by a factor of 333. [Hz]"""

_PAUSE = 15
"""Number of frames for which the last picture stays. [-]"""

_DPI = 90
"""Resolution. [dots per inch]"""


def save_animation(path: Path) -> None:
    """Write a throw of the default rig as an animated GIF, which repeats without end."""
    throw = simulate(Rig(), until=END)
    # Displacements are integrals of velocities, so heights need smaller steps than frames.
    time = np.linspace(0.0, END, 1 + 10 * round(END / STEP))
    heights, strain = heights_of_layer(throw, time, points=61)
    limit = 100.0 * np.abs(strain[time < throw.ejection_time]).max()  # colours of Fig. 1
    bare_release = Underdamped.of(throw.rig.engine).peak_velocity_time
    frames = [*range(0, time.size, 10), *[time.size - 1] * _PAUSE]
    with settings():
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
        animation.save(path, writer=PillowWriter(fps=RATE), dpi=_DPI)
