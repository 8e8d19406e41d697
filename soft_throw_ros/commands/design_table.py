# SPDX-License-Identifier: Apache-2.0
"""What the tasks that look for a layer share: their options, and how they print what they find."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping

from soft_throw_ros.commands.options import (
    add_options,
    add_rig_options,
    OPTIONS,
    RECOMMENDATION_OPTIONS,
    UNCERTAINTY_OPTIONS,
)
from soft_throw_ros.commands.output import Row, strain_warning, to_json, write_columns
from soft_throw_ros.configuration import Entry, Settings
from soft_throw_ros.core.rig import STANDARD_GRAVITY
from soft_throw_ros.design.aiming import Aim
from soft_throw_ros.design.recommendation import Recommendation
from soft_throw_ros.design.requests import uncertainties_of
from soft_throw_ros.design.uncertainty import prediction_uncertainty

_ROWS = (
    Row('amplitude', 'amplitude A', 'mm', 1e3),
    Row('thickness', 'thickness L_s', 'mm', 1e3),
    Row('wave_speed', 'wave speed c_s', 'm/s'),
    Row('density', 'density', 'kg/m3'),
    Row('youngs_modulus', 'modulus', 'kPa', 1e-3),
    Row('loss_tangent', 'loss tangent'),
    Row('mass_ratio', 'mu'),
    Row('speed_ratio', 'kappa'),
    Row('ejection_time', 'ejection time t_e', 'ms', 1e3),
    Row('ejection_speed', 'ejection speed V_e', 'm/s'),
    Row('energy_transfer', 'energy transfer alpha'),
    Row('speed', 'speed of last release', 'm/s'),
    Row('height', 'rise above the layer', 'mm', 1e3),
    Row('peak_strain', 'peak strain', '%', 1e2),
    Row('peak_acceleration', 'peak acceleration', 'm/s2'),
    Row('peak_acceleration', '  in g', 'g', 1.0 / STANDARD_GRAVITY),
    Row('peak_force', 'peak force on plate', 'N'),
    Row('plate_work', 'work of the plate', 'mJ', 1e3),
    Row('kinetic_energy', 'kinetic energy at t_e', 'mJ', 1e3),
)


def add_search_options(
    parser: argparse.ArgumentParser,
    title: str,
    *,
    without: tuple[str, ...],
    entries: Iterable[Entry] = (),
) -> None:
    """Add the options of a search for a layer, but for some that are of other objectives."""
    parser.add_argument(
        '--json', action='store_true', help='print one object: SI units, full precision'
    )
    asked = [name for name in RECOMMENDATION_OPTIONS if not name.endswith(without)]
    add_options(parser, asked, title=title, entries=entries)
    add_options(parser, UNCERTAINTY_OPTIONS, title='uncertainties')
    add_rig_options(parser)


def answer_lines(
    settings: Settings,
    best: Aim | Recommendation,
    columns: Mapping[str, Mapping[str, float] | None],
) -> Iterator[str]:
    """Write predictions side by side for people, and how far the proposed one may be off."""
    yield from (best.summary, '')
    yield from write_columns(_ROWS, columns)
    beyond = [
        head.replace('_', ' ')
        for head, each in columns.items()
        if each and each['peak_strain'] > settings['max_strain']
    ]
    if beyond:
        yield strain_warning(settings['max_strain'], ', '.join(beyond))
    uncertainty = prediction_uncertainty(best.rig, uncertainties_of(settings))
    yield f'From what is uncertain (--uncertain-...): {uncertainty.describe()}'


def answer_json(settings: Settings, best: Aim | Recommendation, name: str) -> str:
    """Write what was asked for, what was found, and how far it may be off, as one object."""
    asked = {
        name: value
        for name, value in settings.items()
        if name in OPTIONS or name.startswith(('recommendation.', 'uncertainty.'))
    }
    uncertainty = prediction_uncertainty(best.rig, uncertainties_of(settings))
    return to_json({'parameters': asked, name: best, 'uncertainty': uncertainty.values()})
