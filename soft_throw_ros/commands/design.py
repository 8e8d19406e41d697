# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Design a throw: choose a layer, an amplitude or a motion of the plate, and draw landscapes."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
import contextlib
from typing import Any

from soft_throw_ros.commands import design_map, design_motion, options, output
from soft_throw_ros.commands.output import CommandParser
from soft_throw_ros.configuration import rig_of, TWIN
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core.batch import ThrowUnresolvedError
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.prediction import predict
from soft_throw_ros.design.requests import RequestResult, solve_request
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties


def main(args: list[str] | None = None) -> int:
    """Run the task named by the first argument with the other arguments; return its exit code."""
    parser = CommandParser(description=__doc__)
    tasks = parser.add_subparsers(dest='task', metavar='TASK', required=True)
    for name, (add_arguments, run, purpose) in TASKS.items():
        task = tasks.add_parser(name, help=purpose, description=f'{purpose.capitalize()}.')
        task.usage = '%(prog)s [OPTION ...]'
        add_arguments(task)
        task.set_defaults(run=run)
    return output.run_command(parser, lambda arguments: arguments.run(arguments), args)


def _add_recommend_arguments(parser: CommandParser) -> None:
    parser.add_json_option()
    names = [f'recommendation.{name}' for name in ('objective', 'vary', 'max_strain')]
    options.add_options(parser, [*names, 'layer.library'], title='request')
    options.add_rig_options(parser)


def _add_aim_arguments(parser: CommandParser) -> None:
    parser.add_json_option()
    names = [f'recommendation.{name}' for name in ('target_height', 'target_speed', 'max_strain')]
    options.add_options(parser, names, title='target and limit')
    options.add_rig_options(parser)


def _run(arguments: argparse.Namespace) -> int:
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
        lines = _lines(best, _columns(rig_of(settings), best), str(uncertainty))
        output.print_result(data, lines, as_json=arguments.json)
    return 0


def _lines(
    best: RequestResult, columns: Mapping[str, Mapping[str, Any] | None], uncertainty: str
) -> Iterator[str]:
    """Yield the answer, a table of the throws that it compares, and warnings."""
    yield from (best.summary, '')
    yield from output.table(columns)
    yield from output.strain_warnings(best.rig.layer.linear_range, columns)
    yield f'With the uncertainties (uncertainty.*): {uncertainty}'
    if candidates := getattr(best, 'candidates', ()):
        yield from ('', output.table_line('from the library', 'mm', ['score']))
        for item in candidates:
            cells = [f'{item.score:.3f}']
            yield output.table_line(item.layer, f'{1e3 * item.thickness:.1f}', cells)


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
    alternatives = {name: getattr(best, name, None) for name in ('by_thickness', 'by_wave_speed')}
    others = {name: vars(throw) for name, throw in alternatives.items() if throw}
    return {'now': now, 'recommended': vars(best), **others}


TASKS = {
    'recommend': (_add_recommend_arguments, _run, 'recommend a layer'),
    'aim': (_add_aim_arguments, _run, 'find the amplitude that reaches a height or speed'),
    'motion': (
        design_motion.add_arguments, design_motion.run, 'optimise the motion of the plate'
    ),
    'map': (
        design_map.add_arguments, design_map.run, 'map ejection time and energy over two axes'
    ),
}
"""Tasks by name: functions that add the arguments and run it, and its purpose."""
