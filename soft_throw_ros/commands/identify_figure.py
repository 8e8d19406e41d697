# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Figure of a fit: data, model and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from soft_throw_ros.commands.output import written_file
from soft_throw_ros.identification.ejection import Ejection
from soft_throw_ros.identification.rig_fit import RigFit

# Colours of Okabe and Ito, which colour-blind readers can distinguish
_COLOURS = {'plate': '#000000', 'projectile': '#0072b2'}
_PERIODS = 2.5  # length of the upper panel [plate periods]
_RISES = 2.2  # height of the upper panel over the rise of the plate [-]
_MAX_THROWS = 6  # largest number of throws in one figure


def draw_throws(
    result: RigFit, ejection: Ejection | None, summary: Sequence[str], path: Path
) -> None:
    """Draw the contact in tracks and model of some throws, all residuals, and a summary."""
    from matplotlib.figure import Figure

    model, bodies = result.model, ['plate', 'projectile'][: 1 + bool(result.model.projectiles)]
    figure = Figure(figsize=(9.6, 3.6 + 1.5 * len(bodies)), layout='constrained')
    above, *below = figure.subplots(1 + len(bodies), 1, height_ratios=[2.6, *[1.0] * len(bodies)])
    below[-1].sharex(below[0])
    highest = 0.0
    for (throw, body, _), residual in zip(model.series, result.fit.residuals, strict=True):
        if throw >= _MAX_THROWS:
            continue
        track, colour, start = residual.track, _COLOURS[body], result.start_time(throw).value
        fine = np.linspace(track.time[0], track.time[-1], 2000)
        times = np.concatenate([[start], fine])
        heights = model.trajectory(result.fit.values, throw, body, times).height
        rest = heights[0]
        if body == 'plate':
            highest = max(highest, 1e3 * float(np.ptp(track.position)))
        since = 1e3 * (track.time - start)
        label = body if throw == 0 else None
        above.plot(since, 1e3 * (track.position - rest), '.', color=colour, alpha=0.5)
        above.plot(1e3 * (fine - start), 1e3 * (heights[1:] - rest), color=colour, label=label)
        panel = below[bodies.index(body)]
        panel.axhspan(-2e6 * track.noise, 2e6 * track.noise, color='0.9', zorder=0)
        panel.plot(since, 1e6 * residual.values, '.', color=colour, alpha=0.5)
        panel.set(ylabel=f'{body},\ndata - model (µm)')
    period = 1e3 / result.rig.engine.frequency
    above.set(
        xlim=(-0.3 * period, _PERIODS * period), ylim=(-0.3 * highest, _RISES * highest),
        ylabel='height above rest (mm)',
    )
    above.legend(loc='upper right')
    below[-1].set_xlabel('time since the plate began to move (ms); dotted: release')
    if ejection is not None:
        for panel in (above, *below):
            panel.axvline(1e3 * ejection.first.time.value, color='0.4', ls=':')
    rows = [', '.join(summary[k:k + 3]) for k in range(0, len(summary), 3)]
    figure.suptitle('\n'.join(rows).replace('+-', '±'), fontsize='medium')
    with written_file(path) as unfinished:
        figure.savefig(unfinished, format=path.suffix[1:], dpi=150)
