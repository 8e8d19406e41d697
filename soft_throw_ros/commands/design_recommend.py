# SPDX-License-Identifier: Apache-2.0
"""Recommend a layer for a rig, as a table or as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
import sys
from typing import get_args

from soft_throw_ros.commands.design_table import prediction_lines, to_json, uncertainty_line
from soft_throw_ros.commands.options import (
    add_options,
    add_rig_options,
    read_settings,
    RECOMMENDATION_OPTIONS,
    slow_notice,
    UNCERTAINTY_OPTIONS,
)
from soft_throw_ros.configuration import Settings, TWIN
from soft_throw_ros.design.recommendation import (
    PredictedThrow,
    Recommendation,
    Sensitivity,
    TOLERATED,
    UNITS,
    Vary,
    WITHIN,
)
from soft_throw_ros.design.requests import answer

_OF_AIMING = ('max_amplitude', 'target_height', 'target_speed')

_OBJECTIVE = replace(
    TWIN.by_name['recommendation.objective'],
    meaning='What to look for: the most energy per throw, in the worst case of the uncertainties, '
    'or in the worst of several throws',
    choices=('peak', 'robust', 'versatile'),
)
_VARY = replace(
    TWIN.by_name['recommendation.vary'],
    meaning='What of the layer may be changed; a pick from the library changes all of it',
    choices=get_args(Vary),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the task."""
    parser.usage = (
        '%(prog)s [-h] [--objective peak|robust|versatile] '
        '[--vary thickness|wave_speed|both|library] [--json] [--config FILE] [--thickness M ...]'
    )
    parser.add_argument(
        '--json', action='store_true', help='print one object: SI units, full precision'
    )
    asked = [name for name in RECOMMENDATION_OPTIONS if not name.endswith(_OF_AIMING)]
    add_options(parser, asked, title='what is asked of the layer', entries=(_OBJECTIVE, _VARY))
    add_options(parser, UNCERTAINTY_OPTIONS, title='uncertainties')
    add_rig_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """
    Recommend, and print it.

    Parameters
    ----------
    arguments : Namespace
        As `add_arguments` defines them.

    Returns
    -------
    int
        0.

    Raises
    ------
    ValueError
        If something is refused, saying what.

    """
    settings = read_settings(arguments)
    with slow_notice('design recommend'):
        best = answer(settings)
        if not isinstance(best, Recommendation):
            raise ValueError(
                "recommendation.objective 'aim' is what `design aim` is for; give --objective"
            )
        if arguments.json:
            text = to_json(settings, best.rig, recommendation=best)
        else:
            text = '\n'.join(_lines(settings, best)) + '\n'
    sys.stdout.write(text)
    return 0


def _lines(settings: Settings, best: Recommendation) -> Iterator[str]:
    yield best.summary
    yield ''
    others = {
        f'by_{name}': getattr(best, f'by_{name}')
        for name in ('thickness', 'wave_speed', 'both')
        if name != best.vary and getattr(best, f'by_{name}') is not None
    }
    columns: dict[str, PredictedThrow | None] = {'now': best.now, 'recommended': best, **others}
    yield from prediction_lines(columns, max_strain=settings['max_strain'])
    yield uncertainty_line(best.rig, settings)
    yield ''
    yield (
        f'around the recommended layer{"best":>11}{f"{100.0 * WITHIN:g} % lost at":>22}'
        f'{f"{100.0 * TOLERATED:g} % within +-":>18}{"1 % more":>12}'
    )
    yield from map(_sensitivity_line, best.sensitivities)
    if best.candidates:
        yield ''
        yield from _candidate_lines(best)
    yield ''
    yield best.remarks


def _sensitivity_line(item: Sensitivity) -> str:
    unit, scale = UNITS[item.name]
    span = f'{scale * item.low:.4g} ... {scale * item.high:.4g}'
    title = item.name.replace('_', ' ')
    edge = f'  (falls off an edge with {item.edge})' if item.edge else ''
    return (
        f'{title:22}{unit:>6}{scale * item.value:11.4g}{span:>22}{scale * item.tolerance:18.2g}'
        f'{item.elasticity:+10.2f} %{edge}'
    )


def _candidate_lines(best: Recommendation) -> Iterator[str]:
    width = max(22, *(len(item.layer) for item in best.candidates))
    yield f'{"from the library":{width}}{"mm":>6}{"score":>11}'
    for item in best.candidates:
        yield f'{item.layer:{width}}{1e3 * item.thickness:6.1f}{item.score:11.3f}'
