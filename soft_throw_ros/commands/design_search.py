# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Recommend a layer, or aim a throw, and print the answer as a table or as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping
import contextlib
from dataclasses import replace
from itertools import chain
from typing import get_args

from soft_throw_ros.commands.design_texts import summary_of, uncertainty_text
from soft_throw_ros.commands.options import (
    add_options,
    add_rig_options,
    read_settings,
    RECOMMENDATION_PARAMETERS,
    UNCERTAINTY_PARAMETERS,
)
from soft_throw_ros.commands.output import (
    CommandParser,
    print_result,
    slow_notice,
    strain_warnings,
    table_line,
    write_columns,
)
from soft_throw_ros.configuration import Entry, rig_of, Settings, TWIN
from soft_throw_ros.configuration.twin import OBJECTIVES, RIG_PARAMETERS
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throws import last_release
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.prediction import predict
from soft_throw_ros.design.recommendation import Recommendation, Vary
from soft_throw_ros.design.requests import RequestResult, solve_request
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties

Columns = dict[str, Mapping[str, float] | None]
"""Predictions by the titles of their columns."""

_OBJECTIVE = replace(
    TWIN.by_name['recommendation.objective'],
    meaning=f'Objective: {"; ".join(OBJECTIVES.values())}',
    choices=tuple(OBJECTIVES),
)
_VARY = replace(
    TWIN.by_name['recommendation.vary'],
    meaning='Part of the layer that may change; a choice from the library changes the whole layer',
    choices=get_args(Vary),
)


def add_recommend_arguments(parser: CommandParser) -> None:
    """Add the arguments of `design recommend`."""
    _add_arguments(
        parser, 'request',
        (_OBJECTIVE.name, _VARY.name, 'layer.library', 'recommendation.max_strain'),
        _OBJECTIVE, _VARY,
    )


def add_aim_arguments(parser: CommandParser) -> None:
    """Add the arguments of `design aim`."""
    names = [f'recommendation.{name}' for name in ('target_height', 'target_speed', 'max_strain')]
    _add_arguments(parser, 'target and limit', names)


def _add_arguments(
    parser: CommandParser, title: str, names: Iterable[str], *entries: Entry
) -> None:
    parser.add_json_option()
    add_options(parser, names, title=title, entries=entries)
    add_rig_options(parser)


def run_recommend(arguments: argparse.Namespace) -> int:
    """Print a recommendation; return 0, or raise ValueError for a bad request."""
    settings = read_settings(arguments)
    for name, value in (('objective', 'aim'), ('vary', 'motion')):
        if settings[f'recommendation.{name}'] == value:
            raise ValueError(
                f'recommendation.{name} {value!r} needs the command `design {value}`; '
                f'give --{name}'
            )
    _print_answer(settings, 'recommendation', arguments.json)
    return 0


def run_aim(arguments: argparse.Namespace) -> int:
    """Print an aim; return 0, or raise ValueError for a bad request."""
    settings = read_settings(arguments)
    targets = {'recommendation.target_height', 'recommendation.target_speed'}
    # Only a file with the objective 'aim' has a target; otherwise an option must give it.
    if settings['recommendation.objective'] != 'aim' and not vars(arguments).keys() & targets:
        raise ValueError('no target: give --target-height M or --target-speed M/S')
    settings['recommendation.objective'] = 'aim'
    _print_answer(settings, 'aim', arguments.json)
    return 0


def _print_answer(settings: Settings, name: str, as_json: bool) -> None:
    """Compute a recommendation or an aim, and print the result."""
    with slow_notice('design'):
        best, rig = solve_request(settings), rig_of(settings)
        intervals = prediction_uncertainty(best.rig, Uncertainties.from_settings(settings))
        summary, uncertainty = summary_of(best, rig, settings), intervals.values()
        parameters = (*RIG_PARAMETERS, *UNCERTAINTY_PARAMETERS, *RECOMMENDATION_PARAMETERS)
        data = {
            'parameters': {key: settings[key] for key in parameters},
            name: {**vars(best), 'summary': summary},
            'uncertainty': uncertainty,
        }
        lines = chain([summary, ''], _lines(rig, best, uncertainty))
        print_result(data, lines, as_json=as_json)


def _lines(
    rig: Rig, best: RequestResult, uncertainty: Mapping[str, float]
) -> Iterator[str]:
    """Compare the throws of an answer, and describe the intervals of the proposed one."""
    columns = (
        _aim_columns(rig, best) if isinstance(best, Aim) else _recommendation_columns(best)
    )
    yield from write_columns(columns)
    yield from strain_warnings(best.rig.layer.linear_range, columns)
    yield f'With the uncertainties (uncertainty.*): {uncertainty_text(uncertainty)}'
    if candidates := getattr(best, 'candidates', ()):
        yield from ('', table_line('from the library', 'mm', ['score']))
        for item in candidates:
            yield table_line(item.layer, f'{1e3 * item.thickness:.1f}', [f'{item.score:.3f}'])


def _aim_columns(rig: Rig, best: Aim) -> Columns:
    """Return the present throw and the aimed one."""
    columns: Columns = {'now': None}
    with contextlib.suppress(ThrowUnresolvedError):  # the present rig does not throw
        now, last = predict(rig), last_release(rig)
        reached = {'amplitude': rig.engine.amplitude, 'speed': last.speed, 'height': last.height}
        columns['now'] = {**vars(now), **reached}
    columns['aimed'] = vars(best)
    return columns


def _recommendation_columns(best: RequestResult) -> Columns:
    """Return the throws of the present layer and of the recommended ones."""
    assert isinstance(best, Recommendation)  # other requests are refused
    columns: Columns = {'now': vars(best.now) if best.now else None, 'recommended': vars(best)}
    for name in ('thickness', 'wave_speed'):
        alternative = getattr(best, f'by_{name}')
        if name != best.vary and alternative is not None:
            columns[f'by_{name}'] = vars(alternative)
    return columns
