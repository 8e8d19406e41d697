# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design the motion of the plate: a table of predictions, and the motion for a controller."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from soft_throw_ros.commands import options, output
from soft_throw_ros.commands.output import CommandParser
from soft_throw_ros.configuration import motions
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core.plate import motion_of
from soft_throw_ros.design.motion import MotionDesign, PlateLimits
from soft_throw_ros.design.requests import solve_request
import yaml


def add_arguments(parser: CommandParser) -> None:
    """Add the arguments of the task."""
    parser.add_json_option()
    parser.add_argument(
        '--output', metavar='FILE', nargs='+', type=options.new_file(*_WRITERS), default=[],
        help='.csv (for --motion), .yaml (trajectory_msgs/JointTrajectory) or .png (picture)',
    )
    names = [f'recommendation.plate_{name}' for name in ('speed', 'acceleration', 'travel')]
    options.add_options(parser, names, title='limits of the actuator')
    options.add_rig_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Design a motion, print its predictions, and write it to files; return 0."""
    settings = options.read_settings(arguments)
    settings |= {'recommendation.objective': 'peak', 'recommendation.vary': 'motion'}
    with output.slow_notice('design'):
        design = solve_request(settings)
        assert isinstance(design, MotionDesign)  # by the settings above
        for path in arguments.output:
            with output.written_file(path) as unfinished:
                _WRITERS[path.suffix](design, unfinished)
    data = {
        'parameters': {name: settings[name] for name in RIG_PARAMETERS},
        'motion': {**vars(design), 'summary': design.summary},
    }
    output.print_result(data, _lines(design), as_json=arguments.json)
    return 0


def _lines(design: MotionDesign) -> Iterator[str]:
    """Yield the summary, and a table of the present motion, of the best, and its worst case."""
    yield from (design.summary, '')
    columns: dict[str, Mapping[str, Any] | None] = {}
    for name, rig, throw in (
        ('now', design.present, design.now),
        ('best_motion', design.rig, design),
        ('worst_case', design.rig, design.worst),
    ):
        if throw is not None:
            peaks = vars(PlateLimits.of(rig.engine)).items()
            plate = {f'plate_{key}': value for key, value in peaks}
            columns[name] = {**vars(throw), **plate}
    yield from output.table(columns)
    yield from output.strain_warnings(design.rig.layer.linear_range, columns)
    if design.limits == PlateLimits.of(design.present.engine):
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


def _draw(design: MotionDesign, path: Path) -> None:
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


_WRITERS: Mapping[str, Callable[[MotionDesign, Path], None]] = {
    '.csv': _write_csv, '.yaml': _write_trajectory, '.png': _draw,
}
