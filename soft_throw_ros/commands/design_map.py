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
"""Map ejection time and energy transfer over two axes: into files, a picture, a viewer."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from functools import partial
import math
from pathlib import Path
import sys
from typing import get_args, NamedTuple, TYPE_CHECKING

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
from soft_throw_ros.commands.output import naming, print_text, require, slow_notice
from soft_throw_ros.commands.rerun_output import (
    check_viewer,
    new_stream,
    PORT,
    save_recording,
    send_recording,
)
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.configuration.atomic_file import atomic_file
from soft_throw_ros.design.landscape import (
    AXES,
    check_axis,
    compute_landscape,
    Landscape,
    MODELS,
    Release,
    RESULTS,
)
from soft_throw_ros.recording.viewer import HOST, ViewerError
from tqdm import tqdm

if TYPE_CHECKING:
    import rerun as rr

Floats = NDArray[np.float64]

_POINTS = 256

_SHOW_TIME = 20.0  # for a viewer to take a map [s]

_RANGES = {'x': '0.005:0.995', 'C': '0.05:14', 'mu': '0.01:10:log', 'kappa': '0.5:50:log'}
"""What is mapped if a ratio is given by its name alone."""

_UNITS = {'m': ('mm', 1e3), 'kg': ('g', 1e3)}
"""Units of axes that pictures have in another size."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the task."""
    parser.usage = (
        '%(prog)s [-h] [AXIS AXIS] [--model NAME] [--release first|last] [--output FILE ...] '
        '[--rerun] [--workers N | --dask ADDRESS] [--config FILE] [--thickness M ...]'
    )
    parser.epilog = (
        'An axis is NAME=LOW:HIGH, followed by :COUNT and :log as you like: '
        f'layer.thickness=0.002:0.03:512. Names: {", ".join(AXES)}; the first four need no range.'
    )
    add = parser.add_argument
    add('axes', metavar='AXIS', nargs='*', help="two of them (default: the paper's, x and C)")
    add(
        '--model', choices=MODELS, metavar='NAME',
        help=f'one of {", ".join(MODELS)} '
        '(default travelling_wave, or finite_difference with loss)',
    )
    add('--release', choices=get_args(Release), default='first', help='which one (default first)')
    add(
        '--output', metavar='FILE', nargs='+', type=new_file(*_WRITERS), default=[],
        help='.npz (NumPy), .nc (NetCDF), .png (picture) or .rrd (recording of Rerun)',
    )
    add(
        '--rerun', action='store_true',
        help=f'show it in a viewer of Rerun, that at {HOST}:{PORT} if there is one',
    )
    add_executor_options(parser)
    add_rig_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Compute and hand over the map; return 0, 130 after Ctrl-C, or 1 if workers are gone."""
    rig = rig_of(read_settings(arguments))
    names = arguments.axes or ['x', 'C']
    if len(names) != 2:
        raise ValueError(f'AXIS must be given twice or not at all, got {" ".join(names)}')
    axes = dict(map(_read_axis, names))
    has_cells = rig.layer.needs_cells or 'layer.loss_tangent' in axes
    total = math.prod(values.size for values in axes.values())
    try:
        if arguments.rerun:
            require('--rerun', 'rerun', 'rerun')
            check_viewer(PORT, '--output FILE.rrd')
        with (
            slow_notice('design map'),
            open_executor(arguments) as executor,
            tqdm(total=total, unit=' throws', disable=None, delay=0.5, leave=False) as bar,
        ):
            landscape = compute_landscape(
                rig,
                axes,
                model=arguments.model or ('finite_difference' if has_cells else 'travelling_wave'),
                release=arguments.release,
                executor=executor,
                progress=bar.update,
            )
        for path in arguments.output:
            with naming(path):
                _WRITERS[path.suffix](landscape, path)
        if arguments.rerun:
            _view(landscape)
    except ViewerError as error:
        raise ValueError(f'--rerun: {error}') from None
    except KeyboardInterrupt:
        print('design map: stopped, and nothing written', file=sys.stderr)
        return 130
    except WorkersLostError as error:
        print(f'design map: {error}; nothing is written', file=sys.stderr)
        return 1
    print_text('\n'.join(_summary(landscape)) + '\n')
    return 0


def _read_axis(text: str) -> tuple[str, Floats]:
    """Read NAME=LOW:HIGH:COUNT:log, of which the last two may be missing, or a ratio's name."""
    name, _, rest = text.partition('=')
    if name not in AXES:
        raise ValueError(f'no axis is named {name!r}; there are: {", ".join(AXES)}')
    parts = (rest or _RANGES.get(name, '')).split(':')
    is_log = parts[-1] == 'log'
    try:
        low, high, *count = parts[: len(parts) - is_log]
        bounds = float(low), float(high)
        (points,) = map(int, count) if count else (_POINTS,)
    except ValueError:
        raise ValueError(
            f'an axis is {name}=LOW:HIGH, followed by :COUNT and :log as you like, got {text!r}'
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
    """Tell the largest energy transfer and where it is, in a few lines."""
    size = ' x '.join(str(values.size) for values in landscape.axes.values())
    yield f'{size} throws, {landscape.release} release by {landscape.model}'
    optimum = landscape.optimum
    if optimum is None:
        yield 'the projectile leaves nowhere'
    else:
        place = ', '.join(
            f'{name} {value:.5g} {AXES[name].unit}'.rstrip()
            for name, value in zip(landscape.axes, optimum.place, strict=True)
        )
        yield (
            f'largest alpha {optimum.energy_transfer:.4f} at {place}; '
            f't_e f {optimum.ejection_phase:.4f}'
        )
    lost = int(np.isnan(landscape.energy_transfer).sum())
    if lost:
        yield f'{lost} throws without a release, or with one that cannot be told'
    if landscape.left_out:
        yield f'left out by this model: {", ".join(landscape.left_out)}'


class _Shown(NamedTuple):
    """An axis as it is drawn: its values in a unit of handy size, which is SI times `factor`."""

    title: str
    values: Floats
    factor: float

    @classmethod
    def of(cls, landscape: Landscape) -> list[_Shown]:
        """Return the two axes of a landscape."""
        shown = []
        for name, values in landscape.axes.items():
            symbol, unit, _ = AXES[name]
            unit, factor = _UNITS.get(unit, (unit, 1.0))
            title = f'{symbol} ({unit})' if unit else symbol
            if name in TWIN.by_name:
                title = f'{name.rpartition(".")[2].replace("_", " ")} {title}'
            shown.append(cls(title, factor * values, factor))
        return shown

    @property
    def scale(self) -> str:
        """How its values are spaced, for matplotlib."""
        values = self.values
        is_log = values.size > 2 and values[0] > 0.0 and np.ptp(np.diff(np.log(values))) < 1e-9
        return 'log' if is_log else 'linear'


def draw(landscape: Landscape, path: Path) -> None:
    """Draw both results of a map side by side into a PNG file, with optimum and rig."""
    from matplotlib.figure import Figure

    shown = _Shown.of(landscape)
    figure = Figure(figsize=(9.6, 4.6), layout='constrained')
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    # Both maps of colours grow evenly in lightness, whatever the eyes
    for panel, name, colours in zip(panels, RESULTS, ('magma', 'viridis'), strict=True):
        quantity, highest = RESULTS[name], _highest(landscape, name)
        image = panel.pcolormesh(
            *(axis.values for axis in shown), getattr(landscape, name).T, cmap=colours, vmin=0.0,
            vmax=highest, shading='nearest',
        )
        label = f'{quantity.meaning.lower()} {quantity.symbol}'
        figure.colorbar(image, label=label, extend='neither' if highest is None else 'max')
        panel.set(facecolor='0.75')
        for letter, axis in zip('xy', shown, strict=True):
            limits = (axis.values[0], axis.values[-1])
            panel.set(**{
                f'{letter}scale': axis.scale, f'{letter}label': axis.title, f'{letter}lim': limits
            })
        for marker, (title, *place) in zip('o*', _marks(landscape), strict=False):
            panel.plot(*place, marker, mfc='white', mec='black', ms=9, ls='', label=title)
    figure.suptitle(_title(landscape), fontsize='medium')
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc='outside lower center', ncols=2,
        facecolor='0.5', labelcolor='white',
    )
    with atomic_file(path) as unfinished:
        figure.savefig(unfinished, format='png', dpi=150, metadata={'Software': None})


def _record(landscape: Landscape, path: Path) -> None:
    """Write a landscape as a recording of Rerun."""
    stream = new_stream()
    with atomic_file(path) as unfinished:
        save_recording(stream, unfinished, partial(_send, landscape, stream))


def _view(landscape: Landscape) -> None:
    """Show a landscape in the viewer that is there, or in one that stays."""
    stream = new_stream()
    send_recording(stream, PORT, partial(_send, landscape, stream), within=_SHOW_TIME)
    stream.disconnect()


def _send(landscape: Landscape, stream: rr.RecordingStream) -> None:
    """Draw a landscape into a recording of Rerun."""
    from soft_throw_ros.recording import rerun_canvas

    x, y = (
        rerun_canvas.MapAxis(title=axis.title, values=axis.values) for axis in _Shown.of(landscape)
    )
    rerun_canvas.draw_landscape(
        stream,
        name=str(landscape.attributes['title']),
        axes=(x, y),
        panels=[
            rerun_canvas.MapPanel(
                name=name,
                title=quantity.meaning,
                symbol=quantity.symbol,
                values=getattr(landscape, name),
                highest=_highest(landscape, name),
            )
            for name, quantity in RESULTS.items()
        ],
        marks=[(right, up, title) for title, right, up in _marks(landscape)],
    )


def _highest(landscape: Landscape, name: str) -> float | None:
    """Say where the colours of a result end; None is at its largest value."""
    if name == 'ejection_phase' and landscape.optimum is not None:
        # some are so late that all others look alike
        return float(np.nanpercentile(landscape.ejection_phase, 95.0))
    return None


def _title(landscape: Landscape) -> str:
    """Name model and release, and of the rig what is no axis and counts."""
    rig = landscape.rig
    fixed = [
        f'{AXES[name].symbol} = {value:g} {TWIN.by_name[name].unit}'.rstrip()
        for name, value in (
            ('engine.damping_ratio', rig.engine.damping_ratio),
            ('layer.loss_tangent', rig.layer.loss_tangent),
            ('gravity', rig.gravity),
        )
        if value > 0.0 and name not in (*landscape.axes, *landscape.left_out)
    ]
    model = landscape.model.replace('_', ' ')
    return ', '.join([f'{landscape.release} release by the model {model}', *fixed])


def _marks(landscape: Landscape) -> Iterator[tuple[str, float, float]]:
    """Give title and place of the highest point and of the rig, as far as they are on the map."""
    marks = [('this rig', landscape.place(landscape.rig))]
    optimum, symbol = landscape.optimum, RESULTS['energy_transfer'].symbol
    if optimum is not None:
        marks.append((f'largest {symbol}, {optimum.energy_transfer:.3f}', optimum.place))
    x, y = _Shown.of(landscape)
    for title, place in marks:
        right, up = x.factor * place[0], y.factor * place[1]
        if x.values[0] <= right <= x.values[-1] and y.values[0] <= up <= y.values[-1]:
            yield title, right, up


_WRITERS: Mapping[str, Callable[[Landscape, Path], None]] = {
    '.npz': Landscape.save, '.nc': Landscape.save, '.png': draw, '.rrd': _record,
}
