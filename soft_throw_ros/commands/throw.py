# SPDX-FileCopyrightText: 2026 soft_throw_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Predict one throw, as a table or as JSON.

The options are the parameters of the twin, with the same ranges.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from typing import TypedDict

from soft_throw_ros.commands.design_texts import uncertainty_text
from soft_throw_ros.commands.options import (
    add_rig_options,
    read_settings,
    UNCERTAINTY_PARAMETERS,
)
from soft_throw_ros.commands.output import (
    CommandParser,
    print_result,
    run_command,
    slow_notice,
    strain_warnings,
    write_columns,
)
from soft_throw_ros.configuration import rig_of, Settings, Value
from soft_throw_ros.configuration.twin import RIG_PARAMETERS
from soft_throw_ros.core import spring_mass
from soft_throw_ros.core.rig import Rig
from soft_throw_ros.core.throw import simulate
from soft_throw_ros.design.uncertainty import prediction_uncertainty, Uncertainties

ModelResult = Mapping[str, float]
"""Predictions by name, in SI units."""


class Prediction(TypedDict):
    """Output of `--json`."""

    parameters: dict[str, Value]
    rig: dict[str, float]
    throw: ModelResult | None
    spring: ModelResult | None
    uncertainty: dict[str, float | bool] | None
    notes: dict[str, str]
    leaves_linear_range: bool


def main(args: list[str] | None = None) -> int:
    """Run the command; return exit code 0, or 1 without a throw."""
    return run_command(_parser(), _run, args)


def _parser() -> CommandParser:
    parser = CommandParser(
        description='Predict one throw.',
        usage='%(prog)s [OPTION ...]',
    )
    parser.add_json_option()
    add_rig_options(parser)
    return parser


def _run(arguments: argparse.Namespace) -> int:
    settings = read_settings(arguments)
    with slow_notice('throw'):
        prediction = predict(settings)
    print_result(prediction, _table(prediction), as_json=arguments.json)
    return 0 if prediction['throw'] else 1


def predict(settings: Settings) -> Prediction:
    """
    Predict a throw.

    Parameters
    ----------
    settings : mapping of str to value
        Complete settings of the twin; only rig, uncertainties and `max_strain` matter.

    Returns
    -------
    Prediction
        All values are in SI units. `parameters` are the settings, `rig` has the ratios and times
        that govern a throw, `throw` the whole throw, `spring` the release from a layer without
        mass (App. A), and `uncertainty` the 95 % intervals of the first release. A part that does
        not support this throw is None, and its note contains the reason. `leaves_linear_range` is
        true if the strain is too large for a linear layer.

    """
    rig = rig_of(settings)
    throws: dict[str, ModelResult | None] = {}
    notes: dict[str, str] = {}
    for name, (simulated, note) in _THROWS.items():
        try:
            throws[name], notes[name] = simulated(rig), note
        except (ValueError, RuntimeError) as error:  # this rig is not supported
            throws[name], notes[name] = None, f'none, {error}'
    uncertainty = None
    try:
        intervals = prediction_uncertainty(rig, Uncertainties.from_settings(settings))
        uncertainty = intervals.values()
        notes['uncertainty'] = f'95 % of throws: {uncertainty_text(intervals)}'
    except ValueError as error:
        notes['uncertainty'] = f'none, {error}'
    return {
        'parameters': {
            name: settings[name]
            for name in (*RIG_PARAMETERS, *UNCERTAINTY_PARAMETERS)
        },
        'rig': {
            'mass_ratio': rig.mass_ratio,
            'speed_ratio': rig.speed_ratio,
            'frequency_ratio': rig.natural_frequency / rig.engine.frequency,
            'natural_frequency': rig.natural_frequency,
            'crossing_time': rig.crossing_time,
            'relaxation_time': rig.relaxation_time,
        },
        'throw': throws['throw'],
        'spring': throws['spring'],
        'uncertainty': uncertainty,
        'notes': notes,
        'leaves_linear_range': (throws['throw'] or {}).get('peak_strain', 0.0)
        > rig.layer.linear_range,
    }


def _spring(rig: Rig) -> ModelResult:
    """Predict the first release from a layer without mass by the formula of App. A."""
    engine = rig.engine
    if engine.motion:
        raise ValueError('this formula is for a harmonic plate, got a file')
    release = spring_mass.first_release(frequency_ratio=rig.natural_frequency / engine.frequency)
    return {
        'ejection_time': float(release.ejection_phase) / engine.frequency,
        'ejection_phase': float(release.ejection_phase),
        'ejection_speed': float(release.speed) * engine.speed_scale,
        'peak_plate_speed': engine.speed_scale,
        'energy_transfer': float(release.energy_transfer),
    }


_OF_THROW = (
    'ejection_time', 'ejection_speed', 'peak_plate_speed', 'energy_transfer', 'recontacts',
    'last_energy_transfer', 'peak_strain',
)
"""Predictions with the name of an attribute of `Throw`."""


def _simulated(rig: Rig) -> ModelResult:
    """Simulate a throw to its end."""
    throw = simulate(rig)
    projectile, release = rig.projectile, throw.first_release
    rise = release.position - throw.rest_height
    energy = projectile.mass * (0.5 * release.velocity**2 + rig.gravity * rise)
    result: dict[str, float] = {name: getattr(throw, name) for name in _OF_THROW}
    result |= {
        'ejection_phase': throw.ejection_time * rig.engine.frequency,
        'last_ejection_time': throw.last_release.time,
        'last_ejection_speed': throw.last_release.velocity,
        'peak_plate_strain': throw.loads.plate_strain,
        'peak_contact_strain': throw.loads.contact_strain,
        'peak_acceleration': throw.loads.acceleration,
        'peak_plate_force': throw.loads.plate_force,
        'plate_work': throw.energies.plate_work,
        'layer_energy': throw.energies.stored - energy,
        'projectile_energy': energy,
    }
    if rig.gravity:
        result['apex_height'] = throw.apex_height
    if throw.energies.heat:
        result['heat'] = throw.energies.heat
    return result


_THROWS: Mapping[str, tuple[Callable[[Rig], ModelResult], str]] = {
    'throw': (_simulated, 'whole throw of a rigid projectile, as the twin computes it'),
    'spring': (_spring, 'layer without mass and loss, harmonic plate, no gravity (App. A)'),
}
"""Columns of the table, each with its function and a note."""


def _table(prediction: Prediction) -> Iterator[str]:
    """Yield the lines of a table with the result of `predict`."""
    rig = prediction['rig']
    yield (
        f'mu {rig["mass_ratio"]:.6g}, kappa {rig["speed_ratio"]:.6g}, '
        f'f0/f {rig["frequency_ratio"]:.6g}, t_s {1e3 * rig["crossing_time"]:.6g} ms'
    )
    yield ''
    yield from write_columns({'throw': prediction['throw'], 'spring': prediction['spring']})
    yield ''
    for name, note in prediction['notes'].items():
        yield f'{name}: {note}'
    if prediction['throw']:
        limit = rig_of(prediction['parameters']).layer.linear_range
        yield from strain_warnings(limit, {'throw': prediction['throw']['peak_strain']})
