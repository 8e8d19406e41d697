# SPDX-License-Identifier: Apache-2.0
"""Draw the pictures of the README: `make figures`."""

from pathlib import Path

import matplotlib as mpl

mpl.use('agg')

from matplotlib import pyplot as plt
import numpy as np
from scipy.integrate import cumulative_trapezoid
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate

# Okabe and Ito's colours, which everybody can tell apart
PLATE = '#000000'
PROJECTILE = '#0072b2'
BARE = '#d55e00'


def draw_throw(path: Path) -> None:
    """Draw plate, layer and projectile of the default rig against time."""
    rig = Rig()
    throw = simulate(rig, until=0.022)
    time = np.linspace(0.0, 0.022, 1101)
    path_of = throw.trajectory(time)
    fields = throw.fields(time, points=97)
    rest = fields.depth * (1.0 - rig.static_sag / rig.layer.thickness)
    height = rest + cumulative_trapezoid(fields.velocity, time, axis=0, initial=0.0)
    release = throw.ejection_time
    milli = 1e3

    figure, axes = plt.subplots(figsize=(8.4, 4.8), layout='constrained')
    limit = 100.0 * np.abs(fields.strain).max()
    strain = axes.pcolormesh(
        np.broadcast_to(milli * time[:, None], height.shape),
        milli * height,
        100.0 * fields.strain,
        cmap='PuOr',
        vmin=-limit,
        vmax=limit,
        shading='gouraud',
        rasterized=True,
    )
    figure.colorbar(strain, label='strain of the layer (%)', pad=0.01)
    for material in (24, 48, 72):
        axes.plot(milli * time, milli * height[:, material], color='0.35', lw=0.6)
    axes.plot(milli * time, milli * height[:, -1], color='0.35', lw=1.0)
    axes.plot(milli * time, milli * path_of.plate_position, color=PLATE, lw=2.5)
    lower = milli * path_of.projectile_position
    axes.fill_between(
        milli * time, lower, lower + milli * rig.projectile.length, color=PROJECTILE, alpha=0.85
    )
    # The same projectile lying on the plate itself leaves at the plate's largest speed
    bare = throw.history.motion.peak_velocity_time
    after = time[time >= bare]
    flight = throw.peak_plate_speed * (after - bare) - 0.5 * rig.gravity * (after - bare) ** 2
    start = throw.history.motion.position(bare) + rig.layer.thickness
    axes.plot(milli * after, milli * (start + flight), color=BARE, lw=1.8, ls=(0, (4, 2)))
    axes.axvline(milli * release, color='0.5', lw=0.8, ls=':')
    axes.annotate(
        f'leaves at $t_e$ = {milli * release:.2f} ms\n'
        f'with $V_e$ = {throw.ejection_speed:.3f} m/s,\n'
        rf'$\alpha = (V_e/V_p^*)^2$ = {throw.energy_transfer:.2f}',
        xy=(milli * release, milli * throw.first_release.position),
        xytext=(3.4, 39.0),
        ha='center',
        arrowprops={'arrowstyle': '->', 'color': '0.3'},
    )
    for text, x, y, color, angle in (
        ('projectile', 13.6, 32.2, 'white', 27.0),
        ('from a bare plate, $\\alpha$ = 1', 15.6, 23.9, BARE, 10.5),
        ('soft layer', 17.4, 12.9, '0.1', 0.0),
        ('plate', 19.3, -0.3, PLATE, 0.0),
    ):
        axes.text(x, y, text, color=color, rotation=angle, rotation_mode='anchor')
    axes.set(
        xlabel='time $t$ (ms)',
        ylabel='height $z$ (mm)',
        xlim=(0.0, 22.0),
        ylim=(-1.0, 47.0),
    )
    axes.spines[['top', 'right']].set_visible(False)
    figure.savefig(path, dpi=150, metadata={'Software': None})
    plt.close(figure)


if __name__ == '__main__':
    draw_throw(Path(__file__).with_name('throw.png'))
