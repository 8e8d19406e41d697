# SPDX-License-Identifier: Apache-2.0
"""Recommend a layer for a rig, as a table or as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import get_args

from soft_throw_ros.commands.design_table import add_search_options, answer_json, answer_lines
from soft_throw_ros.commands.options import read_settings
from soft_throw_ros.commands.output import print_text, slow_notice
from soft_throw_ros.configuration import Settings, TWIN
from soft_throw_ros.design.recommendation import Recommendation, Vary
from soft_throw_ros.design.requests import answer
from soft_throw_ros.design.sensitivity import Sensitivity, TOLERATED, UNITS, WITHIN

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
    add_search_options(
        parser,
        'what is asked of the layer',
        without=('max_amplitude', 'target_height', 'target_speed'),
        entries=(_OBJECTIVE, _VARY),
    )


def run(arguments: argparse.Namespace) -> int:
    """Recommend, and print it; return 0. What is refused is a ValueError."""
    settings = read_settings(arguments)
    with slow_notice('design recommend'):
        best = answer(settings)
        if not isinstance(best, Recommendation):
            raise ValueError(
                "recommendation.objective 'aim' is what `design aim` is for; give --objective"
            )
        if arguments.json:
            text = answer_json(settings, best, 'recommendation')
        else:
            text = '\n'.join(_lines(settings, best)) + '\n'
    print_text(text)
    return 0


def _lines(settings: Settings, best: Recommendation) -> Iterator[str]:
    others = {
        f'by_{name}': getattr(best, f'by_{name}')
        for name in ('thickness', 'wave_speed', 'both')
        if name != best.vary
    }
    columns: dict[str, Mapping[str, float] | None] = {
        'now': vars(best.now) if best.now else None,
        'recommended': vars(best),
    }
    columns |= {name: vars(each) for name, each in others.items() if each is not None}
    yield from answer_lines(settings, best, columns)
    yield ''
    yield (
        f'around the recommended layer{"best":>11}{f"{100.0 * WITHIN:g} % lost at":>22}'
        f'{f"{100.0 * TOLERATED:g} % within +-":>18}{"1 % more":>12}'
    )
    yield from map(_sensitivity_line, best.sensitivities)
    if best.candidates:
        width = max(22, *(len(item.layer) for item in best.candidates))
        yield from ('', f'{"from the library":{width}}{"mm":>6}{"score":>11}')
        for item in best.candidates:
            yield f'{item.layer:{width}}{1e3 * item.thickness:6.1f}{item.score:11.3f}'
    yield from ('', best.remarks)


def _sensitivity_line(item: Sensitivity) -> str:
    unit, scale = UNITS[item.name]
    span = f'{scale * item.low:.4g} ... {scale * item.high:.4g}'
    title = item.name.replace('_', ' ')
    edge = f'  (falls off an edge with {item.edge})' if item.edge else ''
    return (
        f'{title:22}{unit:>6}{scale * item.value:11.4g}{span:>22}{scale * item.tolerance:18.2g}'
        f'{item.elasticity:+10.2f} %{edge}'
    )
