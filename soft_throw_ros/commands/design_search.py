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
"""Recommend a layer, or aim a throw, and print what is found as a table or as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import get_args

from soft_throw_ros.commands.options import (
    add_options,
    add_rig_options,
    OPTIONS,
    read_settings,
    RECOMMENDATION_OPTIONS,
    UNCERTAINTY_OPTIONS,
)
from soft_throw_ros.commands.output import (
    print_text,
    slow_notice,
    strain_warning,
    to_json,
    write_columns,
)
from soft_throw_ros.configuration import Entry, rig_of, Settings, TWIN
from soft_throw_ros.core.closed_form import ThrowUnresolvedError
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.evaluate import last_release
from soft_throw_ros.design.prediction import predict
from soft_throw_ros.design.recommendation import Recommendation, Vary
from soft_throw_ros.design.requests import Answer, answer, uncertainties_of
from soft_throw_ros.design.sensitivity import Sensitivity, TOLERATED, UNITS, WITHIN
from soft_throw_ros.design.uncertainty import prediction_uncertainty

NOT_REACHED = 1
"""Exit code if the target of an aim is out of reach."""

Columns = dict[str, Mapping[str, float] | None]
"""Predictions by the heads of their columns."""

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


_OF_MOTIONS = ('plate_speed', 'plate_acceleration', 'plate_jerk', 'plate_travel')


def add_recommend_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design recommend`."""
    parser.usage = (
        '%(prog)s [-h] [--objective peak|robust|versatile] '
        '[--vary thickness|wave_speed|both|library] [--json] [--config FILE] [--thickness M ...]'
    )
    without = ('max_amplitude', 'target_height', 'target_speed', *_OF_MOTIONS)
    _add_arguments(parser, 'what is asked of the layer', without, _OBJECTIVE, _VARY)


def add_aim_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `design aim`."""
    parser.usage = (
        '%(prog)s [-h] [--target-height M | --target-speed M/S] '
        '[--vary amplitude|thickness|wave_speed|both|library] [--json] [--config FILE] '
        '[--thickness M ...]'
    )
    parser.epilog = f'The exit code is {NOT_REACHED} if the target is out of reach.'
    without = ('objective', 'quantile', 'masses', 'frequencies', *_OF_MOTIONS)
    _add_arguments(parser, 'what is aimed at, and with what', without)


def _add_arguments(
    parser: argparse.ArgumentParser, title: str, without: tuple[str, ...], *entries: Entry
) -> None:
    parser.add_argument(
        '--json', action='store_true', help='print one object: SI units, full precision'
    )
    asked = [name for name in RECOMMENDATION_OPTIONS if not name.endswith(without)]
    add_options(parser, asked, title=title, entries=entries)
    add_options(parser, UNCERTAINTY_OPTIONS, title='uncertainties')
    add_rig_options(parser)


def run_recommend(arguments: argparse.Namespace) -> int:
    """Recommend, and print it; return 0. What is refused is a ValueError."""
    settings = read_settings(arguments)
    if settings['recommendation.objective'] == 'aim':
        raise ValueError(
            "recommendation.objective 'aim' is what `design aim` is for; give --objective"
        )
    _answer(settings, 'recommendation', _recommendation_lines, arguments.json)
    return 0


def run_aim(arguments: argparse.Namespace) -> int:
    """Aim, and print it; return 0, or `NOT_REACHED`. What is refused is a ValueError."""
    settings = read_settings(arguments)
    targets = {'recommendation.target_height', 'recommendation.target_speed'}
    # A file that aims has its target; of others it would be the default.
    if settings['recommendation.objective'] != 'aim' and not vars(arguments).keys() & targets:
        raise ValueError('nothing to aim at: give --target-height M or --target-speed M/S')
    settings['recommendation.objective'] = 'aim'
    best = _answer(settings, 'aim', _aim_lines, arguments.json)
    return 0 if isinstance(best, Aim) and best.is_reached else NOT_REACHED


def _answer(
    settings: Settings,
    name: str,
    lines: Callable[[Settings, Answer], Iterator[str]],
    as_json: bool,
) -> Answer:
    """Find what is asked for, and print it."""
    with slow_notice('design'):
        best = answer(settings)
        if as_json:
            asked = {
                key: value
                for key, value in settings.items()
                if key in OPTIONS or key.startswith(('recommendation.', 'uncertainty.'))
            }
            uncertainty = prediction_uncertainty(best.rig, uncertainties_of(settings)).values()
            text = to_json({'parameters': asked, name: best, 'uncertainty': uncertainty})
        else:
            text = '\n'.join([best.summary, '', *lines(settings, best)]) + '\n'
    print_text(text)
    return best


def _table(settings: Settings, best: Answer, columns: Columns) -> Iterator[str]:
    """Write predictions side by side, and how far the proposed one may be off."""
    yield from write_columns(columns)
    beyond = [
        head.replace('_', ' ')
        for head, each in columns.items()
        if each and each['peak_strain'] > settings['max_strain']
    ]
    if beyond:
        yield strain_warning(settings['max_strain'], ', '.join(beyond))
    uncertainty = prediction_uncertainty(best.rig, uncertainties_of(settings))
    yield f'From what is uncertain (--uncertain-...): {uncertainty.describe()}'


def _aim_lines(settings: Settings, best: Answer) -> Iterator[str]:
    """Put the throw as it is, the aimed one, and that with the layer as it is side by side."""
    assert isinstance(best, Aim)  # as it is the objective
    rig = rig_of(settings)
    columns: Columns = {'now': None}
    try:
        now, last = predict(rig), last_release(rig)
        reached = {'amplitude': rig.engine.amplitude, 'speed': last.speed, 'height': last.height}
        columns['now'] = {**vars(now), **reached}
    except ThrowUnresolvedError:
        pass  # it does not throw
    columns['aimed' if best.is_reached else 'the_most'] = vars(best)
    if best.rig.layer != rig.layer:
        try:
            other = answer({**settings, 'recommendation.vary': 'amplitude'})
            if isinstance(other, Aim) and other.is_reached:
                columns['with_this_layer'] = vars(other)
        except ThrowUnresolvedError:
            pass  # this layer throws with no amplitude
    yield from _table(settings, best, columns)


def _recommendation_lines(settings: Settings, best: Answer) -> Iterator[str]:
    """Put the layer as it is beside the recommended ones; say how much parameters matter."""
    assert isinstance(best, Recommendation)  # as it is no aim
    columns: Columns = {'now': vars(best.now) if best.now else None, 'recommended': vars(best)}
    for name in ('thickness', 'wave_speed', 'both'):
        other = getattr(best, f'by_{name}')
        if name != best.vary and other is not None:
            columns[f'by_{name}'] = vars(other)
    yield from _table(settings, best, columns)
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
