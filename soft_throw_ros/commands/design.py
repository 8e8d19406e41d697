# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design a throw: choose a layer, an amplitude or a motion of the plate, and draw landscapes."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
import contextlib
from itertools import chain
from typing import Any

from soft_throw_ros.commands import design_map, design_motion
from soft_throw_ros.commands.options import add_options, add_rig_options, read_settings
from soft_throw_ros.commands.output import (
    CommandParser,
    print_result,
    run_command,
    slow_notice,
    strain_warnings,
    table,
    table_line,
)
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core.batch import ThrowUnresolvedError
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.prediction import predict
from soft_throw_ros.design.requests import RequestResult, solve_request
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties

_TARGETS = ('recommendation.target_height', 'recommendation.target_speed')


def main(args: list[str] | None = None) -> int:
    """Run the task named by the first argument with the other arguments; return its exit code."""
    parser = CommandParser(description=__doc__)
    tasks = parser.add_subparsers(dest='task', metavar='TASK', required=True)
    for name, (add_arguments, run, purpose) in TASKS.items():
        task = tasks.add_parser(name, help=purpose, description=f'{purpose.capitalize()}.')
        task.usage = '%(prog)s [OPTION ...]'
        add_arguments(task)
        task.set_defaults(run=run)
    return run_command(parser, lambda arguments: arguments.run(arguments), args)


def _add_recommend_arguments(parser: CommandParser) -> None:
    parser.add_json_option()
    names = [f'recommendation.{name}' for name in ('objective', 'vary', 'max_strain')]
    add_options(parser, [*names, 'layer.library'], title='request')
    add_rig_options(parser)


def _add_aim_arguments(parser: CommandParser) -> None:
    parser.add_json_option()
    add_options(parser, [*_TARGETS, 'recommendation.max_strain'], title='target and limit')
    add_rig_options(parser)


def _recommend(arguments: argparse.Namespace) -> int:
    """Print a recommendation; return 0."""
    settings = read_settings(arguments)
    for name, value in (('objective', 'aim'), ('vary', 'motion')):
        if settings[f'recommendation.{name}'] == value:
            raise ValueError(
                f'argument --{name}: {value!r} needs the command `design {value}`'
            )
    _print_answer(settings, 'recommendation', as_json=arguments.json)
    return 0


def _aim(arguments: argparse.Namespace) -> int:
    """Print an aim; return 0."""
    settings = read_settings(arguments)
    # Only a file with the objective 'aim' has a target; otherwise an option must give it.
    if settings['recommendation.objective'] != 'aim' and not vars(arguments).keys() & {*_TARGETS}:
        raise ValueError('no target: give --target-height M or --target-speed M/S')
    settings['recommendation.objective'] = 'aim'
    _print_answer(settings, 'aim', as_json=arguments.json)
    return 0


def _print_answer(settings: Settings, name: str, *, as_json: bool) -> None:
    """Compute a recommendation or an aim, and print the result."""
    with slow_notice('design'):
        best, rig = solve_request(settings), rig_of(settings)
        uncertainty = prediction_uncertainty(best.rig, Uncertainties.from_settings(settings))
        groups = [TWIN.names_in(group) for group in ('uncertainty', 'recommendation')]
        data = {
            'parameters': {key: settings[key] for key in chain(RIG_PARAMETERS, *groups)},
            name: {**vars(best), 'summary': best.summary},
            'uncertainty': uncertainty.values(),
        }
        columns = _columns(rig, best)
        print_result(data, _lines(best, columns, str(uncertainty)), as_json=as_json)


def _lines(
    best: RequestResult, columns: Mapping[str, Mapping[str, Any] | None], uncertainty: str
) -> Iterator[str]:
    """Yield the answer, a table of the throws that it compares, and warnings."""
    yield from (best.summary, '')
    yield from table(columns)
    yield from strain_warnings(best.rig.layer.linear_range, columns)
    yield f'With the uncertainties (uncertainty.*): {uncertainty}'
    if candidates := getattr(best, 'candidates', ()):
        yield from ('', table_line('from the library', 'mm', ['score']))
        for item in candidates:
            yield table_line(item.layer, f'{1e3 * item.thickness:.1f}', [f'{item.score:.3f}'])


def _columns(rig: Rig, best: RequestResult) -> dict[str, Mapping[str, Any] | None]:
    """Return the present throw, the recommended one and its alternatives, or the aimed one."""
    now: dict[str, Any] = {}
    with contextlib.suppress(ThrowUnresolvedError):  # the present rig does not throw
        now = vars(predict(rig))
    if isinstance(best, Aim):
        if now:
            throw = simulate(rig)
            now |= {
                'amplitude': rig.engine.amplitude, 'speed': throw.last_release.velocity,
                'height': throw.flight_height,
            }
        return {'now': now, 'aimed': vars(best)}
    columns: dict[str, Mapping[str, Any] | None] = {'now': now, 'recommended': vars(best)}
    for name in ('by_thickness', 'by_wave_speed'):
        if alternative := getattr(best, name):
            columns[name] = vars(alternative)
    return columns


TASKS = {
    'recommend': (_add_recommend_arguments, _recommend, 'recommend a layer'),
    'aim': (_add_aim_arguments, _aim, 'find the amplitude that reaches a height or speed'),
    'motion': (
        design_motion.add_arguments, design_motion.run, 'optimise the motion of the plate'
    ),
    'map': (
        design_map.add_arguments, design_map.run, 'map ejection time and energy over two axes'
    ),
}
"""Tasks by name: functions that add the arguments and run it, and its purpose."""
