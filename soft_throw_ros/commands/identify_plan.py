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
"""Say what to measure next: which throws narrow the parameters of a rig most, and how many do."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
import itertools
import math

import numpy as np
from soft_throw_ros.commands.identify_report import unit_of
from soft_throw_ros.commands.options import number_or_text, positive
from soft_throw_ros.commands.output import print_text, slow_notice, to_json
from soft_throw_ros.configuration import rig_of, Settings, TWIN
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.identification.fit_description import FitDescription, values_of
from soft_throw_ros.identification.plan import (
    Condition,
    Knowledge,
    PlannedThrow,
    Planner,
    seeking_loss,
    Sight,
)
from soft_throw_ros.identification.rig_fit import fit_rig
from soft_throw_ros.identification.tracks import ThrowTracks

LISTS = {
    'masses': 'projectile.mass',
    'thicknesses': 'layer.thickness',
    'amplitudes': 'engine.amplitude',
}
"""What is at hand, by the names of options, and the parameters that it is of."""

_USUAL_RATE, _USUAL_NOISE = 5000.0, 2e-5  # of what sees the throws [Hz, m]
_PERIODS_SEEN = 3.0  # of the plate, after the start of a throw
_SHOWN = 8  # throws of the table
_MOST_THROWS = 50  # that are planned
_MOST_CONDITIONS = 200
_COLUMNS = {
    'layer.wave_speed': ('c_s [%]', 100.0, True),
    'layer.thickness': ('L_s [%]', 100.0, True),
    'layer.loss_tangent': ('tan d', 1.0, False),
}
"""Heads of the table, and whether errors are over the value."""


def add_plan_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of `--plan`."""
    add = parser.add_argument_group(
        'what to measure next',
        'of the masses, layers and amplitudes at hand: which throws narrow wave speed, thickness '
        'and loss most, unless these are held, and how many are enough. With tracks, after '
        'what these tell already. --rate, --noise and --to say how throws will be seen.',
    ).add_argument
    add('--plan', action='store_true', help='do this instead')
    for name, parameter in LISTS.items():
        add(
            f'--{name}', metavar=unit_of(parameter).upper(), nargs='+', type=number_or_text,
            help=f'those at hand (default: {parameter} of the rig)',
        )
    add(
        '--goal', metavar='PERCENT', type=positive, default=1.0,
        help='error of the energy transfer that is enough (default %(default)g)',
    )


def plan_throws(
    arguments: argparse.Namespace,
    settings: Settings,
    description: FitDescription,
    throws: Sequence[ThrowTracks],
) -> int:
    """Print the plan; `throws` are those that were made already."""
    rig = description.prepare(rig_of(settings))
    conditions = _conditions(arguments, rig)
    sight = _sight(arguments, rig, throws)
    with slow_notice('identify'):
        measured = None
        if throws:
            found = fit_rig(throws, rig, seeking_loss(description))
            rig, names = found.rig, [name for name in found.fit.names if '[' not in name]
            places = [found.fit.names.index(name) for name in names]
            covariance = found.fit.covariance[np.ix_(places, places)]
            measured = Knowledge(
                names=tuple(names), information=np.asarray(np.linalg.inv(covariance))
            )
        planner = Planner(rig, conditions, sight, description, measured)
        start = planner.start()
        candidates = planner.judge(start)
        goal = 0.01 * arguments.goal
        before = planner.energy_transfer(start)[1]
        chosen: list[PlannedThrow] = []
        for throw in itertools.islice(
            planner.choose(start), 0 if before <= goal else _MOST_THROWS
        ):
            chosen.append(throw)
            if throw.energy_transfer_error <= goal:
                break
    if arguments.json:
        parts = {'candidates': candidates, 'throws': chosen, 'goal': goal, 'before': before}
        is_reached = not chosen or chosen[-1].energy_transfer_error <= goal
        print_text(to_json({**parts, 'is_reached': is_reached}))
    else:
        if measured:
            print_text(f'What is measured already tells alpha to {100.0 * before:.2g} %.\n')
        lines = _lines(candidates, chosen, values_of(rig, _COLUMNS), arguments.goal, sight)
        print_text('\n'.join(lines) + '\n')
    return 0


def _conditions(arguments: argparse.Namespace, rig: Rig) -> list[Condition]:
    """List the throws that can be made."""
    choices = []
    for name, parameter in LISTS.items():
        values = getattr(arguments, name) or list(values_of(rig, [parameter]).values())
        entry = TWIN.by_name[parameter]
        for value in values:
            if not entry.allows(value):
                raise ValueError(
                    f'argument --{name}: {parameter} must be {entry.rule}, got {value!r}'
                )
        choices.append(sorted({float(value) for value in values}))
    count = math.prod(map(len, choices))
    if count > _MOST_CONDITIONS:
        raise ValueError(
            f'{count} combinations of masses, layers and amplitudes, where {_MOST_CONDITIONS} at '
            'most can be judged'
        )
    return [Condition(*each) for each in itertools.product(*choices)]


def _sight(arguments: argparse.Namespace, rig: Rig, throws: Sequence[ThrowTracks]) -> Sight:
    """Tell how throws will be seen: as those that were made, unless options say otherwise."""
    rate, noise = _USUAL_RATE, _USUAL_NOISE
    if throws:
        rate = 1.0 / float(np.median([throw.plate.interval for throw in throws]))
        noise = float(np.median([throw.plate.noise for throw in throws]))
    duration = arguments.end
    if not 0.0 < duration < math.inf:
        duration = _PERIODS_SEEN / rig.engine.frequency
    return Sight(rate=arguments.rate or rate, noise=arguments.noise or noise, duration=duration)


def _lines(
    candidates: Sequence[PlannedThrow],
    chosen: Sequence[PlannedThrow],
    values: Mapping[str, float],
    goal: float,
    sight: Sight,
) -> Iterator[str]:
    """Write the plan for people."""
    yield (
        f'Throws seen for {1e3 * sight.duration:.3g} ms at {sight.rate:g} Hz with a noise of '
        f'{1e6 * sight.noise:.3g} um. The next one, the best first, and errors after it:'
    )
    yield _heads(candidates[0])
    for throw in candidates[:_SHOWN]:
        yield _row('', throw, values)
    if len(candidates) > _SHOWN:
        yield f'and {len(candidates) - _SHOWN} more'
    yield ''
    if not chosen:
        yield f'Alpha is known to {goal:g} % already.'
        return
    yield 'The best throws one after the other:'
    yield _heads(candidates[0])
    for number, throw in enumerate(chosen, 1):
        yield _row(str(number), throw, values)
    reached = chosen[-1].energy_transfer_error <= 0.01 * goal
    if reached:
        several = 'throws are' if len(chosen) > 1 else 'throw is'
        yield f'{len(chosen)} {several} enough for {goal:g} % of alpha.'
    else:
        yield (
            f'{len(chosen)} throws are not enough for {goal:g} % of alpha: what limits it is '
            'known beforehand only, as a mass or a thickness'
        )
    if any(throw.leaves_linear_range for throw in (*candidates[:_SHOWN], *chosen)):
        yield '! The strain leaves the range in which the layer is linear.'


def _heads(throw: PlannedThrow) -> str:
    """Write the heads of a table."""
    cells = [head for name, (head, _, _) in _COLUMNS.items() if name in throw.errors]
    heads = ['mass [g]', 'L_s [mm]', 'A [mm]', *cells, 'alpha [%]', 'strain [%]']
    return ' ' * 4 + ''.join(f'{head:>11}' for head in heads)


def _row(label: str, throw: PlannedThrow, values: Mapping[str, float]) -> str:
    """Write a throw, and errors after it."""
    cells = [f'{1e3 * value:.4g}' for value in throw.condition]
    for name, (_, factor, is_relative) in _COLUMNS.items():
        if name in throw.errors:
            error = factor * throw.errors[name] / (values[name] if is_relative else 1.0)
            cells.append(f'{error:.2g}')
    cells.append(f'{100.0 * throw.energy_transfer_error:.2g}')
    cells.append(f'{100.0 * throw.peak_strain:.3g}' + '!' * throw.leaves_linear_range)
    return f'{label:4}' + ''.join(f'{cell:>11}' for cell in cells)
