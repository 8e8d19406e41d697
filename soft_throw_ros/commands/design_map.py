# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Map ejection time and energy transfer over two axes: into a file and a picture."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
import re
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.commands import options, output
from soft_throw_ros.commands.output import CommandParser
from soft_throw_ros.configuration import rig_of
from soft_throw_ros.design.landscape import AXES, compute_landscape, Landscape, Release, RESULTS

Floats = NDArray[np.float64]

_RANGE = re.compile(r'([^:-][^:]*):([^:]+)(?::([2-9]|[1-9]\d+))?(:log)?')
_RATIOS = {'x': '0.005:0.995', 'C': '0.05:14', 'mu': '0.01:10:log', 'kappa': '0.5:50:log'}
"""Ranges of ratios that are given by name alone."""


def add_arguments(parser: CommandParser) -> None:
    """Add the arguments of the task."""
    parser.usage = '%(prog)s [OPTION ...] [AXIS AXIS]'
    parser.epilog = (
        'An axis is NAME=LOW:HIGH, optionally followed by :COUNT and :log: '
        f'layer.thickness=0.002:0.03:512. Names: {", ".join(AXES)}; the first four need no range.'
    )
    add = parser.add_argument
    add('axes', metavar='AXIS', nargs='*', help='two axes (default: x and C, as in the paper)')
    add(
        '--release', choices=get_args(Release), default='first',
        help='first or last release of a throw (default first)',
    )
    add(
        '--output', metavar='FILE', nargs='+', type=options.new_file(*_WRITERS), default=[],
        help='.nc (NetCDF) or .png (picture)',
    )
    options.add_dask_option(parser)
    options.add_rig_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Compute, save and summarise the map; return 0."""
    rig = rig_of(options.read_settings(arguments))
    axes = dict(map(_read_axis, arguments.axes or ['x', 'C']))
    with output.slow_notice('design map'), options.open_map(arguments.dask) as run_blocks:
        landscape = compute_landscape(rig, axes, release=arguments.release, run=run_blocks)
    for path in arguments.output:
        with output.written_file(path) as unfinished:
            _WRITERS[path.suffix](landscape, unfinished)
    output.print_lines(_summary(landscape))
    return 0


def _read_axis(text: str) -> tuple[str, Floats]:
    """Parse NAME=LOW:HIGH, optionally followed by :COUNT and :log, or the name of a ratio."""
    name, _, value_range = text.partition('=')
    match = _RANGE.fullmatch(value_range or _RATIOS.get(name, ''))
    low, high, count, log = match.groups() if match else ('',) * 4
    try:
        space = np.geomspace if log else np.linspace
        return name, space(float(low), float(high), int(count or 256))
    except ValueError:
        raise ValueError(
            'AXIS must be NAME=LOW:HIGH, optionally followed by :COUNT and :log, with LOW above 0 '
            f'for :log and COUNT of 2 or more, got {text!r}'
        ) from None


def _summary(landscape: Landscape) -> Iterator[str]:
    """Describe the largest energy transfer and its position in a few lines."""
    if optimum := landscape.optimum:
        position = ', '.join(
            f'{name} {value:.5g} {AXES[name].unit}'.rstrip()
            for name, value in zip(landscape.axes, optimum.coordinates, strict=True)
        )
        yield (
            f'largest alpha {optimum.energy_transfer:.4f} at {position}; '
            f't_e f {optimum.ejection_phase:.4f}'
        )
    else:
        yield 'the projectile is released nowhere on the map'
    size = ' x '.join(str(values.size) for values in landscape.axes.values())
    lost = int(np.isnan(landscape.energy_transfer).sum())
    yield f'{size} throws, {landscape.release} release; {lost} have none that can be resolved'


def _draw(landscape: Landscape, path: Path) -> None:
    """Draw both results of a map side by side, with optimum and rig, into a PNG file."""
    from matplotlib.figure import Figure
    from soft_throw_ros.recording.charts import draw_map, to_png

    axes = {
        f'{AXES[name].symbol} ({AXES[name].unit})'.replace(' ()', ''): values
        for name, values in landscape.axes.items()
    }
    figure = Figure(figsize=(9.6, 4.6), layout='constrained')
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    # A few very late releases would leave all others the same colour.
    late = float(np.nanpercentile(landscape.ejection_phase, 95.0)) if landscape.optimum else None
    # The lightness of both colour maps grows evenly, for colour-blind readers, too.
    for panel, name, colours, highest in zip(
        panels, RESULTS, ('magma', 'viridis'), (late, None), strict=True
    ):
        draw_map(
            panel, axes, getattr(landscape, name),
            label=f'{RESULTS[name].meaning.lower()} {RESULTS[name].symbol}',
            colours=colours, highest=highest, marks=list(_marks(landscape)),
        )
    figure.suptitle(f'{landscape.release} release', fontsize='medium')
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc='outside lower center', ncols=2,
        facecolor='0.5', labelcolor='white',
    )
    path.write_bytes(to_png(figure, dpi=150))


def _marks(landscape: Landscape) -> Iterator[tuple[str, float, float]]:
    """Yield title and position of the rig and of the optimum, if they are on the map."""
    marks = [('this rig', landscape.coordinates_of(landscape.rig))]
    if optimum := landscape.optimum:
        marks.append((f'largest α, {optimum.energy_transfer:.3f}', optimum.coordinates))
    for title, position in marks:
        pairs = zip(position, landscape.axes.values(), strict=True)
        if all(values[0] <= value <= values[-1] for value, values in pairs):
            yield title, *position


_WRITERS: Mapping[str, Callable[[Landscape, Path], None]] = {
    '.nc': Landscape.save, '.png': _draw,
}
