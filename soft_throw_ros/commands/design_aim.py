# SPDX-License-Identifier: Apache-2.0
"""Aim a throw at a height or a speed, and print what it takes as a table or as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
import sys

from soft_throw_ros.commands.design_table import prediction_lines, to_json, uncertainty_line
from soft_throw_ros.commands.options import (
    add_options,
    add_rig_options,
    read_settings,
    RECOMMENDATION_OPTIONS,
    slow_notice,
    UNCERTAINTY_OPTIONS,
)
from soft_throw_ros.configuration import rig_of, Settings
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.evaluate import last_release
from soft_throw_ros.design.recommendation import predict, PredictedThrow
from soft_throw_ros.design.requests import answer

_NOT_OF_AIMING = ('objective', 'quantile', 'masses', 'frequencies')

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
    parser.add_argument(
        '--json', action='store_true', help='print one object: SI units, full precision'
    )
    asked = [name for name in RECOMMENDATION_OPTIONS if not name.endswith(_NOT_OF_AIMING)]
    add_options(parser, asked, title='what is aimed at, and with what')
    add_options(parser, UNCERTAINTY_OPTIONS, title='uncertainties')
    add_rig_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """
    Aim, and print it.

    Parameters
    ----------
    arguments : Namespace
        As `add_arguments` defines them.

    Returns
    -------
    int
        0, or `NOT_REACHED`.

    Raises
    ------
    ValueError
        If something is refused, saying what.

    """
    settings = {**read_settings(arguments), 'recommendation.objective': 'aim'}
    given = vars(arguments).keys()
    if not given & {'config', 'recommendation.target_height', 'recommendation.target_speed'}:
        raise ValueError('nothing to aim at: give --target-height M or --target-speed M/S')
    with slow_notice('design aim'):
        best = answer(settings)
        assert isinstance(best, Aim)  # as it is the objective
        if arguments.json:
            text = to_json(settings, best.rig, aim=best)
        else:
            text = '\n'.join(_lines(settings, best)) + '\n'
    sys.stdout.write(text)
    return 0 if best.is_reached else NOT_REACHED


@dataclass(frozen=True, kw_only=True)
class _Now(PredictedThrow):
    """The throw of the rig as it is."""

    amplitude: float
    speed: float
    height: float


def _now(settings: Settings) -> _Now | None:
    rig = rig_of(settings)
    try:
        prediction, flight = predict(rig), last_release(rig)
    except ThrowUnresolvedError:
        return None
    return _Now(
        **vars(prediction),
        amplitude=rig.engine.amplitude,
        speed=flight.speed,
        height=flight.height,
    )


def _lines(settings: Settings, best: Aim) -> Iterator[str]:
    yield best.summary
    yield ''
    head = 'aimed' if best.is_reached else 'the_most'
    columns = {'now': _now(settings), head: best, **_with_this_layer(settings, best)}
    yield from prediction_lines(columns, max_strain=settings['max_strain'])
    yield uncertainty_line(best.rig, settings)


def _with_this_layer(settings: Settings, best: Aim) -> dict[str, PredictedThrow | None]:
    """Aim with the layer as it is as well, if another one was looked for."""
    if best.rig.layer == rig_of(settings).layer:
        return {}
    try:
        other = answer({**settings, 'recommendation.vary': 'amplitude'})
    except ThrowUnresolvedError:
        return {}
    assert isinstance(other, Aim)
    return {'with_this_layer': other} if other.is_reached else {}
