# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design a throw: choose a layer, an amplitude or a motion of the plate, and draw landscapes."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
import contextlib
from pathlib import Path
import re
from typing import Any

import numpy as np
from soft_throw_ros.commands import options, output
from soft_throw_ros.commands.output import CommandParser
from soft_throw_ros.configuration import motions, rig_of, TWIN
from soft_throw_ros.configuration.csv_rows import Floats
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core.batch import ThrowUnresolvedError
from soft_throw_ros.core.plate import motion_of
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.landscape import AXES, compute_landscape, Landscape, RESULTS
from soft_throw_ros.design.motion import MotionDesign, PlateLimits
from soft_throw_ros.design.prediction import predict, prediction_uncertainty, Uncertainties
from soft_throw_ros.design.recommendation import RequestResult, solve_request
import yaml

_RANGE = re.compile(r'([^:-][^:]*):([^:]+)(?::([2-9]|[1-9]\d+))?(:log)?')
# Ranges of ratios that are given by name alone
_RATIOS = {'x': '0.005:0.995', 'C': '0.05:14', 'mu': '0.01:10:log', 'kappa': '0.5:50:log'}


def main(args: list[str] | None = None) -> int:
    """Run the task named by the first argument with the other arguments; return its exit code."""
    parser = CommandParser(description=__doc__)
    tasks = parser.add_subparsers(dest='task', metavar='TASK', required=True)
    for name, (run, purpose, title, parameters) in _TASKS.items():
        task = tasks.add_parser(name, help=purpose, description=f'{purpose.capitalize()}.')
        task.usage = '%(prog)s [OPTION ...]'
        if name == 'map':
            _add_map_arguments(task)
        else:
            task.add_json_option()
            options.add_options(task, parameters.split(), title=title)
        if name == 'motion':
            task.add_argument(
                '--output', metavar='FILE', nargs='+', type=options.new_file(*_MOTION_WRITERS),
                default=[], help='.csv (for --motion), .yaml (trajectory_msgs/JointTrajectory) '
                'or .png (picture)',
            )
        options.add_rig_options(task)
        task.set_defaults(run=run)
    return output.run_command(parser, lambda arguments: arguments.run(arguments), args)


def _add_map_arguments(parser: CommandParser) -> None:
    parser.usage = '%(prog)s [OPTION ...] [AXIS AXIS]'
    parser.epilog = (
        'An axis is NAME=LOW:HIGH, optionally followed by :COUNT and :log: '
        f'layer.thickness=0.002:0.03:512. Names: {", ".join(AXES)}; the first four need no range.'
    )
    add = parser.add_argument
    add('axes', metavar='AXIS', nargs='*', help='two axes (default: x and C, as in the paper)')
    add('--output', metavar='FILE', nargs='+', type=options.new_file(*_MAP_WRITERS), default=[],
        help='.nc (NetCDF) or .png (picture)')
    options.add_dask_option(parser)


def _recommend(arguments: argparse.Namespace) -> int:
    """Compute a recommendation or an aim, and print the result; return 0."""
    settings, name = options.read_settings(arguments), 'recommendation'
    if arguments.task == 'aim':
        settings['recommendation.objective'] = name = 'aim'
    with output.slow_notice('design'):
        best = solve_request(settings)
        uncertainty = prediction_uncertainty(best.rig, Uncertainties.from_settings(settings))
        names = TWIN.names_in('uncertainty') + TWIN.names_in('recommendation')
        data = {
            'parameters': {key: settings[key] for key in (*RIG_PARAMETERS, *names)},
            name: {**vars(best), 'summary': best.summary},
            'uncertainty': uncertainty.values(),
        }
        lines = _recommended_lines(best, str(uncertainty))
        output.print_result(data, lines, as_json=arguments.json)
    return 0


def _recommended_lines(best: RequestResult, uncertainty: str) -> Iterator[str]:
    """Yield the answer, a table of the throws that it compares, and warnings."""
    columns = _columns(best)
    yield from (best.summary, '')
    yield from output.table(columns)
    yield from output.strain_warnings(best.rig.layer.linear_range, columns)
    yield f'With the uncertainties (uncertainty.*): {uncertainty}'
    if candidates := getattr(best, 'candidates', ()):
        yield from ('', output.table_line('from the library', 'mm', ['score']))
        for item in candidates:
            cells = [f'{item.score:.3f}']
            yield output.table_line(item.layer, f'{1e3 * item.thickness:.1f}', cells)


def _columns(best: RequestResult) -> dict[str, Mapping[str, Any]]:
    """Return the present throw, the recommended one and its alternatives, or the aimed one."""
    rig, now = best.present, {}
    with contextlib.suppress(ThrowUnresolvedError):  # the present rig does not throw
        now = vars(predict(rig))
        if isinstance(best, Aim):
            throw, amplitude = simulate(rig), rig.engine.amplitude
            reached = {'speed': throw.last_release.velocity, 'height': throw.flight_height}
            now = {**now, 'amplitude': amplitude, **reached}
    if isinstance(best, Aim):
        return {'now': now, 'aimed': vars(best)}
    alternatives = {name: getattr(best, name, None) for name in ('by_thickness', 'by_wave_speed')}
    others = {name: vars(throw) for name, throw in alternatives.items() if throw}
    values: dict[str, dict[str, Any]] = {'now': dict(now), 'recommended': {}}
    for name, value in vars(best).items():  # the score of the present rig is `now_score`
        of_present = name.startswith('now_')
        values['now' if of_present else 'recommended'][name.removeprefix('now_')] = value
    return {**values, **others}


def _design_motion(arguments: argparse.Namespace) -> int:
    """Design a motion, print its predictions, and write it to files; return 0."""
    settings = options.read_settings(arguments)
    settings |= {'recommendation.objective': 'peak', 'recommendation.vary': 'motion'}
    with output.slow_notice('design'):
        design = solve_request(settings)
        assert isinstance(design, MotionDesign)  # by the settings above
        for path in arguments.output:
            with output.written_file(path) as unfinished:
                _MOTION_WRITERS[path.suffix](design, unfinished)
    data = {
        'parameters': {name: settings[name] for name in RIG_PARAMETERS},
        'motion': {**vars(design), 'summary': design.summary},
    }
    output.print_result(data, _motion_lines(design), as_json=arguments.json)
    return 0


def _motion_lines(design: MotionDesign) -> Iterator[str]:
    """Yield the summary, and a table of the present motion, of the best, and its worst case."""
    yield from (design.summary, '')
    columns = {}
    for name, rig, throw in (
        ('now', design.present, design.now),
        ('best_motion', design.rig, design),
        ('worst_case', design.rig, design.worst),
    ):
        if throw is not None:
            peaks = vars(PlateLimits.of(rig.engine)).items()
            columns[name] = vars(throw) | {f'plate_{key}': value for key, value in peaks}
    yield from output.table(columns)
    yield from output.strain_warnings(design.rig.layer.linear_range, columns)
    if design.limits == PlateLimits.of(design.present.engine):
        yield (
            'The limits of the plate are those of the present motion; set others by '
            '--plate-speed, --plate-acceleration and --plate-travel.'
        )


def _write_trajectory(design: MotionDesign, path: Path) -> None:
    """Write the motion as a message `trajectory_msgs/JointTrajectory` in YAML."""
    message = {'joint_names': ['plate'], 'points': motions.trajectory_points(design.motion)}
    text = yaml.safe_dump(message, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding='utf-8')


def _draw_motion(design: MotionDesign, path: Path) -> None:
    """Draw height and velocity of the plate in both throws into a PNG file."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.2), layout='constrained')
    panels = figure.subplots(1, 2, sharex=True)
    times = np.linspace(0.0, max(design.motion.end_time, 1.2 * design.ejection_time), 1001)
    for rig, throw, label in (
        (design.present, design.now, 'now'), (design.rig, design, 'best motion')
    ):
        if throw is not None:
            motion = motion_of(rig.engine)
            title = f'{label}: {throw.ejection_speed:.3g} m/s'
            panels[0].plot(1e3 * times, 1e3 * motion.position(times), label=title)
            panels[1].plot(1e3 * times, motion.velocity(times))
    for panel, name in zip(panels, ('height of the plate (mm)', 'velocity (m/s)'), strict=True):
        panel.axvline(1e3 * design.ejection_time, color='0.6', ls=':')
        panel.set(xlabel='time (ms), dotted: release', ylabel=name)
    panels[0].legend(title='motion: ejection speed')
    figure.suptitle(design.summary.replace('; ', '\n'), fontsize='medium')
    figure.savefig(path, format='png', dpi=150)


def _map(arguments: argparse.Namespace) -> int:
    """Compute, save and summarise the map; return 0."""
    rig = rig_of(options.read_settings(arguments))
    axes = dict(map(_read_axis, arguments.axes or ['x', 'C']))
    with output.slow_notice('design map'), options.open_map(arguments.dask) as run_blocks:
        landscape = compute_landscape(rig, axes, run=run_blocks)
    for path in arguments.output:
        with output.written_file(path) as unfinished:
            _MAP_WRITERS[path.suffix](landscape, unfinished)
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
    yield f'{size} throws, first release; {lost} have none that can be resolved'


def _draw_map(landscape: Landscape, path: Path) -> None:
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
    figure.suptitle('first release', fontsize='medium')
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


_MOTION_WRITERS: Mapping[str, Callable[[MotionDesign, Path], object]] = {
    '.csv': lambda design, path: path.write_text(motions.to_csv(design.motion), encoding='utf-8'),
    '.yaml': _write_trajectory,
    '.png': _draw_motion,
}
_MAP_WRITERS: Mapping[str, Callable[[Landscape, Path], None]] = {
    '.nc': Landscape.save, '.png': _draw_map,
}
_TASKS = {
    'recommend': (
        _recommend, 'recommend a layer', 'request',
        'recommendation.objective recommendation.vary recommendation.max_strain layer.library',
    ),
    'aim': (
        _recommend, 'find the amplitude that reaches a height or speed', 'target and limit',
        'recommendation.target_height recommendation.target_speed recommendation.max_strain',
    ),
    'motion': (
        _design_motion, 'optimise the motion of the plate', 'limits of the actuator',
        'recommendation.plate_speed recommendation.plate_acceleration recommendation.plate_travel',
    ),
    'map': (_map, 'map ejection time and energy over two axes', '', ''),
}
"""Tasks by name: the function that runs it, its purpose, title and parameters of its options."""
