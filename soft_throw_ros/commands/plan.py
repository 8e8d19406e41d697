# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rank possible next throws by the errors that remain after them, and count those needed."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping, Sequence
import itertools
import math

import numpy as np
from soft_throw_ros.commands.identify import add_fit_options, describe_fit, read_all
from soft_throw_ros.commands.identify_input import add_track_options
from soft_throw_ros.commands.identify_report import unit_of
from soft_throw_ros.commands.options import (
    add_rig_options,
    parameter_type,
    positive,
    read_settings,
)
from soft_throw_ros.commands.output import (
    CommandParser,
    print_note,
    print_result,
    run_command,
    slow_notice,
)
from soft_throw_ros.configuration import rig_of
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.ejection import GOOD_ENOUGH
from soft_throw_ros.identification.fit_description import values_of
from soft_throw_ros.identification.plan import (
    Condition,
    MeasurementSetup,
    ParameterInformation,
    PlannedThrow,
    Planner,
)
from soft_throw_ros.identification.rig_fit import fit_rig
from soft_throw_ros.identification.tracks import ThrowTracks

LISTS = {
    'masses': 'projectile.mass',
    'thicknesses': 'layer.thickness',
    'amplitudes': 'engine.amplitude',
}
"""Options that list the available parts, and the parameter that each option varies."""

_DEFAULT_RATE = 5000.0  # sample rate of the measurement [Hz]
_DEFAULT_NOISE = 2e-5  # noise of the measurement [m]
_MEASURED_PERIODS = 3.0  # length of the measurement after the start of a throw [plate periods]
_MAX_CANDIDATES = 8  # largest number of candidates in the table
_MAX_THROWS = 50  # largest number of planned throws
_MAX_CONDITIONS = 200  # largest number of combinations, each of which takes a simulation
_COLUMNS = {
    'layer.wave_speed': ('c_s [%]', 100.0, True),
    'layer.thickness': ('L_s [%]', 100.0, True),
    'layer.loss_tangent': ('tan d', 1.0, False),
}
"""Title and factor of a column, and whether its errors are relative, by parameter."""


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0. Notes go to standard error."""
    return run_command(_parser(), _run, args)


def _parser() -> CommandParser:
    parser = CommandParser(
        description=__doc__,
        usage='%(prog)s [OPTION ...] [FILE ...]',
        epilog='Ranked are the errors of wave speed, thickness and loss, as far as a fit varies '
        'them. With tracks, the plan goes on from their fit.',
    )
    add = parser.add_argument
    add('files', metavar='FILE', nargs='*', help='tracks of earlier throws: CSV files, or bags')
    for name, parameter in LISTS.items():
        add(
            f'--{name}', metavar=unit_of(parameter).upper(), nargs='+',
            type=parameter_type(parameter),
            help=f'those at hand (default: {parameter} of the rig)',
        )
    add(
        '--goal', metavar='PERCENT', type=positive, default=100.0 * GOOD_ENOUGH,
        help='error of the energy transfer that is enough (default %(default)g)',
    )
    add(
        '--rate', metavar='HZ', type=positive,
        help='samples per second of the next throws '
        f'(default: of the tracks, or {_DEFAULT_RATE:g})',
    )
    parser.add_json_option()
    add_fit_options(parser)
    add_track_options(parser)
    add_rig_options(parser)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    description = describe_fit(arguments)
    settings = read_settings(arguments)
    throws, notes = read_all(arguments)
    for note in notes:
        print_note('plan', note)
    if not throws:
        description.check_throws(())
    rig = description.prepare(rig_of(settings))
    conditions = _conditions(arguments, rig)
    setup = _setup(arguments, rig, throws)
    with slow_notice('plan'):
        measured = None
        if throws:
            result = fit_rig(throws, rig, description)
            rig, measured = result.rig, ParameterInformation.of_fit(result)
        planner = Planner(rig, conditions, setup, description, measured)
        start = planner.start()
        candidates = planner.rank(start)
        goal = 0.01 * arguments.goal
        before = error = planner.energy_transfer_error(start)
        chosen: list[PlannedThrow] = []
        best_throws = planner.choose(start)
        while error > goal and len(chosen) < _MAX_THROWS:
            chosen.append(next(best_throws))
            error = chosen[-1].energy_transfer_error
    data = {
        'candidates': candidates,
        'throws': chosen,
        'goal': goal,
        'before': before,
        'is_reached': error <= goal,
        'notes': notes,
    }
    head = [f'The present measurements determine alpha to {100.0 * before:.2g} %.']
    table = _lines(candidates, chosen, values_of(rig, _COLUMNS), arguments.goal, setup)
    lines = itertools.chain(head if measured else (), table)
    print_result(data, lines, as_json=arguments.json)
    return 0


def _conditions(arguments: argparse.Namespace, rig: Rig) -> list[Condition]:
    """Return all possible combinations of the available parts."""
    choices = [
        sorted(set(getattr(arguments, name) or values_of(rig, [parameter]).values()))
        for name, parameter in LISTS.items()
    ]
    count = math.prod(map(len, choices))
    if count > _MAX_CONDITIONS:
        raise ValueError(
            f'{count} combinations of masses, layers and amplitudes, where {_MAX_CONDITIONS} at '
            'most can be judged'
        )
    return [Condition(*item) for item in itertools.product(*choices)]


def _setup(
    arguments: argparse.Namespace, rig: Rig, throws: Sequence[ThrowTracks]
) -> MeasurementSetup:
    """Return the setup of future measurements: as in the given throws, unless options differ."""
    rate, noise = _DEFAULT_RATE, _DEFAULT_NOISE
    if throws:
        rate = 1.0 / float(np.median([throw.plate.interval for throw in throws]))
        noise = float(np.median([throw.plate.noise for throw in throws]))
    duration = arguments.end
    if not 0.0 < duration < math.inf:
        duration = _MEASURED_PERIODS / rig.engine.frequency
    return MeasurementSetup(
        rate=arguments.rate or rate, noise=arguments.noise or noise, duration=duration
    )


def _lines(
    candidates: Sequence[PlannedThrow],
    chosen: Sequence[PlannedThrow],
    values: Mapping[str, float],
    goal: float,
    setup: MeasurementSetup,
) -> Iterator[str]:
    """Yield the lines of the plan."""
    yield (
        f'Throws seen for {1e3 * setup.duration:.3g} ms at {setup.rate:g} Hz with a noise of '
        f'{1e6 * setup.noise:.3g} um. The next one, the best first, and errors after it:'
    )
    shown = candidates[:_MAX_CANDIDATES]
    yield from _table(shown, values)
    if len(candidates) > len(shown):
        yield f'and {len(candidates) - len(shown)} more'
    yield ''
    if not chosen:
        yield f'Alpha is known to {goal:g} % already.'
        return
    yield 'The best throws one after the other:'
    yield from _table(chosen, values, labels=map(str, itertools.count(1)))
    if chosen[-1].energy_transfer_error <= 0.01 * goal:
        several = 'throws are' if len(chosen) > 1 else 'throw is'
        yield f'{len(chosen)} {several} enough for {goal:g} % of alpha.'
    else:
        yield (
            f'{len(chosen)} throws are not enough for {goal:g} % of alpha: its error comes '
            'from parameters that no throw measures, such as a mass or a thickness'
        )
    if any(throw.leaves_linear_range for throw in (*shown, *chosen)):
        yield '! The strain leaves the range in which the layer is linear.'


def _table(
    throws: Sequence[PlannedThrow],
    values: Mapping[str, float],
    labels: Iterable[str] = itertools.repeat(''),
) -> Iterator[str]:
    """Yield a table of throws with the errors after each of them."""
    columns = {name: column for name, column in _COLUMNS.items() if name in throws[0].errors}
    heads = [head for head, _, _ in columns.values()]
    rows = [['', 'mass [g]', 'L_s [mm]', 'A [mm]', *heads, 'alpha [%]', 'strain [%]']]
    for label, throw in zip(labels, throws):  # noqa: B905 labels have no end
        cells = [f'{1e3 * value:.4g}' for value in throw.condition]
        for name, (_, factor, is_relative) in columns.items():
            error = factor * throw.errors[name] / (values[name] if is_relative else 1.0)
            cells.append(f'{error:.2g}')
        alpha_error = f'{100.0 * throw.energy_transfer_error:.2g}'
        strain = f'{100.0 * throw.peak_strain:.3g}' + '!' * throw.leaves_linear_range
        rows.append([label, *cells, alpha_error, strain])
    for label, *cells in rows:
        yield f'{label:4}' + ''.join(f'{cell:>11}' for cell in cells)
