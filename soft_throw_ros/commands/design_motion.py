# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design the motion of the plate: a table of predictions, and the motion for a controller."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from soft_throw_ros.commands.design_texts import motion_summary
from soft_throw_ros.commands.options import (
    add_options,
    add_rig_options,
    MAIN_PARAMETERS,
    new_file,
    read_settings,
)
from soft_throw_ros.commands.output import (
    CommandParser,
    print_result,
    slow_notice,
    write_predictions,
    written_file,
)
from soft_throw_ros.configuration import motions
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core.plate import PlateMotion
from soft_throw_ros.design.motion_design import MotionDesign
from soft_throw_ros.design.plate_motion import PlateLimits
from soft_throw_ros.design.requests import solve_motion_request
from soft_throw_ros.recording.rerun_output import new_stream, save_recording
import yaml

_LIMITS = ('plate_speed', 'plate_acceleration', 'plate_travel')
_HEADS = {
    'best': 'best_motion', 'layer': 'best_layer', 'linear': 'linear_layer',
}


def add_arguments(parser: CommandParser) -> None:
    """Add the arguments of the task."""
    parser.usage = '%(prog)s [OPTION ...]'
    parser.add_json_option()
    parser.add_argument(
        '--output', metavar='FILE', nargs='+', type=new_file(*_WRITERS), default=[],
        help='.csv (for --motion), .yaml (trajectory_msgs/JointTrajectory), .png (picture) '
        'or .rrd (recording of Rerun)',
    )
    names = [f'recommendation.{name}' for name in _LIMITS]
    add_options(parser, names, title='limits of the actuator')
    add_rig_options(parser, MAIN_PARAMETERS)


def run(arguments: argparse.Namespace) -> int:
    """Design a motion, print its predictions, and write it to files; return 0."""
    settings = read_settings(arguments)
    with slow_notice('design'):
        design = solve_motion_request(settings)
        for path in arguments.output:
            with written_file(path) as unfinished:
                _WRITERS[path.suffix](design, unfinished)
    data = {
        'parameters': {name: settings[name] for name in RIG_PARAMETERS},
        'motion': {**vars(design), 'summary': motion_summary(design)},
    }
    print_result(data, _lines(design, settings['max_strain']), as_json=arguments.json)
    return 0


def _lines(design: MotionDesign, max_strain: Any) -> Iterator[str]:
    """Yield the summary, and a table that compares all cases."""
    yield motion_summary(design)
    yield ''
    rigs = {**design.others, 'best': design.rig}
    columns: dict[str, Mapping[str, float] | None] = {}
    for name, throw in design.throws.items():
        rig = rigs[name]
        peaks = PlateLimits.of(rig.engine)
        columns[_HEADS.get(name, name)] = {
            **vars(throw),
            'max_strain': rig.layer.linear_range(max_strain),
            'plate_speed': peaks.speed,
            'plate_acceleration': peaks.acceleration,
            'plate_travel': peaks.travel,
        }
    yield from write_predictions(columns, max_strain)
    if 'now' in design.others and design.limits == PlateLimits.of(design.others['now'].engine):
        yield (
            'The limits of the plate are those of the present motion; set others by '
            '--plate-speed, --plate-acceleration and --plate-travel.'
        )


def _write_csv(design: MotionDesign, path: Path) -> None:
    path.write_text(motions.to_csv(design.motion), encoding='utf-8')


def _write_trajectory(design: MotionDesign, path: Path) -> None:
    """Write the motion as a message `trajectory_msgs/JointTrajectory` in YAML."""
    message = {'joint_names': ['plate'], 'points': motions.trajectory_points(design.motion)}
    text = yaml.safe_dump(message, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding='utf-8')


def _curves(design: MotionDesign) -> Iterator[tuple[str, np.ndarray, PlateMotion]]:
    """Yield title, times and motion of each case, all up to the same end time."""
    end = max(design.motion.end_time, 1.2 * design.ejection_time)
    for name, motion in design.motions.items():
        speed = design.throws[name].ejection_speed
        yield f'{name}: {speed:.3g} m/s', np.linspace(0.0, end, 1001), motion


def draw(design: MotionDesign, path: Path) -> None:
    """Draw height and velocity of the plate in each case into a PNG file."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.2), layout='constrained')
    above, below = figure.subplots(1, 2, sharex=True)
    for title, times, motion in _curves(design):
        is_best = title.startswith('best')
        style = {'lw': 2.4 if is_best else 1.2, 'color': 'black' if is_best else None}
        above.plot(1e3 * times, 1e3 * motion.position(times), label=title, **style)
        below.plot(1e3 * times, motion.velocity(times), **style)
    release = 1e3 * design.ejection_time
    for panel, name in ((above, 'height of the plate (mm)'), (below, 'velocity (m/s)')):
        panel.axvline(release, color='0.6', ls=':')
        panel.set(xlabel='time (ms)', ylabel=name)
        panel.spines[['top', 'right']].set_visible(False)
    below.annotate(
        'release', (release, 0.02), xycoords=('data', 'axes fraction'), color='0.4',
        textcoords='offset points', xytext=(-4, 0), ha='right',
    )
    above.legend(frameon=False, title='motion: ejection speed', fontsize='small', loc='lower left')
    figure.suptitle(motion_summary(design).replace('; ', '\n'), fontsize='medium')
    figure.savefig(path, format='png', dpi=150, metadata={'Software': None})


def _record(design: MotionDesign, path: Path) -> None:
    """Write the motions side by side as a recording of Rerun; highlight the best one."""
    import rerun as rr
    import rerun.blueprint as rrb
    from soft_throw_ros.recording.rerun_canvas import BLUE, GREEN, GREY, ORANGE, THROW_TIME, WHITE

    stream, curves = new_stream(), list(_curves(design))
    colours = (GREY, BLUE, ORANGE, GREEN)

    def draw_curves() -> None:
        views = []
        for quantity, name in (('position', 'Height (m)'), ('velocity', 'Velocity (m/s)')):
            for number, (title, times, motion) in enumerate(curves):
                entity, colour, width = f'plate/{quantity}/{number}', colours[number % 4], 1.5
                if number == len(curves) - 1:
                    colour, width = WHITE, 3.0
                style = rr.SeriesLines(colors=colour, names=title, widths=width)
                stream.log(entity, style, static=True)
                scalars = rr.Scalars.columns(scalars=getattr(motion, quantity)(times))
                stream.send_columns(entity, [rr.TimeColumn(THROW_TIME, duration=times)], scalars)
            views.append(rrb.TimeSeriesView(origin=f'plate/{quantity}', name=name))
        stream.send_blueprint(rrb.Blueprint(rrb.Horizontal(*views), collapse_panels=True))

    save_recording(stream, path, draw_curves)


_WRITERS: Mapping[str, Callable[[MotionDesign, Path], None]] = {
    '.csv': _write_csv, '.yaml': _write_trajectory, '.png': draw, '.rrd': _record,
}
