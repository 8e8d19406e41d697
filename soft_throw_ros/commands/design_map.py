# SPDX-License-Identifier: Apache-2.0
"""Map ejection time and energy transfer over two axes: into files, a picture, a viewer."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
import errno
import importlib.util
import math
import os
from pathlib import Path
import sys
from typing import Any, get_args, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from soft_throw_ros.commands.executors import (
    add_executor_options,
    open_executor,
    WorkersLostError,
)
from soft_throw_ros.commands.options import add_rig_options, read_settings, slow_notice
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.configuration.atomic_file import atomic_file
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.design.landscape import (
    AXES,
    compute_landscape,
    Landscape,
    LandscapeAxis,
    MODELS,
    Release,
    RESULTS,
)
from soft_throw_ros.recording.viewer import has_display, HOST, listens, Viewer, ViewerError
from tqdm import tqdm

if TYPE_CHECKING:
    from soft_throw_ros.recording import rerun_canvas

_POINTS = 256

PORT = 9876
"""Where a viewer of Rerun is, or will be."""

_SHOW_TIME = 20.0  # for a viewer to take a map [s]

_RANGES = {
    'x': '0.005:0.995',
    'C': '0.05:14',
    'mu': '0.01:10:log',
    'kappa': '0.5:50:log',
    'engine.damping_ratio': '0:0.3',
    'layer.thickness': '0.001:0.05',
    'layer.wave_speed': '1:50',
}
"""What is mapped if an axis is given by its name alone."""

_SHOWN = {'m': ('mm', 1e3), 'kg': ('g', 1e3)}
"""Units of axes that pictures have in another size."""

_PLAIN = {
    'mu': '\N{GREEK SMALL LETTER MU}',
    'kappa': 'κ',
    'engine.frequency': 'f',
    'engine.amplitude': 'A',
    'engine.damping_ratio': 'ζ',
    'layer.thickness': 'Lₛ',
    'layer.wave_speed': 'cₛ',
    'layer.density': '\N{GREEK SMALL LETTER RHO}ₛ',
    'layer.diameter': 'D',
    'layer.loss_tangent': 'tan δ',
    'projectile.mass': 'm',
    'gravity': 'g',
    'ejection_phase': 'tₑ f',
    'energy_transfer': '\N{GREEK SMALL LETTER ALPHA}',
}
"""Symbols of axes and results where there is no TeX, if they are not their names."""

Floats = NDArray[np.float64]


class OutputError(ValueError):
    """A file cannot be written."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the task."""
    parser.usage = (
        '%(prog)s [-h] [AXIS AXIS] [--model NAME] [--release first|last] [--output FILE ...] '
        '[--rerun] [--workers N | --dask ADDRESS] [--config FILE] [--thickness M ...]'
    )
    parser.epilog = (
        'An axis is NAME or NAME=LOW:HIGH, followed by :COUNT and :log as you like: '
        f'layer.thickness=0.002:0.03:512. Names: {", ".join(AXES)}.'
    )
    parser.add_argument(
        'axes', metavar='AXIS', nargs='*', help="two of them (default: the paper's, x and C)"
    )
    parser.add_argument(
        '--model',
        choices=MODELS,
        help=f'one of {", ".join(MODELS)} '
        '(default travelling_wave, or finite_difference with loss)',
        metavar='NAME',
    )
    parser.add_argument(
        '--release', choices=get_args(Release), default='first', help='which one (default first)'
    )
    parser.add_argument(
        '--density-ratio',
        metavar='NUMBER',
        type=float,
        help="projectile over layer, for x and C (default: the rig's; 1 in the paper's maps)",
    )
    parser.add_argument(
        '--output',
        metavar='FILE',
        nargs='+',
        type=Path,
        default=[],
        help='.npz (NumPy), .nc (NetCDF), .png (picture) or .rrd (recording of Rerun)',
    )
    parser.add_argument(
        '--rerun',
        action='store_true',
        help=f'show it in a viewer of Rerun, that at {HOST}:{PORT} if there is one',
    )
    add_executor_options(parser)
    add_rig_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """
    Compute the map, and hand it to whoever is to have it.

    Parameters
    ----------
    arguments : Namespace
        As `add_arguments` defines them.

    Returns
    -------
    int
        0, or 130 after Ctrl-C, or 1 if the workers are gone.

    Raises
    ------
    ValueError
        If something is refused, saying what.

    """
    rig = rig_of(read_settings(arguments))
    axes = _read_axes(arguments.axes or ['x', 'C'])
    for path in arguments.output:
        _check_output(path)
    if arguments.rerun:
        _check_viewer()
    has_loss = rig.layer.loss_tangent > 0.0 or 'layer.loss_tangent' in axes
    total = int(np.prod([values.size for values in axes.values()]))
    try:
        with (
            slow_notice('design map'),
            open_executor(arguments) as executor,
            tqdm(total=total, unit=' throws', disable=None, delay=0.5, leave=False) as bar,
        ):
            landscape = compute_landscape(
                rig,
                axes,
                model=arguments.model or ('finite_difference' if has_loss else 'travelling_wave'),
                release=arguments.release,
                density_ratio=arguments.density_ratio,
                executor=executor,
                progress=bar.update,
            )
        for path in arguments.output:
            _WRITERS[path.suffix](landscape, path)
        if arguments.rerun:
            _view(landscape)
    except OSError as error:
        raise OutputError(f'{error.filename}: {error.strerror}') from None
    except KeyboardInterrupt:
        print('design map: stopped, and nothing written', file=sys.stderr)
        return 130
    except WorkersLostError as error:
        print(f'design map: {error}; nothing is written', file=sys.stderr)
        return 1
    print(describe(landscape), end='')
    return 0


def _read_axes(texts: list[str]) -> dict[str, Floats]:
    """Read the two axes of the command line."""
    if len(texts) != 2:
        raise ValueError(f'AXIS must be given twice or not at all, got {" ".join(texts)}')
    return dict(_read_axis(text) for text in texts)


def _read_axis(text: str) -> tuple[str, Floats]:
    """Read NAME=LOW:HIGH:COUNT:log, of which all but the name may be missing."""
    name, _, rest = text.partition('=')
    if name not in AXES:
        raise ValueError(f'no axis is named {name!r}; there are: {", ".join(AXES)}')
    if not rest:
        if name not in _RANGES:
            raise ValueError(f'{name} needs a range: {name}=LOW:HIGH')
        rest = _RANGES[name]
    parts = rest.split(':')
    spaced = np.geomspace if parts[-1] == 'log' else np.linspace
    try:
        low, high, *count = parts[: len(parts) - (parts[-1] == 'log')]
        bounds = float(low), float(high)
        (points,) = map(int, count) if count else (_POINTS,)
    except ValueError:
        raise ValueError(
            f'an axis is NAME=LOW:HIGH, followed by :COUNT and :log as you like, got {text!r}'
        ) from None
    if not bounds[0] < bounds[1]:
        raise ValueError(f'{name} must go from a lower to a higher value, got {text!r}')
    if points < 2:
        raise ValueError(f'{name} must have at least 2 points, got {text!r}')
    for bound in bounds:
        LandscapeAxis(name=name, values=np.array([bound]))
    if spaced is np.geomspace and bounds[0] == 0.0:
        raise ValueError(f'{name} cannot begin at 0 with :log, got {text!r}')
    return name, spaced(*bounds, points)


def _check_output(path: Path) -> None:
    """Refuse before the work what could not be written after it."""
    if path.suffix not in _WRITERS:
        raise OutputError(f'--output must end on {", ".join(_WRITERS)}, got {str(path)!r}')
    if not path.parent.is_dir():
        raise OutputError(f'{path}: there is no folder {path.parent}')
    for suffix, needed, what, extra in (
        ('.png', 'matplotlib', 'pictures', 'plot'),
        ('.rrd', 'rerun', 'recordings of Rerun', 'rerun'),
    ):
        if path.suffix == suffix and importlib.util.find_spec(needed) is None:
            raise OutputError(
                f"{path}: {what} need what pip installs with 'soft_throw_ros[{extra}]'"
            )


def _check_viewer() -> None:
    """Refuse before the work what could not be shown after it."""
    if importlib.util.find_spec('rerun') is None:
        raise OutputError("--rerun needs what pip installs with 'soft_throw_ros[rerun]'")
    if not listens(PORT) and not has_display():
        raise OutputError(
            '--rerun: there is no screen for a window; take --output FILE.rrd, or start a viewer '
            f'that listens at {HOST}:{PORT}'
        )


def describe(landscape: Landscape) -> str:
    """Tell the largest energy transfer and where it is, in a few lines."""
    first, second = landscape.axes
    size = f'{first.values.size} x {second.values.size}'
    lines = [f'{size} throws, {landscape.release} release by {landscape.model}']
    optimum = landscape.optimum
    if optimum is None:
        lines.append('the projectile leaves nowhere')
    else:
        place = ', '.join(
            f'{axis.name} {value:.5g} {axis.quantity.unit}'.rstrip()
            for axis, value in zip(landscape.axes, optimum.place, strict=True)
        )
        lines.append(
            f'largest alpha {optimum.energy_transfer:.4f} at {place}; '
            f't_e f {optimum.ejection_phase:.4f}'
        )
    lost = int(np.isnan(landscape.energy_transfer).sum())
    if lost:
        lines.append(f'{lost} throws without a release, or with one that cannot be told')
    if landscape.left_out:
        lines.append(f'left out by this model: {", ".join(landscape.left_out)}')
    return '\n'.join(lines) + '\n'


def draw(landscape: Landscape, path: Path, *, mark: Rig | None = None) -> None:
    """
    Draw ejection phase and energy transfer side by side, with optimum, ridge and a rig marked.

    Parameters
    ----------
    landscape : Landscape
        With two or more values along each axis.
    path : Path
        Of a PNG file.
    mark : Rig, optional
        Is marked if it is within the axes; that of the landscape if not given.

    Raises
    ------
    ModuleNotFoundError
        If matplotlib is not installed.
    OSError
        If the file cannot be written.

    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    (x, x_scale, x_label), (y, y_scale, y_label) = map(_shown, landscape.axes)
    figure = Figure(figsize=(9.6, 4.6), layout='constrained')
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    # Both maps of colours grow evenly in lightness, whatever the eyes
    for panel, (name, quantity), colours in zip(
        panels, RESULTS.items(), ('magma', 'viridis'), strict=True
    ):
        values = getattr(landscape, name)
        highest = _highest(landscape, name)
        image = panel.pcolormesh(
            x, y, values.T, cmap=colours, vmin=0.0, vmax=highest, shading='nearest'
        )
        figure.colorbar(
            image,
            label=f'{quantity.meaning.lower()} ${quantity.symbol}$',
            extend='neither' if highest is None else 'max',
        )
        panel.set(xscale=x_scale, yscale=y_scale, xlabel=x_label, ylabel=y_label)
        panel.set(xlim=(x[0], x[-1]), ylim=(y[0], y[-1]), facecolor='0.75')
        for axis, scale in ((panel.xaxis, x_scale), (panel.yaxis, y_scale)):
            if scale == 'log':
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter(StrMethodFormatter('{x:g}'))
                axis.set_minor_formatter(NullFormatter())
        panel.plot(x, _ridge(landscape, y), color='white', lw=1.0, ls=(0, (4, 2)), label='ridge')
        for label, marker, place in _marks(landscape, mark or landscape.rig):
            panel.plot(*place, marker, mfc='white', mec='black', ms=9, ls='', label=label)
    figure.suptitle(_title(landscape), fontsize='medium')
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc='outside lower center',
        ncols=3,
        facecolor='0.5',
        labelcolor='white',
    )
    with atomic_file(path) as unfinished:
        figure.savefig(unfinished, format='png', dpi=150, metadata={'Software': None})


def record(landscape: Landscape, path: Path) -> None:
    """
    Write a landscape as a recording of Rerun.

    Parameters
    ----------
    landscape : Landscape
        With two or more values along each axis.
    path : Path
        Of an .rrd file.

    Raises
    ------
    ModuleNotFoundError
        If Rerun is not installed.
    OSError
        If the file cannot be written.

    """
    from soft_throw_ros.recording import rerun_canvas

    with atomic_file(path) as unfinished:
        stream = rerun_canvas.new_stream()
        rerun_canvas.save_to(stream, unfinished, is_live=False)
        _send(landscape, stream)
        is_written = rerun_canvas.flush(stream, math.inf)
        stream.disconnect()
        if not is_written:
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))


def _view(landscape: Landscape) -> None:
    """Show a landscape in the viewer that is there, or in one that stays."""
    from soft_throw_ros.recording import rerun_canvas

    try:
        if not listens(PORT):
            Viewer(PORT, '--hide-welcome-screen', '--expect-data-soon', stays=True)
        stream = rerun_canvas.new_stream()
        rerun_canvas.connect_to(stream, PORT)
        _send(landscape, stream)
        is_shown = rerun_canvas.flush(stream, _SHOW_TIME)
        stream.disconnect()
    except ViewerError as error:
        raise OutputError(f'--rerun: {error}') from None
    if not is_shown:
        raise OutputError(f'--rerun: the viewer at {HOST}:{PORT} does not take it')


def _send(landscape: Landscape, stream: Any) -> None:
    """Draw a landscape into a recording of Rerun."""
    from soft_throw_ros.recording import rerun_canvas

    rerun_canvas.draw_landscape(
        stream,
        name=str(landscape.attributes['title']),
        axes=(_map_axis(landscape.axes[0]), _map_axis(landscape.axes[1])),
        panels=[
            rerun_canvas.MapPanel(
                name=name,
                title=RESULTS[name].meaning,
                symbol=_PLAIN[name],
                values=getattr(landscape, name),
                highest=_highest(landscape, name),
            )
            for name in RESULTS
        ],
        marks=[
            (place[0], place[1], label.replace(r'$\alpha$', _PLAIN['energy_transfer']))
            for label, _, place in _marks(landscape, landscape.rig)
        ],
    )


def _map_axis(axis: LandscapeAxis) -> rerun_canvas.MapAxis:
    from soft_throw_ros.recording import rerun_canvas

    unit, factor = _SHOWN.get(axis.quantity.unit, (axis.quantity.unit, 1.0))
    symbol = _PLAIN.get(axis.name, axis.name)
    title = f'{symbol} ({unit})' if unit else symbol
    return rerun_canvas.MapAxis(title=title, values=factor * axis.values)


def _highest(landscape: Landscape, name: str) -> float | None:
    """Say where the colours of a result end; None is at its largest value."""
    if name == 'ejection_phase' and landscape.optimum is not None:
        # some are so late that all others look alike
        return float(np.nanpercentile(landscape.ejection_phase, 95.0))
    return None


def _title(landscape: Landscape) -> str:
    """Name model and release, and of the rig what is no axis and counts."""
    names = [axis.name for axis in landscape.axes]
    fixed = [
        f'${AXES[name].symbol}$ = {value:g}{unit}'
        for name, value, unit in (
            ('engine.damping_ratio', landscape.rig.engine.damping_ratio, ''),
            ('layer.loss_tangent', landscape.rig.layer.loss_tangent, ''),
            ('gravity', landscape.rig.gravity, ' m/s$^2$'),
        )
        if value > 0.0 and name not in (*names, *landscape.left_out)
    ]
    model = landscape.model.replace('_', ' ')
    return ', '.join([f'{landscape.release} release by the model {model}', *fixed])


def _shown(axis: LandscapeAxis) -> tuple[Floats, str, str]:
    """Return the values of an axis as they are drawn, its scale and its label."""
    quantity = axis.quantity
    unit, factor = _SHOWN.get(quantity.unit, (quantity.unit, 1.0))
    values = factor * axis.values
    is_log = values.size > 2 and values[0] > 0.0 and np.ptp(np.diff(np.log(values))) < 1e-9
    words = axis.name.rpartition('.')[2].replace('_', ' ') if axis.name in TWIN.by_name else ''
    label = f'{words} ${quantity.symbol}$' + (f' ({unit})' if unit else '')
    return values, 'log' if is_log else 'linear', label.strip()


def _marks(landscape: Landscape, rig: Rig) -> Iterator[tuple[str, str, list[float]]]:
    """Give label, marker and place of the highest point, and of a rig that is on the map."""
    places = [('this rig', 'o', landscape.place(rig))]
    if landscape.optimum is not None:
        label = rf'largest $\alpha$, {landscape.optimum.energy_transfer:.3f}'
        places.append((label, '*', landscape.optimum.place))
    for label, marker, place in places:
        if all(
            axis.values[0] <= value <= axis.values[-1]
            for axis, value in zip(landscape.axes, place, strict=True)
        ):
            factors = (_SHOWN.get(axis.quantity.unit, ('', 1.0))[1] for axis in landscape.axes)
            yield label, marker, [f * value for f, value in zip(factors, place, strict=True)]


def _ridge(landscape: Landscape, y: Floats) -> Floats:
    """Return for each value across where upwards the energy is largest; NaN at an end or gap."""
    transfer = np.nan_to_num(landscape.energy_transfer, nan=-1.0)
    rows = transfer.argmax(axis=1)
    ridge = np.where((rows > 0) & (rows < y.size - 1), y[rows], np.nan)
    ridge[np.flatnonzero(np.abs(np.diff(rows)) > 0.05 * y.size)] = np.nan
    return ridge


_WRITERS: dict[str, Any] = {
    '.npz': Landscape.save,
    '.nc': Landscape.save,
    '.png': draw,
    '.rrd': record,
}
