# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Map ejection time and energy transfer over two axes: into a file and a picture."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
import math
from pathlib import Path
from typing import get_args, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.commands.options import (
    add_executor_options,
    add_rig_options,
    new_file,
    open_executor,
    read_settings,
    WorkersLostError,
)
from soft_throw_ros.commands.output import (
    CommandParser,
    print_lines,
    print_note,
    slow_notice,
    written_file,
)
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.design.landscape import (
    AXES,
    check_axis,
    compute_landscape,
    Landscape,
    Release,
    RESULTS,
)
from tqdm import tqdm

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

_POINTS = 256
"""Default number of points of an axis. [-]"""

_DPI = 150
"""Resolution of the picture. [pixel/inch]"""

_RANGES = {'x': '0.005:0.995', 'C': '0.05:14', 'mu': '0.01:10:log', 'kappa': '0.5:50:log'}
"""Ranges of ratios that are given by name alone."""

_UNITS = {'m': ('mm', 1e3), 'kg': ('g', 1e3)}
"""Units of axes in pictures, where they differ from SI, and the factors from SI."""


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
        '--output', metavar='FILE', nargs='+', type=new_file(*_WRITERS), default=[],
        help='.nc (NetCDF) or .png (picture)',
    )
    add_executor_options(parser)
    add_rig_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Compute and save the map; return 0, 130 after Ctrl-C, or 1 if workers are lost."""
    rig = rig_of(read_settings(arguments))
    names = arguments.axes or ['x', 'C']
    if len(names) != 2:
        raise ValueError(f'AXIS must be given twice or not at all, got {" ".join(names)}')
    axes = dict(map(_read_axis, names))
    total = math.prod(values.size for values in axes.values())
    try:
        with (
            slow_notice('design map'),
            open_executor(arguments) as executor,
            tqdm(total=total, unit=' throws', disable=None, delay=0.5, leave=False) as bar,
        ):
            landscape = compute_landscape(
                rig,
                axes,
                release=arguments.release,
                executor=executor,
                progress=bar.update,
            )
        for path in arguments.output:
            with written_file(path) as unfinished:
                _WRITERS[path.suffix](landscape, unfinished)
    except KeyboardInterrupt:
        print_note('design map', 'stopped, and nothing written')
        return 130
    except WorkersLostError as error:
        print_note('design map', f'{error}; nothing is written')
        return 1
    print_lines(_summary(landscape))
    return 0


def _read_axis(text: str) -> tuple[str, Floats]:
    """Parse NAME=LOW:HIGH, optionally followed by :COUNT and :log, or the name of a ratio."""
    name, _, value_range = text.partition('=')
    if name not in AXES:
        raise ValueError(f'unknown axis {name!r}; choose from {", ".join(AXES)}')
    fields = (value_range or _RANGES.get(name, '')).split(':')
    is_log = fields[-1] == 'log'
    try:
        low, high, *count = fields[: len(fields) - is_log]
        bounds = float(low), float(high)
        (points,) = map(int, count) if count else (_POINTS,)
    except ValueError:
        raise ValueError(
            f'an axis is {name}=LOW:HIGH, optionally followed by :COUNT and :log, got {text!r}'
        ) from None
    if not bounds[0] < bounds[1]:
        raise ValueError(f'{name} must go from a lower to a higher value, got {text!r}')
    if points < 2:
        raise ValueError(f'{name} must have at least 2 points, got {text!r}')
    check_axis(name, bounds)
    if is_log and bounds[0] == 0.0:
        raise ValueError(f'{name} cannot begin at 0 with :log, got {text!r}')
    return name, (np.geomspace if is_log else np.linspace)(*bounds, points)


def _summary(landscape: Landscape) -> Iterator[str]:
    """Describe the largest energy transfer and its position in a few lines."""
    optimum = landscape.optimum
    if optimum is None:
        yield 'the projectile is released nowhere on the map'
    else:
        position = ', '.join(
            f'{name} {value:.5g} {AXES[name].unit}'.rstrip()
            for name, value in zip(landscape.axes, optimum.coordinates, strict=True)
        )
        yield (
            f'largest alpha {optimum.energy_transfer:.4f} at {position}; '
            f't_e f {optimum.ejection_phase:.4f}'
        )
    size = ' x '.join(str(values.size) for values in landscape.axes.values())
    lost = int(np.isnan(landscape.energy_transfer).sum())
    yield f'{size} throws, {landscape.release} release; {lost} have none that can be resolved'


def _shown_axis(name: str) -> tuple[str, float]:
    """Return the title of an axis in pictures, and the factor from SI to the unit there."""
    symbol, unit, _ = AXES[name]
    unit, factor = _UNITS.get(unit, (unit, 1.0))
    title = f'{symbol} ({unit})' if unit else symbol
    if name in TWIN.by_name:
        title = f'{name.rpartition(".")[2].replace("_", " ")} {title}'
    return title, factor


def draw(landscape: Landscape) -> Figure:
    """Draw both results of a map side by side, with optimum and rig."""
    from matplotlib.figure import Figure
    from soft_throw_ros.recording.charts import draw_map, MapAxis

    titles, factors = zip(*map(_shown_axis, landscape.axes), strict=True)
    values = [factor * axis for factor, axis in zip(factors, landscape.axes.values(), strict=True)]
    marks = [
        (title, *np.multiply(factors, position)) for title, position in _marks(landscape)
    ]
    figure = Figure(figsize=(9.6, 4.6), layout='constrained')
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    # The lightness of both colour maps grows evenly, for colour-blind readers, too.
    for panel, name, colours in zip(panels, RESULTS, ('magma', 'viridis'), strict=True):
        quantity = RESULTS[name]
        draw_map(
            panel,
            (MapAxis(titles[0], values[0]), MapAxis(titles[1], values[1])),
            getattr(landscape, name),
            label=f'{quantity.meaning.lower()} {quantity.symbol}',
            colours=colours,
            highest=_highest(landscape, name),
            marks=marks,
        )
    figure.suptitle(_title(landscape), fontsize='medium')
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc='outside lower center', ncols=2,
        facecolor='0.5', labelcolor='white',
    )
    return figure


def _draw_file(landscape: Landscape, path: Path) -> None:
    """Draw a landscape into a PNG file."""
    from soft_throw_ros.recording.charts import to_png

    path.write_bytes(to_png(draw(landscape), dpi=_DPI))


def _highest(landscape: Landscape, name: str) -> float | None:
    """Return the upper end of the colour scale of a result, None for its largest value."""
    if name == 'ejection_phase' and landscape.optimum is not None:
        # A few very late releases would leave all others the same colour.
        return float(np.nanpercentile(landscape.ejection_phase, 95.0))
    return None


def _title(landscape: Landscape) -> str:
    """Name the release, and the values of the rig that are no axes."""
    rig = landscape.rig
    fixed = [
        f'{AXES[name].symbol} = {value:g} {TWIN.by_name[name].unit}'.rstrip()
        for name, value in (
            ('engine.damping_ratio', rig.engine.damping_ratio),
            ('layer.loss_tangent', rig.layer.loss_tangent),
            ('gravity', rig.gravity),
        )
        if value > 0.0 and name not in landscape.axes
    ]
    return ', '.join([f'{landscape.release} release', *fixed])


def _marks(landscape: Landscape) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield title and position of the rig and of the optimum, if they are on the map."""
    marks = [('this rig', landscape.coordinates_of(landscape.rig))]
    optimum, symbol = landscape.optimum, RESULTS['energy_transfer'].symbol
    if optimum is not None:
        marks.append((f'largest {symbol}, {optimum.energy_transfer:.3f}', optimum.coordinates))
    for title, position in marks:
        pairs = zip(position, landscape.axes.values(), strict=True)
        if all(values[0] <= value <= values[-1] for value, values in pairs):
            yield title, position


_WRITERS: Mapping[str, Callable[[Landscape, Path], None]] = {
    '.nc': Landscape.save, '.png': _draw_file,
}
