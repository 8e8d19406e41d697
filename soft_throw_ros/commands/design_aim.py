# SPDX-License-Identifier: Apache-2.0
"""Aim a throw at a height or a speed, and print what it takes as a table or as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping

from soft_throw_ros.commands.design_table import add_search_options, answer_json, answer_lines
from soft_throw_ros.commands.options import read_settings
from soft_throw_ros.commands.output import print_text, slow_notice
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.evaluate import last_release
from soft_throw_ros.design.prediction import predict
from soft_throw_ros.design.requests import answer

NOT_REACHED = 1
"""Exit code if the target is out of reach."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the task."""
    parser.usage = (
        '%(prog)s [-h] [--target-height M | --target-speed M/S] '
        '[--vary amplitude|thickness|wave_speed|both|library] [--json] [--config FILE] '
        '[--thickness M ...]'
    )
    parser.epilog = f'The exit code is {NOT_REACHED} if the target is out of reach.'
    add_search_options(
        parser,
        'what is aimed at, and with what',
        without=('objective', 'quantile', 'masses', 'frequencies'),
    )


def run(arguments: argparse.Namespace) -> int:
    """Aim, and print it; return 0, or `NOT_REACHED`. What is refused is a ValueError."""
    settings = {**read_settings(arguments), 'recommendation.objective': 'aim'}
    given = vars(arguments).keys()
    if not given & {'config', 'recommendation.target_height', 'recommendation.target_speed'}:
        raise ValueError('nothing to aim at: give --target-height M or --target-speed M/S')
    with slow_notice('design aim'):
        best = _aim(settings)
        if arguments.json:
            text = answer_json(settings, best, 'aim')
        else:
            text = '\n'.join(_lines(settings, best)) + '\n'
    print_text(text)
    return 0 if best.is_reached else NOT_REACHED


def _aim(settings: Settings) -> Aim:
    best = answer(settings)
    assert isinstance(best, Aim)  # as it is the objective
    return best


def _lines(settings: Settings, best: Aim) -> Iterator[str]:
    """Put the throw as it is, the aimed one, and that with the layer as it is side by side."""
    rig = rig_of(settings)
    columns: dict[str, Mapping[str, float] | None] = {'now': None}
    try:
        now, flight = predict(rig), last_release(rig)
        reached = {'speed': flight.speed, 'height': flight.height}
        columns['now'] = {**vars(now), 'amplitude': rig.engine.amplitude, **reached}
    except ThrowUnresolvedError:
        pass  # it does not throw
    columns['aimed' if best.is_reached else 'the_most'] = vars(best)
    if best.rig.layer != rig.layer:
        try:
            other = _aim({**settings, 'recommendation.vary': 'amplitude'})
            if other.is_reached:
                columns['with_this_layer'] = vars(other)
        except ThrowUnresolvedError:
            pass  # this layer throws with no amplitude
    yield from answer_lines(settings, best, columns)
